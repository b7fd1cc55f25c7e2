"""Detection of a channel that stands still while the other shaft turns (chosen limits)."""

from fractions import Fraction

import numpy as np
from jaxtyping import Float

from ...base.errors import LogError
from ...base.units import DEG
from ..source import Source
from .channel import Channel

FAR = 5 * DEG
"""Least turn of the moving shaft for a test, in rad of the driven shaft; it is much larger than any
backlash."""

QUANTA = 8.0
"""Least turn for a test, in steps of the coarser of the two encoders."""

STILL = 0.02
"""A channel is stuck if it moves by at most this fraction of the motion of the other shaft."""

ONE_WAY = 0.9
"""A shaft turns one way if the angle between the ends is at least this share of its range."""

SOON = 0.5
"""A crossing of the gap begins within this share of its length after the reversal. The driven shaft
may follow at first, because its friction and a soft drive hold the contact."""

LONGER = 1.2
"""Largest crossing at the end of a log, as a multiple of the widest crossing before (chosen)."""

SHORTEST = 20
"""Length of the shortest tested stretch in samples; each next length is 4 times as long."""


def refuse_stuck(
    driving: Channel,
    driven: Channel,
    ratio: Fraction,
    time: Float[np.ndarray, " n"],
    source: Source,
) -> None:
    """Raise `LogError` naming the lines where one channel stands still while the other turns.

    A driven channel that stands still only behind a reversal of the driving shaft, and follows it
    again, crosses a gap and is not refused.

    **Arguments**
    - `driving`, `driven`: the channels. `ratio`: driven over driving speed. `time`: time in s.
    """
    size = abs(float(ratio))
    first, second = (driving.steady_angle(time), size), (driven.steady_angle(time), 1.0)
    quantum = max(driven.resolution, size * driving.resolution)
    for role, one, other in (("driven", second, first), ("driving", first, second)):
        # The scale comes from the log, because a wrong ratio in the pair file is no standstill.
        turn, span = (gain * float(np.ptp(angle)) for angle, gain in (one, other))
        scale = min(1.0, turn / max(span, 1e-300))
        moved = other[0], scale * other[1]
        stretch = _stuck(one, moved, max(FAR, QUANTA * quantum), 2 * quantum, gaps=role == "driven")
        if stretch is None:
            continue
        start, stop = stretch
        turned = float(np.ptp(other[0][start:stop])) / DEG
        moving = "driven" if role == "driving" else "driving"
        last = source.at(role, stop - 1).rpartition(": ")[2].partition(",")[0]
        raise LogError(
            f"the {role} channel stands still from {time[start]:.6g} s to {time[stop - 1]:.6g} s"
            f" ({last}) while the {moving} shaft turns by {turned:.3g}°: its encoder is stuck,"
            " saturated or not connected, or the gears are out of mesh; cut these lines out or log"
            " again.",
            where=source.at(role, start),
        )


Gained = tuple[Float[np.ndarray, " n"], float]
"""Angle of a shaft in rad, and the factor that makes it an angle of the driven shaft."""


def _stuck(
    one: Gained, other: Gained, far: float, dither: float, *, gaps: bool
) -> tuple[int, int] | None:
    """Return the first stretch [start, stop) where `other` moves and `one` stands still, or None.

    `other` must move by at least `far`; `one` may move by `STILL` of that motion, or by `dither`.
    Both are in rad of the driven shaft. With `gaps`, stretches behind a reversal do not count.
    """
    (angle, gain), length = one, SHORTEST
    while length <= len(angle):
        edges = np.arange(0, len(angle) - length + 1, length)
        spans = [
            factor * (np.maximum.reduceat(shaft, edges) - np.minimum.reduceat(shaft, edges))
            for shaft, factor in (one, other)
        ]
        stuck = (spans[1] >= far) & (spans[0] <= np.maximum(STILL * spans[1], dither))
        stop, widest = 0, 0.0
        for row in edges[stuck].tolist():
            if row < stop:
                continue
            start, stop = _extent(angle, row, row + length, max(STILL * far, dither) / gain)
            turned = float(np.ptp(other[0][start:stop]))
            # At the end of a log only the earlier crossings show that the shaft follows again.
            follows = stop < len(angle) or turned <= LONGER * widest
            if not (gaps and follows and _is_crossing(other[0], start, stop)):
                return start, stop
            widest = max(widest, turned)
        length *= 4
    return None


def _is_crossing(angle: Float[np.ndarray, " n"], start: int, stop: int) -> bool:
    """Return whether a shaft turns one way in [start, stop), shortly after a reversal."""
    part = angle[start:stop]
    turned, span = float(part[-1] - part[0]), float(np.ptp(part))
    if abs(turned) < ONE_WAY * span:
        return False
    ahead = (angle[:start] - part[0]) * np.sign(turned)
    earlier = np.flatnonzero(ahead > (1 - ONE_WAY) * span)
    since = ahead[earlier[-1] + 1 :] if len(earlier) else ahead
    return float(-since.min(initial=0.0)) <= SOON * span


def _extent(angle: Float[np.ndarray, " n"], start: int, stop: int, slack: float) -> tuple[int, int]:
    """Return the longest stretch around [start, stop) in which the angle stays constant.

    It may differ by up to `slack`, in rad, from its value in the middle of [start, stop).
    """
    level = angle[(start + stop) // 2]
    outside = np.abs(angle - level) > slack
    before = np.flatnonzero(outside[:start])
    after = np.flatnonzero(outside[stop:])
    return (
        int(before[-1]) + 1 if len(before) else 0,
        stop + int(after[0]) if len(after) else len(angle),
    )
