"""Plateaus of the speed of a run, and the steady stretches at them."""

import numpy as np
from jaxtyping import Bool, Float

SHARE = 0.4
"""The first plateau of a run must hold at least this fraction of the travel of the run (chosen)."""

FURTHER = 0.15
"""Each further plateau must hold at least this fraction of the travel of the run (chosen)."""

TOLERANCE = 0.03
"""Relative tolerance of the speed at a plateau (chosen). A sine motion has 0.24 of its travel
within 3 % of one speed, which is less than `SHARE`."""

RAMP = 0.1
"""A speed that differs from that of the plateau by more than this fraction is a ramp (chosen)."""

FLUCTUATION = 0.3
"""Least deviation from the plateau speed, relative to it, that ends a steady stretch (chosen).
Smaller deviations between two parts at the plateau speed are fluctuations of the drive or errors of
the time stamps; they do not move the contact to the other flank."""

_LEAST, _LONG = 0.01, 10
"""A steady stretch has at least the first fraction of the samples of its run, but a stretch of the
second number of smoothing windows is always long enough: in a long run that changes between two
speeds every stretch is a small fraction (chosen)."""

_BIN = 0.01  # width of the bins of the logarithm of speed


def levels(speed: Float[np.ndarray, " n"], travel: Float[np.ndarray, " n"]) -> list[float]:
    """Return the plateau speeds of a run in rad/s, the plateau with most travel first.

    The list is empty if the run has no steady speed.

    **Arguments**
    - `speed`: magnitudes > 0 in rad/s. `travel`: travel in rad at each sample.
    """
    place = np.log(speed)
    place /= _BIN
    index = np.floor(place, out=place).astype(np.int32)
    del place  # it is as long as the run
    index -= index.min()
    weight = np.bincount(index, travel) / travel.sum()
    width = round(2 * TOLERANCE / _BIN)
    plateaus = []
    needed = SHARE
    while True:
        window = np.convolve(weight, np.ones(width), "valid") if len(weight) > width else None
        start = 0 if window is None else int(np.argmax(window))
        inside = (index >= start) & (index < start + width)
        if weight[start : start + width].sum() < needed:
            return plateaus
        there = np.where(inside, travel, 0.0)
        plateaus.append(float(speed @ there / there.sum()))
        weight[start : start + width] = 0.0
        needed = FURTHER


def steady(
    speed: Float[np.ndarray, " n"], level: float, tolerance: float, window: int
) -> list[tuple[int, int]]:
    """Return stretches [start, stop) of a run at the speed `level` (rad/s), without ends of ramps.

    A sample is at the level if its speed deviates by at most `tolerance` (relative). A stretch
    continues through fluctuations below `FLUCTUATION`. At each end beside a ramp, it is shortened
    by the duration of the ramp from 10 % off the level to the tolerance, and by half the smoothing
    window. `window` is the length of that window in samples.
    """
    deviation = np.abs(speed / level - 1.0)
    stretches = []
    for start, stop in _merged(deviation <= tolerance, deviation > FLUCTUATION, window):
        first = start + _margin(speed[:start][::-1], level, window)
        last = stop - _margin(speed[stop:], level, window)
        if last - first >= 2:
            stretches.append((first, last))
    return stretches


def _margin(outside: Float[np.ndarray, " m"], level: float, window: int) -> int:
    """Return the number of samples to omit at one end of a stretch; see `steady`.

    `outside` holds the speeds beyond this end, the nearest sample first.
    """
    if len(outside) == 0:
        return 0
    ramp = np.abs(outside / level - 1.0) > RAMP
    return window // 2 + (int(np.argmax(ramp)) if ramp.any() else min(len(outside), window))


def _merged(
    inside: Bool[np.ndarray, " n"], outside: Bool[np.ndarray, " n"], window: int
) -> list[tuple[int, int]]:
    """Return the stretches [start, stop) in which `inside` is true, without short stretches.

    Two stretches are joined if at most `window` samples lie between them, or if no sample between
    them is true in `outside`.
    """
    left = np.concatenate([[0], np.cumsum(outside)])
    padded = np.concatenate([[False], inside, [False]])
    edges = np.flatnonzero(padded[1:] != padded[:-1])
    joined: list[list[int]] = []
    for start, stop in zip(edges[::2], edges[1::2], strict=True):
        last = joined[-1][1] if joined else 0
        if joined and (start - last <= window or left[start] == left[last]):
            joined[-1][1] = int(stop)
        else:
            joined.append([int(start), int(stop)])
    least = max(window, min(_LEAST * len(inside), _LONG * window))
    return [(start, stop) for start, stop in joined if stop - start >= least]
