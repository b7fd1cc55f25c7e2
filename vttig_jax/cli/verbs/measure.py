"""`vttig measure`: values that a workshop can check with caliper, micrometer and balls.

They are computed from the pair file.
"""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import click

from ...base.errors import UsageError
from ...pair.pair_file import PAIR_FILE, load_pair_spec
from ...pair.schema import StatedTable
from ..drive_options import gears_of
from ..options import Argument, Positive, Real, verb
from ..output import Output

if TYPE_CHECKING:
    from ...geometry.measures import GearMeasures


@verb(
    "measure",
    compiles=False,
    example="""
vttig measure pair.toml
vttig measure pair.toml --section-mm 5 --ball-mm 3.5
vttig measure pair.toml --thickness-at-mm 44 --thickness-at-mm 46 --span-teeth 6
""",
)
def command(
    output: Output,
    *,
    pair: Annotated[Path, Argument("PAIR")],
    section_mm: Annotated[
        Real,
        "Height of the section along the axis of each gear, whose teeth thin towards +z; 0, the"
        " middle of the face, by default.",
    ] = 0.0,
    thickness_at_mm: Annotated[
        tuple[Positive, ...], "Radius at which the thickness is wanted as well; repeatable."
    ],
    span_teeth: Annotated[
        int | None,
        click.IntRange(min=1, max=100_000),
        "Teeth to span; by default those stated, or those the jaws touch nearest to R + x m.",
    ],
    ball_mm: Annotated[
        Positive | None,
        "Diameter of the balls; by default that stated, or one on sale that touches near there.",
    ],
) -> None:
    """Measure the gears of the pair file PAIR as a shop would.

    Prints diameters, tooth thickness at both ends of the face and in the section, the chord of the
    tooth caliper, the span over several teeth, the measurement over balls whose centres are held in
    the section, and the base helix angles, in mm and degrees; of the pair the working pressure
    angle, pitch diameters, contact ratio and backlash. What the pair file states of a gear
    (`stated = { tip_diameter_mm = 94.0 }` in [driving] or [driven]) stands beside it.
    """
    from ...geometry.checks import check_measurable
    from ...geometry.measures import compare_stated, measure_gear, measure_pair, measures_text
    from ...geometry.tooth import SHAFTS, tooth_of

    spec = load_pair_spec(pair)
    drawn = gears_of(spec, pair, "nothing to measure")
    gears, stated, notes = {}, {}, {}
    record: dict[str, Any] = {
        "schema": "vttig.measure/1",
        "pair": spec.name,
        "source": str(pair),
        "section_mm": section_mm,
    }
    for shaft in SHAFTS:
        table, tooth = getattr(spec, shaft).stated or StatedTable(), tooth_of(drawn, shaft)
        half = float(tooth.face_width_mm) / 2
        if abs(section_mm) > half:
            raise UsageError(
                f"--section-mm {section_mm:g} lies outside of the {shaft} gear, whose face ends at"
                f" ±{half:g} mm."
            )
        with PAIR_FILE.error_context(f"{pair}: {shaft}"):
            check_measurable(tooth, section_mm)
        found = measure_gear(
            tooth,
            section_mm=section_mm,
            radii_mm=thickness_at_mm,
            span_teeth=span_teeth or table.span_teeth,
            ball_mm=ball_mm or table.ball_diameter_mm,
        )
        stated[shaft], beside = compare_stated(table, found)
        gears[shaft], notes[shaft] = found, [*found.notes, *beside]
        compared = {name: one._asdict() for name, one in stated[shaft].items()}
        record[shaft] = {**found.to_json(), "stated": compared, "notes": notes[shaft]}
    _require_some(gears, thickness_at_mm)
    place = "in" if section_mm == 0 else "from"
    title = (
        f"{spec.name or 'gear pair'}: section z = {section_mm:g} mm {place} the middle of the face;"
        " lengths in mm"
    )
    record["mesh"] = measure_pair(drawn)
    output.emit(record, measures_text(gears, stated, notes, title, record["mesh"]))


def _require_some(gears: "dict[str, GearMeasures]", radii_mm: tuple[float, ...]) -> None:
    """Raise `UsageError` for a radius that lies on the involutes of neither gear."""
    for at, radius in enumerate(radii_mm):
        if all(found.thickness_at[at].section_mm is None for found in gears.values()):
            reaches = " and ".join(
                f"{max(found.form_diameter_mm) / 2:.4f} to {found.tip_diameter_mm / 2:.4f} mm"
                for found in gears.values()
            )
            raise UsageError(
                f"--thickness-at-mm {radius:g} lies on neither gear: their involutes reach from"
                f" {reaches}."
            )
