"""When a recorded motion brakes and when it turns."""

from typing import Final

import numpy as np
from jaxtyping import Float
from scipy.interpolate import CubicSpline

BACK: Final = 0.01
"""Share of the recorded range of angles that the shaft must go back to have turned."""

FULL: Final = 0.98
"""Share of the highest speed below which the shaft has begun to brake."""

SLOW: Final = 0.9
"""Share of the highest speed below which a motion that never turns back has slowed down."""

_TOUCHING: Final = 1e-9
"""Share of the range within which two angles are the same."""

_MEAN: Final = 1e-3
"""Share of the run over which a speed is averaged."""

_STEPS: Final = 8
"""Speeds for every time of averaging."""


def turn_of(time: Float[np.ndarray, " n"], angle: Float[np.ndarray, " n"]) -> tuple[float, float]:
    """When the shaft starts to move backwards, s, and the sense of the run before, +1 or −1.

    The sense is that in which the angle first leaves its start by `BACK` of the range of all
    angles. The shaft has turned where it comes back from its farthest angle so far by as much; it
    starts to move backwards at the last row of that farthest angle. Less is play, noise or a count
    to and fro. Without a turn it is the last time.
    """
    away = angle - angle[0]
    least = BACK * np.ptp(angle)
    sense = float(np.sign(away[np.flatnonzero(np.abs(away) > least)[0]]))
    farthest = np.maximum.accumulate(sense * away)
    back = np.flatnonzero(farthest - sense * away > least)
    if not len(back):
        return float(time[-1]), sense
    top = farthest[back[0]] - _TOUCHING * np.ptp(angle)
    return float(time[np.flatnonzero(sense * away[: back[0]] >= top)[-1]]), sense


def braking_of(spline: CubicSpline, turn_s: float, sense: float) -> float:
    """Until when the shaft ran at its highest speed, s.

    Speeds are means over a thousandth of the run, so that one count of an encoder is no speed. The
    middle of the last of them before the turn that reaches `FULL` of the highest is taken; without
    a turn, of the last before the speed first falls below `SLOW` of it.
    """
    end = float(spline.x[-1])
    edges = np.linspace(0.0, end, round(_STEPS / _MEAN) + 1)
    angle = sense * spline(edges)
    gained = angle[_STEPS:] - angle[:-_STEPS]
    middle = 0.5 * (edges[_STEPS:] + edges[:-_STEPS])
    gained = gained[middle <= turn_s]
    if not len(gained) or gained.max() <= 0:
        return turn_s
    highest = gained.max()
    if turn_s == end:
        first = int(np.argmax(gained >= FULL * highest))
        slow = np.flatnonzero(gained[first:] < SLOW * highest)
        gained = gained[: first + slow[0]] if len(slow) else gained
    return min(float(middle[np.flatnonzero(gained >= FULL * highest)[-1]]), turn_s)
