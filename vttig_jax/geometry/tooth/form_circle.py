"""Form circle of a tooth, at which the fillet meets the flank, and depth of its undercut."""

import math
from dataclasses import replace

import numpy as np
from scipy.optimize import root_scalar

from .rack_cutter import RackSide, Side, arc_roll, rack_side, side_index, to_gear
from .recession import Taper
from .roll_limits import half_tooth
from .tooth import Tooth

_STEP = 1e-14
"""Tolerance of the direction of the normal in a root search, rad (chosen)."""


def undercut_depth(tooth: Tooth, side: Side) -> float:
    """Return the depth −y_start − R sin² α, mm, of the rack flank beyond the interference point.

    It is positive for an undercut tooth: the straight flank of the rack extends below the point at
    which the involute ends on the base circle, so the fillet cuts into the flank.

    **Example**
    ```python
    >>> from vttig_jax import Gear, GearPair
    >>> from vttig_jax.geometry import tooth_of, undercut_depth
    >>> gears = Gear(12, face_width_mm=20), Gear(80, face_width_mm=20)
    >>> pair = GearPair(*gears, module_mm=2.0, pressure_angles_deg=20.0)
    >>> round(undercut_depth(tooth_of(pair, "driving"), "left"), 4)
    0.5963

    ```
    """
    rack = rack_side(tooth, side)
    limit = tooth.reference_radius * np.sin(rack.pressure_angle) ** 2
    return float(-rack.flank_start - limit)


def form_radius(tooth: Tooth, side: Side) -> float:
    """Return the radius, mm, at which the involute begins: where the fillet touches or cuts it.

    It is the same in every section, because the recession rotates fillet and flank together. It is
    NaN where an undercut removes the flank up to the tip or cuts through the tooth.

    **Example**
    ```python
    >>> from vttig_jax import Gear, GearPair
    >>> from vttig_jax.geometry import form_radius, tooth_of
    >>> gears = Gear(12, face_width_mm=20), Gear(80, face_width_mm=20)
    >>> pair = GearPair(*gears, module_mm=2.0, pressure_angles_deg=20.0)
    >>> round(form_radius(tooth_of(pair, "driving"), "left"), 4)
    11.3027
    >>> round(form_radius(tooth_of(pair, "driven"), "left"), 4)
    78.1933

    ```
    """
    rack = rack_side(tooth, side)
    base = float(tooth.base_radii[side_index(side)])
    if undercut_depth(tooth, side) <= 0:
        return math.hypot(base, start_of_flank(tooth, side))
    return _crossing(tooth, rack, base)


def start_of_flank(tooth: Tooth, side: Side) -> float:
    """Return the roll length R sin α + y_start/sin α, mm, at the start of the rack's flank."""
    rack = rack_side(tooth, side)
    sine = np.sin(rack.pressure_angle)
    return float(tooth.reference_radius * sine + rack.flank_start / sine)


def _crossing(tooth: Tooth, rack: RackSide, base: float) -> float:
    """Return the radius, mm, at which the fillet of an undercut tooth crosses the involute."""
    rack = replace(rack, recession=Taper(0.0))
    alpha, height = float(rack.pressure_angle), np.zeros(1)
    at_base = float(half_tooth(rack)) + math.tan(alpha) - alpha

    def fillet(normal_angle: float) -> tuple[float, float]:
        """Return the radius, mm, and the angle from the centre line of the tooth, rad."""
        angle = np.array([normal_angle])
        x, y, _ = to_gear(rack, rack.arc(angle, height), arc_roll(rack, angle))[0]
        return math.hypot(x, y), math.atan2(-rack.mirror * x, y)

    def excess(normal_angle: float) -> float:
        """Return the angle, rad, of the fillet outside the involute; negative where it cuts it."""
        radius, angle = fillet(normal_angle)
        roll = math.sqrt(max((radius / base) ** 2 - 1, 0.0))
        return angle - (at_base - roll + math.atan(roll))

    if fillet(alpha)[0] <= base:  # the whole fillet is inside the base circle
        return base
    on_base = root_scalar(
        lambda normal_angle: fillet(normal_angle)[0] - base,
        bracket=(alpha, math.pi / 2),
        xtol=_STEP,
    )
    if excess(on_base.root) >= 0 or excess(alpha) <= 0:
        return math.nan  # the undercut of a gear with few teeth cuts through the tooth
    crossing = root_scalar(excess, bracket=(alpha, on_base.root), xtol=_STEP)
    radius = fillet(crossing.root)[0]
    return radius if radius < float(tooth.tip_radius) else math.nan
