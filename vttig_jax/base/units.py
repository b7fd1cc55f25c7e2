"""Units of input and output; inside the package units are rad, mm and s."""

import math
from typing import Final

DEG: Final = math.pi / 180.0
"""One degree in radians."""

ARCSEC: Final = DEG / 3600.0
"""One second of arc in radians."""

REV: Final = 2.0 * math.pi
"""One revolution in radians."""

ANGLE_UNITS: Final = {
    "deg": DEG,
    "rad": 1.0,
    "rev": REV,
    "arcsec": ARCSEC,
    "urad": 1e-6,
    "arcmin": DEG / 60.0,
    "mdeg": 1e-3 * DEG,
    "mrad": 1e-3,
    "gon": REV / 400.0,
    "mgon": REV / 400e3,
}
"""Radians per unit, for every angle unit that can end a column name (counts need an encoder)."""

LENGTH_UNITS: Final = {"mm": 1.0, "um": 1e-3, "inch": 25.4}
"""Millimetres in one of each unit of length, that of a linear axis or of an axial position."""


def radians_of(unit: str, counts_per_rev: int | None, lead_mm: float | None) -> float | None:
    """Return the angle in rad of a reading 1 of a shaft, without sign and scale.

    It is None for counts without counts per revolution, and for a length without the lead of the
    screw, which is the travel in mm in one turn.
    """
    if unit == "counts":
        return None if counts_per_rev is None else REV / counts_per_rev
    if unit in LENGTH_UNITS:
        return None if lead_mm is None else REV * LENGTH_UNITS[unit] / lead_mm
    return ANGLE_UNITS[unit]


def per_turn(unit: str, counts_per_rev: int | None) -> int | float | None:
    """Return the readings per turn at which a shaft may wrap; a length never wraps."""
    if unit in LENGTH_UNITS:
        return None
    return counts_per_rev if unit == "counts" else REV / ANGLE_UNITS[unit]


def duration_text(seconds: float) -> str:
    """Return a duration in s or ms."""
    return f"{seconds:.3g} s" if seconds >= 1 else f"{1e3 * seconds:.3g} ms"
