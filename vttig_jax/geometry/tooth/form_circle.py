"""Where fillet and flank of a tooth meet, and how deep an undercut reaches."""

import math
from dataclasses import replace

import numpy as np
from scipy.optimize import root_scalar

from .rack_cutter import RackSide, Side, arc_roll, rack_side, side_index, to_gear
from .recession import Taper
from .roll_limits import half_tooth
from .tooth import Tooth

_STEP = 1e-14
"""Of the direction of the normal, rad, at which a search stops."""


def undercut_depth(tooth: Tooth, side: Side) -> float:
    """By how much the straight flank of the rack reaches beyond the interference point, mm.

        −y_start − R sin² α

    Positive where the tooth is undercut: the rack's flank would go on along the involute below the
    base circle, which is not there, and the fillet cuts into the flank instead.

    **Example**
    ```python
    >>> from vttig_jax import Gear, GearPair
    >>> from vttig_jax.geometry import undercut_depth
    >>> from vttig_jax.geometry import tooth_of
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
    """Radius at which the involute begins, mm: where the fillet touches it, or cuts it.

    The same in every section, as the recession turns both. NaN where an undercut leaves nothing of
    the flank below the tip, or goes right through the tooth.

    **Example**
    ```python
    >>> from vttig_jax import Gear, GearPair
    >>> from vttig_jax.geometry import form_radius
    >>> from vttig_jax.geometry import tooth_of
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
    """Unwound length R sin α + y_start/sin α at which the rack's straight flank starts, mm."""
    rack = rack_side(tooth, side)
    sine = np.sin(rack.pressure_angle)
    return float(tooth.reference_radius * sine + rack.flank_start / sine)


def _crossing(tooth: Tooth, rack: RackSide, base: float) -> float:
    """Radius at which the fillet of an undercut tooth crosses the involute."""
    rack = replace(rack, recession=Taper(0.0))
    alpha, height = float(rack.pressure_angle), np.zeros(1)
    at_base = float(half_tooth(rack)) + math.tan(alpha) - alpha

    def fillet(steep: float) -> tuple[float, float]:
        """Radius and angle from the centre line of the tooth."""
        angle = np.array([steep])
        x, y, _ = to_gear(rack, rack.arc(angle, height), arc_roll(rack, angle))[0]
        return math.hypot(x, y), math.atan2(-rack.mirror * x, y)

    def standing_out(steep: float) -> float:
        """Angle by which the fillet stands out of the involute; negative where it cuts it."""
        radius, angle = fillet(steep)
        unwound = math.sqrt(max((radius / base) ** 2 - 1, 0.0))
        return angle - (at_base - unwound + math.atan(unwound))

    if fillet(alpha)[0] <= base:  # a fillet all inside the base circle, where no involute is
        return base
    on_base = root_scalar(
        lambda steep: fillet(steep)[0] - base, bracket=(alpha, math.pi / 2), xtol=_STEP
    )
    if standing_out(on_base.root) >= 0 or standing_out(alpha) <= 0:
        return math.nan  # gears of a few teeth, cut right through
    crossing = root_scalar(standing_out, bracket=(alpha, on_base.root), xtol=_STEP)
    radius = fillet(crossing.root)[0]
    return radius if radius < float(tooth.tip_radius) else math.nan
