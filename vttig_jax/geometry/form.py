"""Form circle of a tooth, where its fillet meets the flank."""

import math
from dataclasses import replace

import numpy as np
from jaxtyping import Float
from scipy.optimize import root_scalar

from ..base.arrays import Numbers
from .surface import rack_side, side_index
from .tooth import Side, Taper, Tooth

_STEP = 1e-14
"""Tolerance of the direction of the normal, rad, and of a roll angle in a root search (chosen)."""


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
    rack, index = replace(rack_side(tooth, side), recession=Taper(0.0)), side_index(side)
    base = float(tooth.base_radii[index])
    if undercut_depth(tooth, side) <= 0:
        return math.hypot(base, float(rack.joint_length))
    alpha, height = float(rack.pressure_angle), np.zeros(1)
    at_base = float(tooth.base_half_angles[index])

    def fillet(normal_angle: float) -> tuple[float, float]:
        """Return the radius, mm, and the angle from the centre line of the tooth, rad."""
        angle = np.array([normal_angle])
        x, y, _ = rack.to_gear(rack.arc(angle, height), rack.arc_roll(angle))[0]
        return math.hypot(x, y), math.atan2(-rack.mirror * x, y)

    def excess(normal_angle: float) -> float:
        """Return the angle, rad, of the fillet outside the involute; negative where it cuts it."""
        radius, angle = fillet(normal_angle)
        roll = math.sqrt(max((radius / base) ** 2 - 1, 0.0))
        return angle - (at_base - roll + math.atan(roll))

    if fillet(alpha)[0] <= base:  # the whole fillet is inside the base circle
        return base
    ends = (alpha, math.pi / 2)
    on_base = root_scalar(lambda angle: fillet(angle)[0] - base, bracket=ends, xtol=_STEP).root
    if excess(on_base) >= 0 or excess(alpha) <= 0:
        return math.nan  # the undercut of a gear with few teeth cuts through the tooth
    radius = fillet(root_scalar(excess, bracket=(alpha, on_base), xtol=_STEP).root)[0]
    return radius if radius < float(tooth.tip_radius) else math.nan


def radius_where(base_radii: Float[Numbers, "2"], total: float) -> float | None:
    """Return the radius, mm, at which the involute functions of two flanks have a given sum, rad.

        inv α_L(r) + inv α_R(r) = total,    cos α(r) = r_b/r

    Return None if the total is less than the sum at the larger base circle.
    """
    base_radii = np.asarray(base_radii)
    largest = float(base_radii.max())

    def excess(roll: float) -> float:
        """Return the sum minus the total at a roll angle, rad, of the larger base circle."""
        tangents = np.sqrt((1 + roll**2) * (largest / base_radii) ** 2 - 1)
        return float((tangents - np.arctan(tangents)).sum()) - total

    if not excess(0.0) <= 0.0:
        return None
    # At the upper limit inv α > tan α − π/2 of the larger base circle alone exceeds the total.
    bracket = (0.0, total + math.pi / 2)
    root = root_scalar(excess, bracket=bracket, xtol=_STEP, rtol=_STEP).root
    return largest * math.hypot(1.0, root)
