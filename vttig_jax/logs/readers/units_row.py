"""Detection of a row of units below the names of the columns."""

from collections.abc import Sequence

from .column_names import ANGLES, TIME_UNITS, unit_spelt

_OTHER = """
    nm n·m n*m mnm a ma ka v mv kv w kw mw °c degc c k f °f % bar mbar pa kpa mpa psi n kn mm
    m cm um µm μm nm/a hz khz mhz rpm 1/min min-1 r/min u/min rev/min rad/s deg/s °/s rev/s
    rad/s2 rad/s^2 rad/s² deg/s2 deg/s^2 deg/s² °/s2 °/s^2 °/s² m/s m/s2 m/s^2 m/s² mm/s g kg
    ohm db lux ppm px pixel pixels bit bool °c/s deg_per_s rad_per_s deg_per_s2 rad_per_s2 min
    h inch in lb lbf ft degf mil volt volts ampere amperes
"""

OTHER_UNITS = frozenset(_OTHER.split())
"""Units of quantities other than angle and time, in lower case."""

NO_UNITS = frozenset(("", "-", "–", "none", "(none)", "n/a", "1"))
"""Fields in a row of units that mean "no unit"."""

_BRACKETS = {"[": "]", "(": ")"}


def unit_in(field: str) -> str | None:
    """Return the unit in a field of a row of units.

    It is "" for a field that means "no unit", and None for a field that is not a unit.
    """
    text = field.strip()
    if text[:1] in _BRACKETS and text.endswith(_BRACKETS[text[0]]):
        text = text[1:-1]
    unit = unit_spelt(text)
    if unit in NO_UNITS:
        return ""
    return unit if unit in OTHER_UNITS or unit in (*ANGLES, *TIME_UNITS) else None


def is_units_row(fields: Sequence[str]) -> bool:
    """Return whether every field is a unit or means "no unit", and at least one is a unit."""
    units = []
    for field in fields:
        units.append(unit_in(field))
        if units[-1] is None:
            return False
    return any(units)


def with_units(names: Sequence[str], fields: Sequence[str]) -> list[str]:
    """Return the names with the units in brackets; `fields` is the row of units below the names."""
    padded = [*fields, *[""] * (len(names) - len(fields))]
    return [
        f"{name} [{field.strip().strip('[]()')}]" if unit_in(field) else name
        for name, field in zip(names, padded, strict=False)
    ]
