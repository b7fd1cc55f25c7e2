"""`vttig contact`: first contact of the tooth surfaces over the hunting period."""

from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np

from ...base.angles import angles_over_turns_deg
from ...base.errors import PairError
from ...base.files.json_io import dumps
from ...base.files.run_folder import RunFolder
from ...base.files.text_tables import key_values
from ...base.units import DEG
from ...pair.pair_file import load_pair_spec
from ...runs.map_table import csv_text
from ..drive_options import gears_of
from ..options import (
    Argument,
    Finite,
    Positive,
    Real,
    StepDeg,
    arguments_as_options,
    require_rows,
    verb,
)
from ..output import Output

if TYPE_CHECKING:
    from ...geometry.backlash import GapReport
    from ...geometry.contact_report import Contacts
    from ...pair.gear_pair import GearPair


_RECORD, _TABLE = "contact.json", "contact.csv"
_FIGURE, _DEVIATIONS = "figures/contact_{}.png", "figures/deviations.png"

_STEEPEST = Finite(min=-1e5, max=1e5)
"""Permitted range of a tilt of the axes in µrad, wider than the tilts of any real pair of gears."""


@verb(
    "contact",
    example="""
vttig contact pair.toml --out contact
vttig contact pair.toml --rig run --axial-mm 0.2 --out contact
vttig contact pair.toml --deviation-urad 100 --step-deg 0.5
vttig contact pair.toml --deviations measured.csv --span-rev 1 --out contact
""",
)
def command(
    output: Output,
    *,
    pair: Annotated[Path, Argument("PAIR")],
    rig: Annotated[
        Path | None, "Run folder whose eccentricities the gears have; without it they run true."
    ],
    axial_mm: Annotated[Real, "Displacement of the driven gear; closes if > 0."] = 0.0,
    centre_distance_mm: Annotated[Positive | None, "In the place of that of PAIR."],
    inclination_urad: Annotated[
        float,
        _STEEPEST,
        "Of the driven axis in the plane of both; positive where they part towards +z.",
    ] = 0.0,
    deviation_urad: Annotated[float, _STEEPEST, "Of the driven axis out of that plane."] = 0.0,
    deviations: Annotated[
        Path | None,
        {"metavar": "CSV"},
        "Measured flanks: gear,flank,roll_mm,z_mm,deviation_um, a full grid for each flank.",
    ],
    pitch: Annotated[
        Path | None,
        {"metavar": "CSV"},
        "Where single teeth stand: gear,flank,tooth,deviation_um, all teeth of each flank.",
    ],
    step_deg: Annotated[StepDeg, "Of the driving angle; 1 by default."] = 1.0,
    span_rev: Annotated[Positive | None, "Driving turns; the hunting period by default."],
    out: Annotated[Path | None, "Folder for table and pictures."],
    overwrite: Annotated[bool, "Replace the results in --out."],
) -> None:
    """Find where the teeth of the gears in PAIR touch, from their surfaces alone.

    At every driving angle the driven gear is turned until flank A touches, then until flank B
    touches. The contact is described by the tooth pair, the section, its place on the flank or on
    the edge of a tip, and its shape, a line or a point. The command prints the transmission error
    and the backlash of the surfaces, and for comparison the backlash that follows from the tooth
    thickness. The teeth carry no load.
    """
    import equinox as eqx

    from ...geometry.backlash import gap_report
    from ...geometry.contact import contact_model
    from ...geometry.contact_report import contact_at
    from ...geometry.mounting import Misalignment
    from ...logs.readers.backlash_readings import read_deviations
    from ...pair.gear_pair import Eccentricities
    from ...runs.maps import fitted_rig

    gears = gears_of(load_pair_spec(pair), pair, "no teeth to touch")
    turns = float(gears.hunting_turns) if span_rev is None else span_rev
    require_rows(turns, step_deg)
    mounted = Eccentricities() if rig is None else fitted_rig(rig, pair)
    apparent = None if rig is None else float(mounted.constant_backlash_deg)
    measured = read_deviations(deviations, pitch, pair=gears) if deviations or pitch else None
    tilt = Misalignment(inclination_urad * 1e-6, deviation_urad * 1e-6)
    try:
        with arguments_as_options():
            model = contact_model(
                gears,
                eqx.tree_at(lambda one: one.axial_mm, mounted, np.float64(axial_mm)),
                misalignment=tilt if inclination_urad or deviation_urad else None,
                deviations=measured,
                centre_distance_mm=centre_distance_mm,
            )
            gap = gap_report(gears, centre_distance_mm, axial_mm, apparent_deg=apparent)
    except PairError as error:
        asked = centre_distance_mm is not None and error.where == "centre_distance_mm"
        where = "--centre-distance-mm" if asked else f"{pair}: {error.where}"
        raise PairError(error.message, where=where) from None
    driving = angles_over_turns_deg(step_deg, turns) * DEG
    # The folder is opened before the computation, so that existing results are refused at once.
    results = (_TABLE, _RECORD)
    opened = nullcontext() if out is None else RunFolder(out, overwrite=overwrite, results=results)
    with opened as folder:
        flanks = {}
        with output.progress(2, "flanks") as bar:
            for flank in ("A", "B"):
                flanks[flank] = contact_at(model, driving, flank)
                bar.update(1)
        left = (flanks["B"].transmission_error - flanks["A"].transmission_error) / DEG
        known = np.flatnonzero(np.isfinite(left))  # NaN where one of the flanks has no contact
        ends: dict[str, dict[str, Any]] = {}
        for word, best in (("smallest", np.argmin), ("largest", np.argmax)):
            row = known[best(left[known])] if len(known) else None
            place = (None, None) if row is None else (float(left[row]), float(driving[row] / DEG))
            ends[word] = dict(zip(("backlash_deg", "driving_deg"), place, strict=True))
        record = {
            "schema": "vttig.contact/1",
            "pair": gears.name,
            "source": str(pair),
            "rig": None if rig is None else str(rig),
            "deviations": None if deviations is None else str(deviations),
            "pitch": None if pitch is None else str(pitch),
            "span_turns": turns,
            "step_deg": step_deg,
            "centre_distance_mm": gap.centre_distance_mm,
            "axial_mm": gap.axial_mm,
            "rows": len(left),
            "rows_with_backlash": len(known),
            "flanks": {name: found.to_json() for name, found in flanks.items()},
            **ends,
            "drawn_backlash_deg": gap.backlash / DEG,
            "apparent_backlash_deg": None if gap.apparent is None else gap.apparent / DEG,
            "csv": None if out is None else _TABLE,
        }
        if folder is not None:
            for name in (_FIGURE.format("A"), _FIGURE.format("B"), _DEVIATIONS):
                folder.discard(name)
            for name, data in _figures(gears, flanks).items():
                folder.write_bytes(name, data)
            folder.write_text(_RECORD, dumps(record) + "\n")
            folder.write_text(_TABLE, _table(flanks, left))
    output.emit(record, _text(flanks, record, gap, out))


