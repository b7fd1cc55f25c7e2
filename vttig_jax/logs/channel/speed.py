"""Speed of a shaft, smoothed over many encoder steps, and readings that are no motion.

A *spike* (a late poll, a glitch, a wrong reading) lies off the local line of motion while the
readings around it lie on that line. A *step* (a reset, a lost wrap) does not return and is refused
(`channel.py`). The local line has the median slope of 21 samples and passes through the median of
11 samples, so that up to five of eleven readings may be wrong, even all on the same side.

A turning shaft repeats a reading if the logger stalls or samples it at a lower rate. A channel that
was read once or several times at each of its places holds readings at standstill. All limits are
chosen values.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Float, Int, Real, Shaped

from ...base.numerics.counting import pieces

TRAVEL = 199.9
"""Travel, in quanta (encoder steps), of one speed difference at top speed; a quantum is then 0.5 %
of the travel. This limit and the two below are chosen and deliberately not round: counters travel
whole counts, and rounding errors would decide about a travel that lies exactly on a limit."""

DWELL = 0.010_001
"""Speeds below this fraction of the top speed are standstill."""

STILL = 4.5
"""Speeds below this many quanta per smoothing window are standstill."""

_FINER = 4  # a finer window counts if it is shorter by this factor; chosen value
_LOOKS = 3  # measurements of the top speed over the finer window; chosen value
_FEWEST, _MOST = 100, 20_000  # least samples for a finer window, most for its noise; chosen values


@dataclass(frozen=True)
class Speed:
    """Smoothed speed `value` in rad/s; each speed difference spans `window` samples.

    `quantum` is the angle step or noise in rad. Speeds below `dwell` (rad/s) are standstill.
    """

    value: Float[np.ndarray, " n"]
    window: int
    quantum: float
    dwell: float


def smooth_speed(
    time: Float[np.ndarray, " n"], angle: Float[np.ndarray, " n"], resolution: float
) -> Speed:
    """Return the speed at each sample k as (φ_{k+w/2} − φ_{k−w/2}) / (t_{k+w/2} − t_{k−w/2}).

    At the top speed the window w covers `TRAVEL` quanta; a quantum is the larger of `resolution`
    in rad and twice the noise. The window is at most a twentieth of the log, and shorter at the
    ends. Spikes are interpolated first.

    Noise and top speed are measured twice. The first measurement is right if the speed changes
    little during a hundredth of the log. The second one follows fast changes, such as those of a
    sine motion. If its window is at most a quarter of the first window, the second one counts.
    """
    angle = without_spikes(angle, time, spikes(angle, time, resolution))
    count = len(time)
    interval = float(np.median(np.diff(time)))

    def half_window(quantum: float, top: float) -> int:
        # The top speed is 0 if the readings change in their spikes only.
        needed = np.ceil(TRAVEL * quantum / max(top * interval, 1e-300) / 2)
        return int(np.clip(needed, 1, max(1, count // 40)))

    top = _top_speed(time, angle, max(1, count // 100), interval)
    noise = robust_deviation(bends(angle, time)[1:-1]) / np.sqrt(1.5)
    quantum = max(resolution, 2.0 * noise)
    half = half_window(quantum, top)
    if half >= _FINER and count >= _FEWEST:
        fine_quantum = max(resolution, 2.0 * cubic_noise(time, angle))
        fine_top, fine_half = top, half_window(fine_quantum, top)
        for _ in range(_LOOKS):
            fine_top = max(fine_top, _top_speed(time, angle, 2 * fine_half, interval))
            fine_half = half_window(fine_quantum, fine_top)
        if _FINER * fine_half <= half:
            quantum, top, half = fine_quantum, fine_top, fine_half
    value = np.empty(count)
    for part in pieces(count):
        place = np.arange(part.start, part.stop)
        low, high = np.maximum(place - half, 0), np.minimum(place + half, count - 1)
        elapsed = np.maximum(time[high] - time[low], 1e-3 * interval)
        value[part] = (angle[high] - angle[low]) / elapsed
    dwell = max(DWELL * top, STILL * quantum / (2 * half * interval))
    return Speed(value, 2 * half, quantum, float(dwell))


def _top_speed(
    time: Float[np.ndarray, " n"], angle: Float[np.ndarray, " n"], lag: int, interval: float
) -> float:
    """Return the 95 % quantile of the magnitude of the speed over `lag` samples, rad/s.

    If the shaft stands still for most of the log, it is the largest speed. `interval` is the least
    time that counts, s.
    """
    speed = np.abs(angle[lag:] - angle[:-lag]) / np.maximum(time[lag:] - time[:-lag], interval)
    return float(np.quantile(speed, 0.95, overwrite_input=True)) or float(speed.max())


def runs(
    state: Shaped[np.ndarray, " n"], cut: Bool[np.ndarray, " n"] | None = None
) -> list[tuple[int, int]]:
    """Return stretches [start, stop) of equal `state`; each true `cut` starts a new stretch."""
    change = state[1:] != state[:-1]
    change = np.flatnonzero(change if cut is None else change | cut[1:]) + 1
    edges = [0, *change.tolist(), len(state)]
    return list(pairwise(edges))


def cubic_noise(time: Float[np.ndarray, " n"], angle: Float[np.ndarray, " n"]) -> float:
    """Return a robust standard deviation of the angle noise in rad; no acceleration increases it.

    It comes from the deviation of samples from the cubic through their four neighbours. At most
    20 000 samples are used.
    """
    places = np.linspace(2, len(time) - 3, min(len(time) - 4, _MOST)).astype(np.int64)
    rest, square = angle[places].copy(), np.ones(len(places))
    around = (-2, -1, 1, 2)
    for own in around:
        share = np.ones(len(places))
        for other in around:
            if other != own:
                apart = time[places + own] - time[places + other]
                away = time[places] - time[places + other]
                share *= np.divide(away, apart, out=np.full_like(away, np.nan), where=apart != 0)
        rest -= share * angle[places + own]
        square += share**2
    known = np.isfinite(rest)
    return robust_deviation((rest / np.sqrt(square))[known]) if known.any() else 0.0


LONG_S = 0.5
"""Least time between two readings, each of which a shaft approached from standstill (chosen)."""

SAME = 0.02
"""A step below this share of the usual one is a further reading at a place (chosen)."""

_PART = 0.3
"""A larger step below this share is part of a motion (chosen)."""

_UNEVEN = 0.06
"""Least relative deviation of the times between readings, with which steps that are more alike than
speeds tell that no shaft turned (chosen)."""

_HELD = 0.7
"""Least share of the time for which a shaft is held at its places, each for `LONG_S`, where the
moves between them were recorded too (chosen)."""

_HOLDS = 20
"""Least number of such places (chosen)."""

_RESTS = 0.9
"""Least share of steps behind which a shaft rests for at least one more reading (chosen)."""


def steps_of(values: Real[np.ndarray, " n"], turn: int | float | None) -> Float[np.ndarray, " m"]:
    """Return the steps between readings, the shortest way where they wrap at `turn`."""
    step = np.diff(values.astype(np.float64, copy=False))
    if turn is not None and len(step) and float(np.ptp(values)) < turn:
        np.subtract(step, turn, out=step, where=step > 0.5 * turn)
        np.add(step, turn, out=step, where=step < -0.5 * turn)
    return step


def usual_step(step: Float[np.ndarray, " m"]) -> float:
    """Return the size of the steps that make half of the travel of a channel."""
    ordered = np.abs(step)
    ordered.sort()
    travel = np.cumsum(ordered)
    return float(ordered[np.searchsorted(travel, 0.5 * travel[-1])]) if len(travel) else 0.0


_LEVEL = 0.02
"""Width of a level as a share of the largest reading; a level is held if more of all readings are
there (chosen)."""


def looks_like_speed(values: Real[np.ndarray, " n"]) -> bool:
    """Return whether readings rest at 0 and at equal values of both signs, as those of a speed do.

    An angle seldom does, because its zero is arbitrary and a shaft that is measured moves.
    """
    values = values[:: 1 + len(values) // 5000]  # which show the levels
    bins = np.rint(values / (_LEVEL * np.abs(values).max(initial=1e-300))).astype(np.int64)
    levels, counts = np.unique(bins, return_counts=True)
    held = counts > _LEVEL * len(bins)
    top = int(levels[held].max(initial=0))
    rests = bool(top >= 2 and np.sum(counts[held]) >= 0.6 * len(bins))
    return rests and all(np.abs(levels[held] - level).min() <= 1 for level in (0, top, -top))


def is_at_standstill(
    signed: Float[np.ndarray, " m"], time: Float[np.ndarray, " n"], *, clock: bool
) -> bool:
    """Return whether a channel whose readings are the steps `signed` apart was read at standstill.

    No step between two readings is then a part of the usual step, as on a ramp or at a reversal,
    and readings have no `clock` but a stated rate of at most two a second. With a clock the
    readings tell it if every place has several and is held for `LONG_S`, which the counts of a
    turning shaft are not, or if unequal times made steps that are alike, or if a shaft is held at
    places most of the time, with a few readings on the way from one to the next.
    Small steps that go on in one direction are motion beside the wraps of a large counter.
    """
    usual = usual_step(signed)
    moved = np.abs(signed) > SAME * usual
    if clock and len(signed) and np.mean(moved) < 1 - _HELD:
        ends = np.concatenate([[0], np.flatnonzero(moved), [len(signed)]])
        held = time[ends[1:]] - time[np.minimum(ends[:-1] + (ends[:-1] > 0), ends[1:])]
        held = held[held >= LONG_S]
        if len(held) >= _HOLDS and held.sum() >= _HELD * (time[-1] - time[0]):
            return True
    if len(signed) < 3 or np.any(moved & (np.abs(signed) < _PART * usual)):
        return False
    small = np.where(moved, np.int8(0), (signed > 0) - (signed < 0).astype(np.int8))[signed != 0]
    if np.sum(small[1:] * small[:-1]) > 0:  # noise turns back more often than not
        return False
    took = np.diff(time)
    slow = bool(np.mean(took >= LONG_S) >= 0.5)
    if not clock or (moved[:-1].any() and np.mean(~moved[1:][moved[:-1]]) >= _RESTS):
        held = np.diff(time[:-1][moved], prepend=-np.inf)
        return slow or (clock and bool(np.median(held) >= LONG_S))
    if not slow:
        return False
    step, took = np.abs(signed[moved]), took[moved]
    uneven, steps, speeds = (
        float(np.std(one)) / max(float(np.mean(one)), 1e-300)
        for one in (took, step, step / np.maximum(took, 1e-300))
    )
    return uneven > _UNEVEN and speeds**2 > 2 * steps**2


HALF = 5
"""Number of samples on either side that define the local line."""

REACH = 10
"""Number of samples on either side for the median of the slopes."""

LAG = 2
"""Number of samples before and after between which a slope is taken."""

QUANTA = 8.01
DEVIATIONS = 10.0
"""A spike deviates from the local line by more than `QUANTA` encoder steps plus `DEVIATIONS`
standard deviations. `QUANTA` lies between whole steps, so that rounding does not decide."""

NEIGHBOUR_FACTOR = 8.0
"""A spike deviates by more than this factor times the median deviation of its neighbours; at a kink
of the motion the neighbours deviate too."""

INTERVAL_SHARE = 0.3
"""A spike deviates by more than the travel of the shaft in this fraction of a sampling interval."""

MAX_SHARE = 0.2
"""If a larger fraction of the samples deviates, the motion itself is rough and has no spikes."""

_AT_ONCE = 4096
"""Number of samples whose neighbours are compared at a time (chosen)."""

PASSES = 3
"""Number of passes; a spike close to a larger spike is found after the larger one is removed."""


def spikes(
    angle: Real[np.ndarray, " n"], time: Float[np.ndarray, " n"], quantum: float
) -> Bool[np.ndarray, " n"]:
    """Find samples that deviate from the motion of their neighbours.

    **Arguments**
    - `angle`: unwrapped readings or angles, shape (n,). `time`: time in s.
    - `quantum`: step of the readings in the unit of `angle`; 0 if they have no step.

    **Returns** true at every spike; all false if more than a fifth of the samples would be spikes.

    **Example**
    ```python
    >>> import numpy as np
    >>> from vttig_jax.logs.channel.speed import spikes
    >>> time = np.arange(100) / 500.0
    >>> angle = 360.0 * time
    >>> angle[[30, 31, 70]] -= 2.0
    >>> np.flatnonzero(spikes(angle, time, 0.004)).tolist()
    [30, 31, 70]

    ```
    """
    count = len(angle)
    mask = np.zeros(count, bool)
    if count < 2 * REACH + 2 * LAG + 1:
        return mask
    cleaned = (angle - angle[0]).astype(np.float64, copy=False)
    for _ in range(PASSES):
        new = _detect(cleaned, time, quantum) & ~mask
        if not new.any():
            break
        mask |= new
        if np.count_nonzero(mask) > MAX_SHARE * count:
            return np.zeros(count, bool)
        cleaned = without_spikes(cleaned, time, mask)
    return mask


def _detect(
    angle: Float[np.ndarray, " n"], time: Float[np.ndarray, " n"], quantum: float
) -> Bool[np.ndarray, " n"]:
    """Return the mask of the spikes that one pass detects."""
    count = len(angle)
    mask, bend = np.zeros(count, bool), bends(angle, time)
    if max(bend.max(), -bend.min()) <= 0.5 * QUANTA * quantum:
        return mask
    floor = QUANTA * quantum + DEVIATIONS * robust_deviation(bend.copy()) / np.sqrt(1.5)
    # The bend at a spike is its deviation, or half of it beside another spike.
    rough = np.abs(bend, out=bend) > 0.5 * floor
    del bend  # it is as long as the log
    if not rough.any():
        return mask
    near = np.convolve(rough, np.ones(2 * HALF + 1, bool), mode="same")
    usual = float(np.median(time[2 * LAG :] - time[: -2 * LAG], overwrite_input=True))
    least, last = 1e-3 * usual if usual > 0 else 1.0, count - 2 * LAG - 1

    def slope(rows: Int[np.ndarray, " m"]) -> Float[np.ndarray, " m"]:
        """Return the median, within ±`REACH` samples, of the slopes over ±`LAG` samples.

        At the ends of the log the slopes are mirrored.
        """
        first = np.clip(rows - LAG, 0, last)[:, None] + np.arange(-REACH, REACH + 1)
        first = last - np.abs(last - np.abs(first))
        rise = angle[first + 2 * LAG] - angle[first]
        run = time[first + 2 * LAG] - time[first]
        return np.median(rise / np.maximum(run, least), axis=1)

    interval = np.median(np.diff(time), overwrite_input=True)
    size = np.zeros(count)
    for part in _places(near):
        ahead = _window(part, HALF, count)
        ahead = angle[ahead] - slope(part)[:, None] * (time[ahead] - time[part, None])
        size[part] = np.abs(angle[part] - np.median(ahead, axis=1))
    large = size > floor
    if not large.any():
        return mask
    for rows in _places(large):
        around = NEIGHBOUR_FACTOR * np.median(size[_window(rows, HALF, count)], axis=1)
        moved_by = INTERVAL_SHARE * np.abs(slope(rows)) * interval
        rows = rows[size[rows] > np.maximum(around, moved_by)]
        # A sample at a change of motion lies on the line of one side; a spike lies off both.
        for side in (-1, 1):
            near = rows[:, None] + side * np.arange(1, 2 * HALF)
            inside = (near[:, -1] >= 0) & (near[:, -1] < count)  # enough samples for a line
            near = np.clip(near, 0, count - 1)
            own = slope(np.clip(rows + side * (REACH + 1), 0, count - 1))
            ahead = angle[near] - own[:, None] * (time[near] - time[rows, None])
            off = np.abs(angle[rows] - np.median(ahead, axis=1)) > 0.5 * size[rows]
            rows = rows[off | ~inside]
        mask[rows] = True
    return mask


def _places(mask: Bool[np.ndarray, " n"]) -> Iterator[Int[np.ndarray, " m"]]:
    """Yield the places of the true values, some thousands at a time."""
    for part in pieces(len(mask)):
        places = np.flatnonzero(mask[part]) + part.start
        yield from (places[few] for few in pieces(len(places), _AT_ONCE))


def without_spikes(
    values: Real[np.ndarray, " n"], time: Float[np.ndarray, " n"], mask: Bool[np.ndarray, " n"]
) -> Real[np.ndarray, " n"]:
    """Return `values` in which the masked values are interpolated in time; integers stay integers.

    **Arguments**
    - `values`: unwrapped readings or angles. `time`: time in s. `mask`: true at every spike.
    """
    if not mask.any() or mask.all():
        return values
    good = np.flatnonzero(~mask)
    index = np.flatnonzero(mask)
    after = np.clip(np.searchsorted(good, index), 0, len(good) - 1)
    before = good[np.maximum(np.searchsorted(good, index) - 1, 0)]
    after = good[after]
    span = time[after] - time[before]
    weight = np.divide(
        time[index] - time[before], span, out=np.full(len(index), 0.5), where=span > 0
    )
    weight = np.clip(weight, 0.0, 1.0)
    cleaned = values.copy()
    # Only the small difference is computed in floating point, so large integers stay exact.
    step = weight * (values[after] - values[before])
    if np.issubdtype(values.dtype, np.integer):
        step = np.rint(step).astype(values.dtype)
    cleaned[index] = values[before] + step
    return cleaned


def bends(angle: Float[np.ndarray, " n"], time: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Return the deviation of each sample from the line through its two neighbours.

    The first and the last sample get the deviation of the sample next to them.
    """
    bend = np.empty(len(angle))
    for part in pieces(len(angle) - 2):
        around = slice(part.start, part.stop + 2)
        seconds, value = time[around], angle[around]
        span = seconds[2:] - seconds[:-2]
        share = np.full_like(span, 0.5)
        np.divide(seconds[1:-1] - seconds[:-2], span, out=share, where=span > 0)
        inner = value[1:-1] - value[:-2] - share * (value[2:] - value[:-2])
        bend[part.start + 1 : part.stop + 1] = inner
    bend[0], bend[-1] = bend[1], bend[-2]
    return bend


