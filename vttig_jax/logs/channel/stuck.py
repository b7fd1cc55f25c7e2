"""A channel that stands still while the other shaft turns: stuck, saturated, out of mesh."""

from fractions import Fraction

import numpy as np
from jaxtyping import Float

from ...base.errors import LogError
from ...base.units import DEG
from ..source import Source
from .channel import Channel

FAR = 5 * DEG
"""Turn of the driven shaft, far beyond any backlash, that a channel may not miss."""

QUANTA = 8.0
"""… nor may it miss this many steps of the coarser encoder."""

STILL = 0.02
"""Share of the motion that a stuck channel may show."""

SHORTEST = 20
"""Samples of the shortest stretch looked at; longer ones by factors of 4."""


def refuse_stuck(
    driving: Channel,
    driven: Channel,
    ratio: Fraction,
    time: Float[np.ndarray, " n"],
    source: Source,
) -> None:
    """Raise `LogError` naming the lines where one channel stands while the other turns.

    **Arguments**
    - `driving`, `driven`: the channels. `ratio`: driven over driving speed. `time`: s.
    """
    size = abs(float(ratio))
    first, second = size * driving.steady_angle(time), driven.steady_angle(time)
    unit = max(driven.resolution, size * driving.resolution)
    for role, own, other in (("driven", second, first), ("driving", first, second)):
        # By what the log shows, not by the ratio given: a wrong ratio is no standstill.
        share = min(1.0, float(np.ptp(own)) / max(float(np.ptp(other)), 1e-300))
        found = _stuck(own, share * other, max(FAR, QUANTA * unit), 2 * unit)
        if found is None:
            continue
        start, stop = found
        turned = float(np.ptp(other[start:stop])) / DEG / (1.0 if role == "driving" else size)
        moving = "driven" if role == "driving" else "driving"
        last = source.at(role, stop - 1).rpartition(": ")[2].partition(",")[0]
        raise LogError(
            f"the {role} channel stands still from {time[start]:.6g} s to {time[stop - 1]:.6g} s"
            f" ({last}) while the {moving} shaft turns by {turned:.3g}°: its encoder is stuck,"
            " saturated or not connected, or the gears are out of mesh; cut these lines out or log"
            " again.",
            where=source.at(role, start),
        )


def _stuck(
    own: Float[np.ndarray, " n"], other: Float[np.ndarray, " n"], far: float, dither: float
) -> tuple[int, int] | None:
    """First stretch [start, stop) where `other` moves by `far` and more and `own` does not."""
    length = SHORTEST
    while length <= len(own):
        edges = np.arange(0, len(own) - length + 1, length)
        spans = [
            np.maximum.reduceat(angle, edges) - np.minimum.reduceat(angle, edges)
            for angle in (own, other)
        ]
        stuck = (spans[1] >= far) & (spans[0] <= np.maximum(STILL * spans[1], dither))
        if stuck.any():
            row = int(edges[np.argmax(stuck)])
            return _extent(own, row, row + length, max(STILL * far, dither))
        length *= 4
    return None


def _extent(own: Float[np.ndarray, " n"], start: int, stop: int, slack: float) -> tuple[int, int]:
    """The whole stretch around [start, stop) that stays within `slack`."""
    level = own[(start + stop) // 2]
    off = np.abs(own - level) > slack
    before = np.flatnonzero(off[:start])
    after = np.flatnonzero(off[stop:])
    return (
        int(before[-1]) + 1 if len(before) else 0,
        stop + int(after[0]) if len(after) else len(own),
    )