def _figures(gears: "GearPair", flanks: "dict[str, Contacts]") -> dict[str, bytes]:
    """Return the pictures: file name → content of the PNG file.

    The figures are each flank at its first angle with contact, and the measured deviations.
    """
    from ...plotting.contact import plot_contact
    from ...plotting.deviations import plot_deviations
    from ...plotting.save import png

    drawn = {}
    for name, found in flanks.items():
        if found.in_contact.any():
            place = int(np.argmax(found.in_contact))
            drawn[_FIGURE.format(name)] = png(plot_contact(found, gears, place=place))
    deviations = flanks["A"].model.deviations
    if deviations is not None:
        drawn[_DEVIATIONS] = png(plot_deviations(deviations, gears))
    return drawn


def _text(
    flanks: "dict[str, Contacts]", record: dict[str, Any], gap: "GapReport", out: Path | None
) -> str:
    """Return the text that is printed without `--json`."""
    from ...geometry.backlash import TOUCHING

    rows = []
    for word in ("smallest", "largest"):
        backlash, driving = record[word].values()
        if backlash is not None:
            interfere = ", where the teeth interfere" * (backlash * DEG < -TOUCHING)
            rows.append((word, f"{backlash:z.5f}° at {driving:g}°{interfere}"))
    if (without := record["rows"] - record["rows_with_backlash"]) or not rows:
        rows.append(("undefined", f"at {without} of {record['rows']} angles: no tooth in reach"))
    if record["rig"] is not None:
        rows.append(("of the run", "eccentricities, not its constant backlash and higher orders"))
    if out is not None:
        rows.append(("table", str(out / _TABLE)))
    over = f"backlash of the surfaces over {record['span_turns']:g} turns"
    measured = flanks["A"].model.deviations
    parts = [*([] if measured is None else [measured]), *flanks.values()]
    return "\n".join([*map(str, parts), key_values(rows, title=over), str(gap)])


def _table(flanks: "dict[str, Contacts]", backlash_deg: Any) -> str:
    """Return a CSV table with one row per driving angle.

    Fields are empty at angles without contact on the flank.
    """
    columns = {"driving_deg": flanks["A"].driving_angle / DEG, "backlash_deg": backlash_deg}
    for name, found in flanks.items():
        end = f"_{name.lower()}"
        teeth = np.where(found.in_contact[:, None], found.tooth_pair, np.nan)
        columns |= {
            f"transmission_error{end}_deg": found.transmission_error / DEG,
            f"driving_tooth{end}": teeth[:, 0],
            f"driven_tooth{end}": teeth[:, 1],
            f"z{end}_mm": found.z_mm,
            f"driving_radius{end}_mm": found.radius_mm[:, 0],
            f"driven_radius{end}_mm": found.radius_mm[:, 1],
            f"line{end}_mm": found.length_mm,
        }
    return csv_text(columns)