def robust_deviation(values: Float[np.ndarray, " n"]) -> float:
    """Return the standard deviation from the median absolute deviation; `values` are overwritten.

    It is then computed without a copy of an array that is as long as the log.
    """
    values -= np.median(values, overwrite_input=True)
    return float(np.median(np.abs(values, out=values), overwrite_input=True)) / 0.6745


def _window(rows: Int[np.ndarray, " m"], half: int, count: int) -> Int[np.ndarray, "m w"]:
    """Return indices of 2 `half` + 1 samples around each row, shifted inwards at the ends."""
    start = np.clip(rows - half, 0, count - 2 * half - 1)
    return start[:, None] + np.arange(2 * half + 1)


SHORTEST = 4
"""Least number of equal successive readings of a stall."""

MARGIN = 8
"""Number of samples on either side of a stall from which its speed is taken."""

JUMP_TOLERANCE = 0.3
"""Relative tolerance between the jump after a stall and the turn of the shaft during it."""

LEAST_STALL = 8.0
"""Least turn of the shaft during a stall, in encoder steps. To detect repeated readings, the shaft
must move at least a third of this number of steps per sample."""

REGULAR = 0.9
"""Readings repeat regularly if at least this fraction of the changes of a moving channel has the
same spacing in samples."""


def stalls(
    readings: Real[np.ndarray, " n"], time: Float[np.ndarray, " n"], quantum: float, usual: int = 1
) -> Bool[np.ndarray, " n"]:
    """Find stalls: equal readings during motion, followed by a jump that corrects the angle.

    **Arguments**
    - `readings`: unwrapped readings, shape (n,). `time`: time in s. `quantum`: step of `readings`.
    - `usual`: number of equal successive readings that is normal; up to 3 are always normal.

    **Returns** true at every repeated reading of a stall, without its first reading.
    """
    stalled = np.zeros(len(readings), bool)
    change = np.flatnonzero(np.diff(readings)) + 1
    start, stop = change[:-1], change[1:]
    inside = (
        (stop - start >= max(SHORTEST, usual + 1))
        & (start >= MARGIN)
        & (stop < len(readings) - MARGIN)
    )
    start, stop = start[inside], stop[inside]
    if len(start) == 0:
        return stalled
    before = _slope(readings, time, start - MARGIN, start)
    after = _slope(readings, time, stop, stop + MARGIN)
    turned = 0.5 * (before + after) * (time[stop] - time[start])
    jump = (readings[stop] - readings[start]).astype(np.float64)
    matching = np.abs(jump - turned) <= JUMP_TOLERANCE * np.abs(turned)
    steady = np.abs(before - after) <= np.minimum(np.abs(before), np.abs(after))
    stalls = matching & steady & (np.abs(turned) > LEAST_STALL * quantum)
    for a, b in zip(start[stalls], stop[stalls], strict=True):
        stalled[a + 1 : b] = True
    return stalled


