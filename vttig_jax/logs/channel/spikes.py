"""Readings that stand off their neighbours and come back: late polls, glitches, wild readings.

A *spike* is off the local line of motion while the readings around it are on it; a *step* (a reset,
a lost wrap) stays off and is refused elsewhere. The local line has the median slope of 21 samples
and goes through the median of 11, so that up to five of eleven readings may be wrong, all on the
same side.
"""

import numpy as np
from jaxtyping import Bool, Float, Int, Real

HALF = 5
"""A sample is judged by the line through this many samples on either side."""

REACH = 10
"""Slopes are the median of those at this many samples on either side."""

LAG = 2
"""A slope is taken between the samples this far before and behind."""

QUANTA = 8.01
DEVIATIONS = 10.0
"""A spike is further off than this many steps of the encoder, a number between two whole steps, and
this many robust deviations."""

LOCAL = 8.0
"""… and further than this many times the median deviation of its neighbours: kinks are smooth."""

LATE = 0.3
"""… and further than the shaft moves in this share of a sampling interval."""

MOST = 0.2
"""Share of spikes above which the motion itself must be that rough: then there are none."""

PASSES = 3
"""Spikes that crowd show only when others are taken away."""

_CHUNK = 1 << 16


def spikes(
    angle: Real[np.ndarray, " n"], time: Float[np.ndarray, " n"], quantum: float
) -> Bool[np.ndarray, " n"]:
    """Which samples stand off the motion that their neighbours show.

    **Arguments**
    - `angle`: readings or angles, unwrapped, shape (n,). `time`: s.
    - `quantum`: step of the readings in the unit of `angle`; 0 where they have none.

    **Returns** true at every spike; all false where more than a fifth would be.

    **Example**
    ```python
    >>> import numpy as np
    >>> from vttig_jax.logs.channel.spikes import spikes
    >>> time = np.arange(100) / 500.0
    >>> angle = 360.0 * time
    >>> angle[[30, 31, 70]] -= 2.0
    >>> np.flatnonzero(spikes(angle, time, 0.004)).tolist()
    [30, 31, 70]

    ```
    """
    count = len(angle)
    found = np.zeros(count, bool)
    if count < 2 * REACH + 2 * LAG + 1:
        return found
    cleaned = moved = (angle - angle[0]).astype(np.float64)
    for _ in range(PASSES):
        more = _off(cleaned, time, quantum) & ~found
        if not more.any():
            break
        found |= more
        if np.count_nonzero(found) > MOST * count:
            return np.zeros(count, bool)
        cleaned = without_spikes(moved, time, found)
    return found


def _off(
    angle: Float[np.ndarray, " n"], time: Float[np.ndarray, " n"], quantum: float
) -> Bool[np.ndarray, " n"]:
    """Spikes that stand out while the others are still there."""
    count = len(angle)
    found = np.zeros(count, bool)
    bend = _bend(angle, time)
    if np.abs(bend).max() <= 0.5 * QUANTA * quantum:
        return found
    floor = QUANTA * quantum + DEVIATIONS * _robust(bend) / np.sqrt(1.5)
    # A bend is the spike itself, or half of a neighbour's: all others cannot be spikes.
    rough = np.flatnonzero(np.abs(bend) > 0.5 * floor)
    if len(rough) == 0:
        return found
    near = np.zeros(count, bool)
    for shift in range(-HALF, HALF + 1):
        near[np.clip(rough + shift, 0, count - 1)] = True
    slope = _slopes(angle, time)
    off = np.zeros(count)
    rows = np.flatnonzero(near)
    for start in range(0, len(rows), _CHUNK):
        part = rows[start : start + _CHUNK]
        off[part] = _off_line(angle, time, slope, part)
    rows = np.flatnonzero(np.abs(off) > floor)
    around = LOCAL * np.median(np.abs(off[_window(rows, HALF, count)]), axis=1)
    moved_by = LATE * np.abs(slope[rows]) * np.median(np.diff(time))
    rows = rows[np.abs(off[rows]) > np.maximum(around, moved_by)]
    # The first sample of another motion is on the line of what follows, not of what was.
    for side in (-1, 1):
        rows = rows[np.abs(_off_side(angle, time, slope, rows, side)) > 0.5 * np.abs(off[rows])]
    found[rows] = True
    return found


