"""Axial position for a required backlash."""

import math
from collections.abc import Callable

import numpy as np
from jaxtyping import Float
from scipy.optimize import root_scalar

from ...base.errors import PairError
from ...base.units import DEG
from ...pair.gear_pair import GearPair
from ..tooth.tooth import tooth_of
from .drawn_backlash import Teeth, geometric_backlash

Excess = Callable[[np.ndarray], np.ndarray]
"""Backlash minus the required backlash, rad, as a function of axial positions in mm."""

_POSITIONS = 257  # chosen grid over the stroke; the backlash is assumed monotonic between points
_STEP = 1e-13  # tolerance of the position in the root search, mm; chosen
_ROUNDING = 1e-12
"""Excess, rad, that is treated as zero so that the ends of the stroke are found (chosen)."""


def axial_for_backlash(
    pair: GearPair,
    backlash_rad: float,
    centre_distance_mm: float | None = None,
    *,
    least_overlap_mm: float = 0.0,
    teeth: Teeth | None = None,
) -> float:
    """Return the axial shift s, mm, closest to 0 at which `geometric_backlash` has a given value.

    The search covers all positions with a face overlap of `least_overlap_mm` or more. If a face
    width is missing, the stroke is unlimited and the recession is assumed linear.

    **Arguments**
    - `pair`: gear pair.
    - `backlash_rad`: required backlash, rad of the driven gear.
    - `centre_distance_mm`: centre distance a; the drawn one when absent.
    - `least_overlap_mm`: smallest permitted overlap of the faces.
    - `teeth`: gears (driving, driven) if they differ from the drawing.

    **Raises** `PairError` if no position has this backlash; the message states the possible range.

    **Example**
    ```python
    >>> import math, vttig_jax
    >>> from vttig_jax import Gear, GearPair
    >>> from vttig_jax.base import PairError
    >>> from vttig_jax.geometry import axial_for_backlash
    >>> vttig_jax.enable_x64()
    >>> gears = Gear(45, 3, 3, 20), Gear(80, 3, 3, 20)
    >>> pair = GearPair(
    ...     *gears, module_mm=2.0, pressure_angles_deg=20.0, centre_distance_mm=125.12
    ... )
    >>> round(axial_for_backlash(pair, math.radians(0.02)), 4)
    0.57
    >>> try:
    ...     axial_for_backlash(pair, math.radians(1.0), least_overlap_mm=15.0)
    ... except PairError as error:
    ...     print(error)
    backlash: 1° cannot be reached; with 15 mm of common face or more (s from -5 to 5 mm) it is
    -0.3126° to 0.4381°.

    ```
    """
    gears = teeth or (tooth_of(pair, "driving"), tooth_of(pair, "driven"))

    def excess(axial: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
        backlash = geometric_backlash(pair, centre_distance_mm, axial, teeth=gears)
        return np.asarray(backlash - backlash_rad)

    stroke = _stroke(gears, least_overlap_mm)
    if not math.isfinite(stroke):
        return _linear_solution(excess, backlash_rad)
    positions = np.linspace(-stroke, stroke, _POSITIONS)
    values = excess(positions)
    if np.isnan(values).any():
        raise PairError(
            "the working pitch circle lies below a base circle; move the axes apart.",
            where="centre_distance_mm",
        )
    values = np.where(np.abs(values) <= _ROUNDING, 0.0, values)
    crossings = np.flatnonzero(values[:-1] * values[1:] <= 0)
    if not len(crossings):
        low, high = (float(end + backlash_rad) / DEG for end in (values.min(), values.max()))
        raise PairError(
            f"{backlash_rad / DEG:g}° cannot be reached; with {least_overlap_mm:g} mm of common"
            f" face or more (s from {-stroke:g} to {stroke:g} mm) it is {low:.4f}° to {high:.4f}°.",
            where="backlash",
        )
    distances = np.minimum(np.abs(positions[crossings]), np.abs(positions[crossings + 1]))
    first = int(crossings[np.argmin(distances)])
    return _root(excess, positions[first : first + 2], values[first : first + 2])


def _root(excess: Excess, ends: Float[np.ndarray, "2"], values: Float[np.ndarray, "2"]) -> float:
    """Return the position, mm, of zero excess between two ends whose excess has opposite signs."""
    for end, value in zip(ends, values, strict=True):
        if value == 0:
            return float(end)
    return root_scalar(lambda s: float(excess(np.asarray(s))), bracket=tuple(ends), xtol=_STEP).root


def _stroke(gears: Teeth, overlap: float) -> float:
    """Return the largest |s|, mm, at which the faces overlap by `overlap` mm.

    It is infinite if a face width is unknown.
    """
    widths = np.array([float(gear.face_width_mm) for gear in gears])
    if np.isnan(widths).any():
        return math.inf
    if not 0 <= overlap <= widths.min():
        raise PairError(
            f"{overlap:g} mm is not between 0 and the narrower face width of {widths.min():g} mm;"
            " give an overlap in this range.",
            where="least_overlap_mm",
        )
    return float(widths.sum() / 2 - overlap)


def _linear_solution(excess: Excess, backlash: float) -> float:
    """Return the position, mm, of zero excess for a linear recession."""
    at_0, at_1 = excess(np.array([0.0, 1.0]))
    if at_0 == at_1:
        raise PairError(
            f"{backlash / DEG:g}° cannot be reached; these teeth do not thin along the axis, so it"
            f" is {(at_0 + backlash) / DEG:.4f}° at every position.",
            where="backlash",
        )
    return float(at_0 / (at_0 - at_1))