def _slope(
    readings: Real[np.ndarray, " n"],
    time: Float[np.ndarray, " n"],
    first: Int[np.ndarray, " m"],
    last: Int[np.ndarray, " m"],
) -> Float[np.ndarray, " m"]:
    elapsed = time[last] - time[first]
    rise = (readings[last] - readings[first]).astype(np.float64)
    return np.divide(rise, elapsed, out=np.zeros(len(rise)), where=elapsed > 0)


def repeats(readings: Real[np.ndarray, " n"], quantum: float) -> int:
    """Return how many samples hold the same reading during motion; 1 if every sample is new.

    Only motion of several encoder steps (`quantum`) per sample is used, and the number must be the
    same at nearly all changes of the reading.

    **Example**
    ```python
    >>> import numpy as np
    >>> from vttig_jax.logs.channel.speed import repeats
    >>> repeats(np.repeat(np.arange(0, 50_000, 90), 2), 1.0)
    2

    ```
    """
    span = 2 * MARGIN
    if len(readings) <= 2 * span:
        return 1
    travel = readings[span:] - readings[:-span]
    np.abs(travel, out=travel)
    fast = travel > max(LEAST_STALL / 3 * quantum * span, 0.1 * float(travel.max()))
    moving = np.zeros(len(readings), bool)
    moving[span // 2 : -span // 2] = fast
    found, last = [np.zeros(0, np.int32)], np.zeros(0, np.int64)
    for part in pieces(len(readings) - 1):  # samples from each change to the next, in motion
        change = np.flatnonzero(np.diff(readings[part.start : part.stop + 1])) + part.start + 1
        change = np.append(last, change)
        both = moving[change[:-1]] & moving[change[1:]]
        found.append(np.diff(change)[both].astype(np.int32))
        last = change[-1:]
    spacing = np.concatenate(found)
    if len(spacing) < span:
        return 1
    usual = int(np.median(spacing))
    regular = np.count_nonzero(spacing == usual) >= REGULAR * len(spacing)
    return usual if usual > 1 and regular else 1
