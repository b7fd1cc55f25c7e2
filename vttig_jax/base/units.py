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
}
"""Radians per unit, for every angle unit that can end a column name (counts need an encoder)."""


def duration_text(seconds: float) -> str:
    """Return a duration in s or ms."""
    return f"{seconds:.3g} s" if seconds >= 1 else f"{1e3 * seconds:.3g} ms"
