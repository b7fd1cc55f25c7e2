"""The axial position that gives a wanted backlash, or why there is none."""

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
"""Backlash at positions less what is wanted, rad."""

_POSITIONS = 257
"""Over the stroke, between which the backlash is taken to go one way."""

_STEP = 1e-13
"""Of the position, mm, at which a search stops."""

_ROUNDING = 1e-12
"""Backlash, rad, that rounding may make of none: the end of a stroke gives what it is asked for."""


def axial_for_backlash(
    pair: GearPair,
    backlash_rad: float,
    centre_distance_mm: float | None = None,
    *,
    least_overlap_mm: float = 0.0,
    teeth: Teeth | None = None,
) -> float:
    """Axial shift s at which `geometric_backlash` is what is wanted, mm; the one nearest to s = 0.

    Looked for wherever the faces overlap by `least_overlap_mm` or more. Where no face widths are
    given the stroke has no end, and the recession is taken to be linear.

    **Arguments**
    - `pair`: the gears.
    - `backlash_rad`: wanted, rad of the driven gear.
    - `centre_distance_mm`: a; that of the drawing when absent.
    - `least_overlap_mm`: face that has to stay common.
    - `teeth`: gears that differ from their drawing (driving, driven).

    **Raises** `PairError` where no position has this backlash: it says what the stroke can give.

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
    backlash: 1° is not to be had; with 15 mm of common face or more (s from -5 to 5 mm) it is
    -0.3126° to 0.4381°.

    ```
    """
    gears = teeth or (tooth_of(pair, "driving"), tooth_of(pair, "driven"))

    def excess(axial: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
        found = geometric_backlash(pair, centre_distance_mm, axial, teeth=gears)
        return np.asarray(found - backlash_rad)

    stroke = _stroke(gears, least_overlap_mm)
    if not math.isfinite(stroke):
        return _straight(excess, backlash_rad)
    positions = np.linspace(-stroke, stroke, _POSITIONS)
    over = excess(positions)
    if np.isnan(over).any():
        raise PairError(
            "not defined: the working pitch circle lies below a base circle; move the axes apart.",
            where="centre_distance_mm",
        )
    over = np.where(np.abs(over) <= _ROUNDING, 0.0, over)
    crossings = np.flatnonzero(over[:-1] * over[1:] <= 0)
    if not len(crossings):
        low, high = (float(end + backlash_rad) / DEG for end in (over.min(), over.max()))
        raise PairError(
            f"{backlash_rad / DEG:g}° is not to be had; with {least_overlap_mm:g} mm of common face"
            f" or more (s from {-stroke:g} to {stroke:g} mm) it is {low:.4f}° to {high:.4f}°.",
            where="backlash",
        )
    near = np.minimum(np.abs(positions[crossings]), np.abs(positions[crossings + 1]))
    first = int(crossings[np.argmin(near)])
    return _between(excess, positions[first : first + 2], over[first : first + 2])


def _between(excess: Excess, ends: Float[np.ndarray, "2"], over: Float[np.ndarray, "2"]) -> float:
    """The position between two at which the backlash is more and less than wanted."""
    for end, value in zip(ends, over, strict=True):
        if value == 0:
            return float(end)
    return root_scalar(lambda s: float(excess(np.asarray(s))), bracket=tuple(ends), xtol=_STEP).root


def _stroke(gears: Teeth, overlap: float) -> float:
    """How far from s = 0 the gears can be shifted, mm; infinite where a face has no ends."""
    widths = np.array([float(gear.face_width_mm) for gear in gears])
    if np.isnan(widths).any():
        return math.inf
    if not 0 <= overlap <= widths.min():
        raise PairError(
            f"{overlap:g} mm is more than the narrower face has ({widths.min():g} mm) or less than"
            " none; ask for something between.",
            where="least_overlap_mm",
        )
    return float(widths.sum() / 2 - overlap)


def _straight(excess: Excess, wanted: float) -> float:
    """Of a linear recession."""
    start, after = excess(np.array([0.0, 1.0]))
    if start == after:
        raise PairError(
            f"{wanted / DEG:g}° is not to be had; these teeth do not thin along the axis, so that"
            f" it is {(start + wanted) / DEG:.4f}° at every position.",
            where="backlash",
        )
    return float(start / (start - after))
