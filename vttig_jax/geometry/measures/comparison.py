"""Comparison of computed measures with the values stated by a drawing or a workshop."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

from ...base.files.text_tables import key_values, text_table
from ...pair.schema import StatedTable
from .gear_measures import GearMeasures


class Stated(NamedTuple):
    """Stated value and its excess over the computed value (None: not comparable)."""

    value: float
    difference: float | None


def compare_stated(stated: StatedTable, found: GearMeasures) -> tuple[dict[str, Stated], list[str]]:
    """Return the stated values by key, and a sentence for each value that cannot be compared.

    Thickness at the ends needs the face width. Span and measurement over balls are compared only
    in the middle of the face, over the stated number of teeth and the stated ball.

    **Example**
    ```python
    >>> from vttig_jax import Gear, GearPair
    >>> from vttig_jax.geometry import compare_stated, measure_gear, tooth_of
    >>> from vttig_jax.pair import StatedTable
    >>> gears = Gear(45, 3.0, 3.0, 20.0), Gear(80, 3.0, 3.0, 20.0)
    >>> pair = GearPair(*gears, module_mm=2.0, pressure_angles_deg=20.0)
    >>> computed = measure_gear(tooth_of(pair, "driving"))
    >>> stated, notes = compare_stated(StatedTable(tooth_thickness_thick_mm=4.195), computed)
    >>> f"{stated['tooth_thickness_thick_mm'].difference:+.4f}", notes
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
    reasons = _different_conditions(stated, found)
    comparison = {}
    for name, value in computed.items():
        given = getattr(stated, name)
        if given is not None:
            comparable = value is not None and name not in reasons
            comparison[name] = Stated(given, given - value if comparable else None)
    return comparison, [sentence for name, sentence in reasons.items() if name in comparison]


def _different_conditions(stated: StatedTable, computed: GearMeasures) -> dict[str, str]:
    """Return a sentence for each stated value measured under other conditions than computed."""
    if computed.section_mm:
        return {
            key: f"The stated {measure} is that of the middle of the face, not of"
            f" z = {computed.section_mm:g} mm."
            for key, measure in (("span_mm", "span"), ("over_balls_mm", "measure over balls"))
        }
    reasons = {}
    if stated.span_teeth != computed.span.teeth:
        reasons["span_mm"] = f"The stated span is over {stated.span_teeth} teeth."
    if stated.ball_diameter_mm != computed.over_balls.ball_diameter_mm:
        reasons["over_balls_mm"] = (
            f"The stated measure over balls is over balls of {stated.ball_diameter_mm} mm."
        )
    return reasons


_Cell = Callable[[GearMeasures], Any]


def measures_text(
    gears: Mapping[str, GearMeasures],
    stated: Mapping[str, Mapping[str, Stated]],
    notes: Mapping[str, Sequence[str]],
    title: str,
    mesh: Mapping[str, Any],
) -> str:
    """Return a table of the measures with one column for each gear, and the notes below it.

    **Arguments**
    - `gears`: measures by the name of the gear.
    - `stated`: stated values by gear and key; if there are any, the table shows them with their
      differences from the computed values.
    - `notes`: sentences by gear; a sentence that applies to all gears is printed once.
    - `title`: first line.
    - `mesh`: result of `measure_pair`.
    """
    with_stated = any(stated.values())
    headers: list[str] = [""]
    for name in gears:
        headers += [name, "stated", "difference"] if with_stated else [name]
    rows = []
    for label, key, cell in _rows(list(gears.values())):
        row = [label]
        for name, measures in gears.items():
            row.append(_number(cell(measures)))
            if with_stated:
                row += _stated_cells(stated[name].get(key))
        rows.append(row)
    table = _indented(text_table(rows, headers))
    return "\n".join([title, *table, _mesh_text(mesh), *_notes(notes)])


def _mesh_text(mesh: Mapping[str, Any]) -> str:
    by_flank = " / ".join
    angles, ratios, diameters = (
        by_flank(f"{value:.{digits}f}" for value in mesh[key].values())
        for key, digits in (
            ("working_pressure_angle_deg", 4),
            ("contact_ratio", 3),
            ("pitch_diameter_mm", 4),
        )
    )
    backlash = round(mesh["backlash_deg"], 4) + 0.0, round(mesh["backlash_mm"], 4) + 0.0  # no −0
    rows = [
        ("working pressure angle A / B", f"{angles}°"),
        ("pitch diameters", f"{diameters} mm"),
        ("contact ratio A / B", ratios),
        ("backlash", "{:.4f}° of the driven gear = {:.4f} mm".format(*backlash)),
    ]
    return key_values(rows, title=f"in mesh at a = {mesh['centre_distance_mm']:g} mm")


def _rows(gears: list[GearMeasures]) -> list[tuple[str, str, _Cell]]:
    """Return label, key of the stated value ("" for none) and a function for each row.

    The function takes the measures of a gear and returns the cell; lengths are in mm.
    """
    radii = [thickness.radius_mm for thickness in gears[0].thickness_at]
    tapered = any(measures.tapered for measures in gears)
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
        *(row for index, radius in enumerate(radii) for row in _at_radius(index, radius)),
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
    """Return one row if left and right value agree in all gears, else one row for each flank."""
    if all(values(g)[0] == values(g)[1] for g in gears):
        return [(label, "", lambda g: values(g)[0])]
    return [
        (f"{label}, left flank", "", lambda g: values(g)[0]),
        (f"{label}, right flank", "", lambda g: values(g)[1]),
    ]


def _at_radius(index: int, radius: float) -> list[tuple[str, str, _Cell]]:
    label = f"thickness at r = {radius:g},"
    return [
        (f"{label} thin end", "", lambda g: g.thickness_at[index].thin),
        (f"{label} section", "", lambda g: g.thickness_at[index].section),
        (f"{label} thick end", "", lambda g: g.thickness_at[index].thick),
    ]


def _handed(degrees: float, hands: str) -> str:
    """Return the absolute angle with L or R, the first of `hands` for a positive angle."""
    if round(degrees, 4) == 0:
        return "0.0000"
    return f"{abs(degrees):.4f} {hands[0] if degrees > 0 else hands[1]}"


def _span_label(gears: list[GearMeasures]) -> str:
    measurable = any(gear.span.measurable for gear in gears)
    return "span" if measurable else "span, a computed figure"


def _stated_cells(stated: Stated | None) -> list[str]:
    if stated is None:
        return ["", ""]
    difference = "–" if stated.difference is None else f"{stated.difference:+.4f}"
    return [f"{stated.value:g}", difference]


def _number(value: Any) -> Any:
    return f"{value:.4f}" if isinstance(value, float) else value


def _indented(table: str) -> list[str]:
    return [f"  {line}" for line in table.splitlines()]


def _notes(notes: Mapping[str, Sequence[str]]) -> list[str]:
    """Return the notes in the order of the gears; notes common to all gears carry no name."""
    lines = []
    for name, sentences in notes.items():
        for sentence in sentences:
            shared = all(sentence in others for others in notes.values())
            line = sentence if shared else f"{name}: {sentence}"
            lines += [] if f"  {line}" in lines else [f"  {line}"]
    return ["", "notes:", *lines] if lines else []
