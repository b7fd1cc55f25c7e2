"""TE of both flanks of an eccentric pair in plain Python, written from the formulas.

Lengths mm, angles rad. `closed` is the first-order form with the working pressure angle,

    TE_A = K [e₁ sin(φ₁ + θ₁ + α) + e₂ sin(i φ₁ + θ₂ − α)],  TE_B: α → −α, plus j_c,  K = 1/r_b2

and `exact` the common tangent of both base circles, solved for φ₂ by iteration. Each gives the two
functions φ₁ → (TE, dTE/dφ₁).
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

Wall = Callable[[float], tuple[float, float]]
"""φ₁ → (TE, dTE/dφ₁) of one flank."""


@dataclass(frozen=True)
class Pair:
    """Spur gears on eccentric base circles; eccentricities (e, θ) of gear 1 and 2."""

    teeth: tuple[int, int] = (45, 80)
    module: float = 2.0
    pressure_angle: float = math.radians(20.0)
    centre_distance: float = 125.12
    driving: tuple[float, float] = (0.0226, math.radians(49.5))
    driven: tuple[float, float] = (0.0273, math.radians(79.3))
    constant_backlash: float = math.radians(0.038)

    @property
    def ratio(self) -> float:
        return self.teeth[0] / self.teeth[1]

    @property
    def base_radii(self) -> tuple[float, float]:
        scale = self.module / 2 * math.cos(self.pressure_angle)
        return self.teeth[0] * scale, self.teeth[1] * scale


PAPER = Pair()
"""Tables 1 and 2 of the paper, constant backlash 0.038°."""


def closed(pair: Pair = PAPER) -> tuple[Wall, Wall]:
    """Both flanks to first order in the eccentricities."""
    working = math.acos(sum(pair.base_radii) / pair.centre_distance)
    scale, ratio = 1 / pair.base_radii[1], pair.ratio

    def wall(sense: float, offset: float) -> Wall:
        first = pair.driving[1] + sense * working
        second = pair.driven[1] - sense * working
        sizes = scale * pair.driving[0], scale * pair.driven[0]

        def at(angle: float) -> tuple[float, float]:
            one, other = angle + first, ratio * angle + second
            error = sizes[0] * math.sin(one) + sizes[1] * math.sin(other) + offset
            return error, sizes[0] * math.cos(one) + ratio * sizes[1] * math.cos(other)

        return at

    return wall(1.0, 0.0), wall(-1.0, pair.constant_backlash)


def exact(pair: Pair = PAPER) -> tuple[Wall, Wall]:
    """Both flanks without approximation; the slope is a central difference (1e-9 rad/rad)."""
    total, ratio = sum(pair.base_radii), pair.ratio

    def involute(distance: float) -> float:
        angle = math.acos(total / distance)
        return math.tan(angle) - angle

    nominal = involute(pair.centre_distance)

    def error(angle: float, sense: float, offset: float) -> float:
        found = 0.0
        for _ in range(12):
            first = angle + pair.driving[1]
            second = ratio * angle + found + pair.driven[1]
            along = pair.centre_distance + pair.driven[0] * math.cos(second)
            along -= pair.driving[0] * math.cos(first)
            across = -pair.driven[0] * math.sin(second) - pair.driving[0] * math.sin(first)
            opening = involute(math.hypot(along, across)) - nominal
            found = offset - (1 + ratio) * (math.atan2(across, along) + sense * opening)
        return found

    def wall(sense: float, offset: float) -> Wall:
        def at(angle: float) -> tuple[float, float]:
            step = 1e-4
            ahead, behind = (error(angle + s, sense, offset) for s in (step, -step))
            return error(angle, sense, offset), (ahead - behind) / (2 * step)

        return at

    return wall(1.0, 0.0), wall(-1.0, pair.constant_backlash)


def steady(lower: float, upper: float) -> tuple[Wall, Wall]:
    """Centred gears: constant flanks."""
    return (lambda _: (lower, 0.0)), (lambda _: (upper, 0.0))