def without_spikes(
    values: Real[np.ndarray, " n"], time: Float[np.ndarray, " n"], found: Bool[np.ndarray, " n"]
) -> Real[np.ndarray, " n"]:
    """`values` with those that are `found` interpolated in time; integers stay integers.

    **Arguments**
    - `values`: unwrapped readings or angles. `time`: s. `found`: as from `spikes`.
    """
    if not found.any() or found.all():
        return values
    good = np.flatnonzero(~found)
    index = np.flatnonzero(found)
    after = np.clip(np.searchsorted(good, index), 0, len(good) - 1)
    before = good[np.maximum(np.searchsorted(good, index) - 1, 0)]
    after = good[after]
    span = time[after] - time[before]
    share = np.divide(
        time[index] - time[before], span, out=np.full(len(index), 0.5), where=span > 0
    )
    share = np.clip(share, 0.0, 1.0)
    cleaned = values.copy()
    # The difference is small where the readings are not: large integers lose nothing.
    step = share * (values[after] - values[before])
    if np.issubdtype(values.dtype, np.integer):
        step = np.rint(step).astype(values.dtype)
    cleaned[index] = values[before] + step
    return cleaned


def _bend(angle: Float[np.ndarray, " n"], time: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Deviation of each sample from the line between both neighbours; the ends have that beside."""
    span = time[2:] - time[:-2]
    share = np.divide(time[1:-1] - time[:-2], span, out=np.full_like(span, 0.5), where=span > 0)
    inner = angle[1:-1] - angle[:-2] - share * (angle[2:] - angle[:-2])
    return np.pad(inner, 1, mode="edge")


def _robust(values: Float[np.ndarray, " n"]) -> float:
    """Standard deviation by the median deviation from the median."""
    return float(np.median(np.abs(values - np.median(values)))) / 0.6745


def _slopes(
    angle: Float[np.ndarray, " n"], time: Float[np.ndarray, " n"]
) -> Float[np.ndarray, " n"]:
    """Median of the slopes over ±`LAG` samples within ±`REACH` samples."""
    from scipy.ndimage import median_filter

    rise, run = angle[2 * LAG :] - angle[: -2 * LAG], time[2 * LAG :] - time[: -2 * LAG]
    usual = np.median(run)
    each = rise / np.maximum(run, 1e-3 * usual if usual > 0 else 1.0)
    return np.pad(median_filter(each, 2 * REACH + 1, mode="mirror"), LAG, mode="edge")


def _window(rows: Int[np.ndarray, " m"], half: int, count: int) -> Int[np.ndarray, "m w"]:
    """Indices of 2 `half` + 1 samples around each row, shifted inwards at the ends."""
    start = np.clip(rows - half, 0, count - 2 * half - 1)
    return start[:, None] + np.arange(2 * half + 1)


def _off_line(
    angle: Float[np.ndarray, " n"],
    time: Float[np.ndarray, " n"],
    slope: Float[np.ndarray, " n"],
    rows: Int[np.ndarray, " m"],
) -> Float[np.ndarray, " m"]:
    """Distance of the samples `rows` above the median of their neighbours, moved along the line."""
    near = _window(rows, HALF, len(angle))
    ahead = angle[near] - slope[rows, None] * (time[near] - time[rows, None])
    return angle[rows] - np.median(ahead, axis=1)


def _off_side(
    angle: Float[np.ndarray, " n"],
    time: Float[np.ndarray, " n"],
    slope: Float[np.ndarray, " n"],
    rows: Int[np.ndarray, " m"],
    side: int,
) -> Float[np.ndarray, " m"]:
    """Distance of the samples `rows` above the line of those before (−1) or after (+1) them.

    Infinite at the ends of the log, where there is no such line.
    """
    count = len(angle)
    near = rows[:, None] + side * np.arange(1, 2 * HALF)
    inside = (near[:, -1] >= 0) & (near[:, -1] < count)
    near = np.clip(near, 0, count - 1)
    beside = slope[np.clip(rows + side * (REACH + 1), 0, count - 1)]
    ahead = angle[near] - beside[:, None] * (time[near] - time[rows, None])
    return np.where(inside, angle[rows] - np.median(ahead, axis=1), np.inf)
