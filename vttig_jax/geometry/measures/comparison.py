"""The measures of both gears in one table, beside the values that a drawing or a shop states."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

from ...base.files.text_tables import text_table
from ...pair.schema import StatedTable
from .gear_measures import GearMeasures


class Stated(NamedTuple):
    """A stated value, and how much larger it is than the computed one (None: not comparable)."""

    value: float
    difference: float | None


def compare_stated(stated: StatedTable, found: GearMeasures) -> tuple[dict[str, Stated], list[str]]:
    """Stated values by key, and sentences on those that cannot be compared.

    Thickness at the ends needs the face width; span and measurement over balls are compared where
    they were measured as stated: in the middle of the face, over the same teeth and balls.

    **Example**
    ```python
    >>> from vttig_jax import Gear, GearPair
    >>> from vttig_jax.geometry import measure_gear
    >>> from vttig_jax.geometry import compare_stated
    >>> from vttig_jax.geometry import tooth_of
    >>> from vttig_jax.pair import StatedTable
    >>> gears = Gear(45, 3.0, 3.0, 20.0), Gear(80, 3.0, 3.0, 20.0)
    >>> pair = GearPair(*gears, module_mm=2.0, pressure_angles_deg=20.0)
    >>> found = measure_gear(tooth_of(pair, "driving"))
    >>> beside, notes = compare_stated(StatedTable(tooth_thickness_thick_mm=4.195), found)
    >>> f"{beside['tooth_thickness_thick_mm'].difference:+.4f}", notes
    ('+0.0053', [])

    ```
    """
    computed = {
        "tooth_thickness_thin_mm": found.thickness.thin,
        "tooth_thickness_thick_mm": found.thickness.thick,
        "tip_diameter_mm": found.tip_diameter_mm,
        "root_diameter_mm": found.root_diameter_mm,
        "span_mm": found.span.value_mm,
        "over_balls_mm": found.over_balls.value_mm,
    }
    why_not = _otherwise_measured(stated, found)
    beside = {}
    for name, value in computed.items():
        given = getattr(stated, name)
        if given is not None:
            comparable = value is not None and name not in why_not
            beside[name] = Stated(given, given - value if comparable else None)
    return beside, [sentence for name, sentence in why_not.items() if name in beside]


def _otherwise_measured(stated: StatedTable, found: GearMeasures) -> dict[str, str]:
    """Key → why the stated value is not that of the measure shown."""
    if found.section_mm:
        return {
            name: f"The stated {what} is that of the middle of the face, not of"
            f" z = {found.section_mm:g} mm."
            for name, what in (("span_mm", "span"), ("over_balls_mm", "measure over balls"))
        }
    why_not = {}
    if stated.span_teeth != found.span.teeth:
        why_not["span_mm"] = f"The stated span is over {stated.span_teeth} teeth."
    if stated.ball_diameter_mm != found.over_balls.ball_diameter_mm:
        why_not["over_balls_mm"] = (
            f"The stated measure over balls is over balls of {stated.ball_diameter_mm} mm."
        )
    return why_not


_Cell = Callable[[GearMeasures], Any]


def measures_text(
    gears: Mapping[str, GearMeasures],
    stated: Mapping[str, Mapping[str, Stated]],
    notes: Mapping[str, Sequence[str]],
    title: str,
) -> str:
    """Table of the measures, a column a gear, and the notes below it.

    **Arguments**
    - `gears`: measures by the name of the gear.
    - `stated`: by gear, what is stated by key; columns for it appear where anything is, with its
      difference from what is computed.
    - `notes`: by gear, sentences; what is said of every gear stands once.
    - `title`: the first line.
    """
    beside = any(stated.values())
    headers: list[str] = [""]
    for name in gears:
        headers += [name, "stated", "difference"] if beside else [name]
    rows = []
    for label, key, cell in _rows(list(gears.values())):
        row = [label]
        for name, found in gears.items():
            row.append(_number(cell(found)))
            if beside:
                row += _stated_cells(stated[name].get(key))
        rows.append(row)
    return "\n".join([title, *_indented(text_table(rows, headers)), *_notes(notes)])


def _rows(gears: list[GearMeasures]) -> list[tuple[str, str, _Cell]]:
    """Label, key of the stated value, and value of each row; lengths in mm."""
    radii = [one.radius_mm for one in gears[0].thickness_at]
    tapered = any(found.tapered for found in gears)
    return [
        ("teeth", "", lambda g: str(g.teeth)),
        ("reference diameter", "", lambda g: g.reference_diameter_mm),
        ("tip diameter", "tip_diameter_mm", lambda g: g.tip_diameter_mm),
        ("root diameter", "root_diameter_mm", lambda g: g.root_diameter_mm),
        *_by_side(gears, "base diameter", lambda g: g.base_diameters_mm),
        *_by_side(gears, "form diameter", lambda g: g.form_diameters_mm),
        ("base helix and hand, left flank [°]", "", lambda g: _handed(g.base_helix_deg[0], "LR")),
        ("base helix and hand, right flank [°]", "", lambda g: _handed(g.base_helix_deg[1], "RL")),
        ("thickness, thin end", "tooth_thickness_thin_mm", lambda g: g.thickness.thin),
        ("thickness, section", "", lambda g: g.thickness.section),
        ("thickness, thick end", "tooth_thickness_thick_mm", lambda g: g.thickness.thick),
        ("tip thickness, thin end", "", lambda g: g.tip_thickness.thin),
        ("tip thickness, section", "", lambda g: g.tip_thickness.section),
        *(row for at, radius in enumerate(radii) for row in _at_radius(at, radius)),
        ("chordal thickness", "", lambda g: g.chordal_thickness_mm),
        ("height above the chord", "", lambda g: g.chordal_height_mm),
        ("teeth spanned", "", lambda g: None if g.span.teeth is None else str(g.span.teeth)),
        (_span_label(gears), "span_mm", lambda g: g.span.value_mm),
        ("ball diameter", "", lambda g: f"{g.over_balls.ball_diameter_mm:g}"),
        ("over balls", "over_balls_mm", lambda g: g.over_balls.value_mm),
        *([("over balls, per mm of z", "", lambda g: g.over_balls_slope)] if tapered else []),
    ]


def _by_side(
    gears: list[GearMeasures], label: str, values: Callable[[GearMeasures], tuple[float, float]]
) -> list[tuple[str, str, _Cell]]:
    """One row where both flanks are alike in all gears, else one for each flank."""
    if all(values(g)[0] == values(g)[1] for g in gears):
        return [(label, "", lambda g: values(g)[0])]
    return [
        (f"{label}, left flank", "", lambda g: values(g)[0]),
        (f"{label}, right flank", "", lambda g: values(g)[1]),
    ]


def _at_radius(at: int, radius: float) -> list[tuple[str, str, _Cell]]:
    label = f"thickness at r = {radius:g},"
    return [
        (f"{label} thin end", "", lambda g: g.thickness_at[at].thin),
        (f"{label} section", "", lambda g: g.thickness_at[at].section),
        (f"{label} thick end", "", lambda g: g.thickness_at[at].thick),
    ]


def _handed(degrees: float, hands: str) -> str:
    """The angle with L or R; `hands` are those of a flank that thins the tooth and of the other."""
    if round(degrees, 4) == 0:
        return "0.0000"
    return f"{abs(degrees):.4f} {hands[0] if degrees > 0 else hands[1]}"


def _span_label(gears: list[GearMeasures]) -> str:
    spans = [found.span for found in gears]
    return "span" if any(one.measurable for one in spans) else "span, a computed figure"


def _stated_cells(one: Stated | None) -> list[str]:
    if one is None:
        return ["", ""]
    return [f"{one.value:g}", "–" if one.difference is None else f"{one.difference:+.4f}"]


def _number(value: Any) -> Any:
    return f"{value:.4f}" if isinstance(value, float) else value


def _indented(table: str) -> list[str]:
    return [f"  {line}" for line in table.splitlines()]


def _notes(notes: Mapping[str, Sequence[str]]) -> list[str]:
    """Notes in the order of the gears; what all gears share stands without their names."""
    lines = []
    for name, sentences in notes.items():
        for sentence in sentences:
            shared = all(sentence in others for others in notes.values())
            line = sentence if shared else f"{name}: {sentence}"
            lines += [] if f"  {line}" in lines else [f"  {line}"]
    return ["", "notes:", *lines] if lines else []
