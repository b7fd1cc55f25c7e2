"""Steady stretches of one monotone run: the speeds it dwells at, and where."""

import numpy as np
from jaxtyping import Bool, Float

SHARE = 0.4
"""A run has a plateau when one speed, within the tolerance, makes this share of its travel."""

FURTHER = 0.15
"""Further plateaus of the same run need this share."""

TOLERANCE = 0.03
"""Relative width of a plateau. A sine spends 0.24 of its travel within 3 % of its top speed."""

RAMP = 0.1
"""A speed that differs from the plateau's by more than this share of it is on a ramp."""

_BIN = 0.01


def levels(speed: Float[np.ndarray, " n"], travel: Float[np.ndarray, " n"]) -> list[float]:
    """Plateau speeds of a run, the longest first; empty where the speed never settles.

    **Arguments**
    - `speed`: magnitudes, > 0. `travel`: distance covered around each sample.
    """
    index = np.floor(np.log(speed) / _BIN).astype(np.int64)
    index -= index.min()
    weight = np.bincount(index, travel) / travel.sum()
    width = round(2 * TOLERANCE / _BIN)
    found = []
    needed = SHARE
    while True:
        window = np.convolve(weight, np.ones(width), "valid") if len(weight) > width else None
        start = 0 if window is None else int(np.argmax(window))
        inside = (index >= start) & (index < start + width)
        if weight[start : start + width].sum() < needed:
            return found
        found.append(float(np.average(speed[inside], weights=travel[inside])))
        weight[start : start + width] = 0.0
        needed = FURTHER


def steady(
    speed: Float[np.ndarray, " n"], level: float, tolerance: float, window: int
) -> list[tuple[int, int]]:
    """Stretches [start, stop) of a run at `level`, without the last of their ramps.

    A stretch loses at each end that meets a ramp as much as the ramp took from 10 % off the level
    to the tolerance, and half the smoothing window.
    """
    inside = np.abs(speed / level - 1.0) <= tolerance
    stretches = []
    for start, stop in _closed(inside, window):
        first = start + _margin(speed[:start][::-1], level, window)
        last = stop - _margin(speed[stop:], level, window)
        if last - first >= 2:
            stretches.append((first, last))
    return stretches


def _margin(outside: Float[np.ndarray, " m"], level: float, window: int) -> int:
    """Samples to leave out at an end, from the speeds beyond it, nearest first."""
    if len(outside) == 0:
        return 0
    ramp = np.abs(outside / level - 1.0) > RAMP
    return window // 2 + (int(np.argmax(ramp)) if ramp.any() else min(len(outside), window))


def _closed(inside: Bool[np.ndarray, " n"], window: int) -> list[tuple[int, int]]:
    """True stretches, with interruptions up to a window bridged and flickers dropped."""
    padded = np.concatenate([[False], inside, [False]])
    edges = np.flatnonzero(padded[1:] != padded[:-1])
    joined: list[list[int]] = []
    for start, stop in zip(edges[::2], edges[1::2], strict=True):
        if joined and start - joined[-1][1] <= window:
            joined[-1][1] = int(stop)
        else:
            joined.append([int(start), int(stop)])
    least = max(window, 0.01 * len(inside))
    return [(start, stop) for start, stop in joined if stop - start >= least]
