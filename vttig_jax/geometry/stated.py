"""What drawing or shop state of a gear, beside what follows from the geometry."""

from typing import NamedTuple

from ..pair.spec import StatedTable
from .measures_gear import GearMeasures


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
    >>> from vttig_jax.geometry.measures_gear import measure_gear
    >>> from vttig_jax.geometry.stated import compare_stated
    >>> from vttig_jax.geometry.tooth import tooth_of
    >>> from vttig_jax.pair.spec import StatedTable
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
