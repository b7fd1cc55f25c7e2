"""A driven shaft that flies between rigid flanks, from impact to impact.

    J φ̈₂ = −T_c sgn φ̇₂ in the gap,  ẇ⁺ = −ε ẇ⁻ of the relative speed at a flank

Flights are parabolas that end in rest; impacts are roots of the distance, found by bracketing in
small steps and brentq. A rebound slower than `_SLOWEST` stays on the flank, which carries the shaft
while it has to push, J φ̈₂ + T_c sgn φ̇₂ > 0 on flank A.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq

from .flank_formulas import Wall
from .trapezoid_corners import Corners

_LOOK = 1e-4
"""s between two looks at the distance."""

_SLOWEST = 1e-6
"""rad/s."""


@dataclass(frozen=True)
class Rig:
    """Torque N m, inertia kg m²; `restitution` is ε."""

    walls: tuple[Wall, Wall]
    motion: Corners
    ratio: float
    inertia: float
    coulomb: float
    restitution: float

    def wall(self, side: int, time: float) -> tuple[float, float]:
        """Where the shaft stands on flank A (0) or B (1), and how fast that moves."""
        angle, speed, _ = self.motion.at(time)
        error, slope = self.walls[side](angle)
        return self.ratio * angle + error, (self.ratio + slope) * speed

    def load(self, side: int, time: float) -> float:
        """Torque that the flank has to exert to take the shaft along; negative: it lets go."""
        step, sense = 1e-4, 1 - 2 * side
        angle, speed, gaining = self.motion.at(time)
        ahead, here, behind = (self.walls[side](angle + s)[1] for s in (step, 0.0, -step))
        bend = (ahead - behind) / (2 * step)
        acceleration = (self.ratio + here) * gaining + bend * speed**2
        friction = self.coulomb * np.sign((self.ratio + here) * speed)
        return sense * (self.inertia * acceleration + friction)


@dataclass
class Flown:
    """x at the times asked for; (time, flank, relative speed before) of every impact."""

    offset: np.ndarray
    impacts: list[tuple[float, int, float]]


def fly(rig: Rig, start: tuple[float, float], times: np.ndarray, carried: int | None) -> Flown:
    """Follow the shaft from (φ₂, φ̇₂), lying on flank `carried` at first."""
    time, end = float(times[0]), float(times[-1])
    place, speed = start
    path, impacts = np.empty(len(times)), []
    while True:
        if carried is None:
            follow = _flight(rig, time, place, speed)
            until, flank = _impact(rig, follow, time, end)
        else:
            follow, flank = _along(rig, carried), None
            until = _first(lambda t, side=carried: -rig.load(side, t), time, end)
        chosen = (times >= time) & ((times < until) | (until >= end))
        path[chosen] = [follow(t)[0] - rig.ratio * rig.motion.at(t)[0] for t in times[chosen]]
        if until >= end:
            return Flown(path, impacts)
        time = until
        place, speed = follow(time)
        carried = None
        if flank is not None:
            rate = rig.wall(flank, time)[1]
            impacts.append((time, flank, speed - rate))
            speed = rate - rig.restitution * (speed - rate)
            if abs(speed - rate) < _SLOWEST:
                carried = flank if rig.load(flank, time) > 0 else None
                speed = rate


def _flight(rig: Rig, begin: float, place: float, speed: float):
    slowing = rig.coulomb / rig.inertia
    flies = abs(speed) / slowing if slowing > 0 else np.inf

    def at(time: float) -> tuple[float, float]:
        spent = min(time - begin, flies)
        braked = slowing * np.sign(speed) * spent
        return place + spent * (speed - braked / 2), speed - braked

    return at


def _along(rig: Rig, side: int):
    return lambda time: rig.wall(side, time)


def _impact(rig: Rig, follow, begin: float, end: float) -> tuple[float, int | None]:
    """When a flight first comes beyond a flank, and which."""
    hits = []
    for side, sense in ((0, 1), (1, -1)):

        def beyond(time, side=side, sense=sense):
            return sense * (rig.wall(side, time)[0] - follow(time)[0])

        hits.append((_first(beyond, begin, end), side))
    time, side = min(hits)
    return (time, side) if time < end else (end, None)


def _first(value: Callable[[float], float], begin: float, end: float) -> float:
    """When a value first rises above zero; `end` if never. It may start at zero."""
    time = begin + 1e-9
    if value(time) > 0 and value(begin + 1e-7) > 0:
        return begin
    while time < end:
        later = min(time + _LOOK, end)
        if value(later) > 0:
            if value(time) >= 0:
                return time
            return float(np.asarray(brentq(value, time, later, xtol=1e-15)))
        time = later
    return end
