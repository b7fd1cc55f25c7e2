"""Smoothed speed of a shaft, and whether its readings are those at standstill.

Speed of a shaft from its angle, smoothed over many encoder steps, and runs of equal state.

Readings at standstill: a channel that was read once or several times at each of its places.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Float, Real, Shaped

from ...base.numerics.counting import pieces
from .spikes import bends, robust_deviation, spikes, without_spikes

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
        longest = max(1, count // 40)
        if top == 0:  # the readings change in their spikes only
            return longest
        needed = np.ceil(TRAVEL * quantum / (top * interval) / 2)
        return int(np.clip(needed, 1, longest))

    top = _top_speed(time, angle, max(1, count // 100), interval)
    quantum = max(resolution, 2.0 * _noise(time, angle))
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
    speed = angle[lag:] - angle[:-lag]
    np.abs(speed, out=speed)
    speed /= np.maximum(time[lag:] - time[:-lag], interval)
    return float(np.quantile(speed, 0.95, overwrite_input=True)) or float(speed.max())


def runs(state: Shaped[np.ndarray, " n"], cut: Bool[np.ndarray, " n"]) -> list[tuple[int, int]]:
    """Return stretches [start, stop) of equal `state`; each true `cut` starts a new stretch."""
    change = np.flatnonzero((state[1:] != state[:-1]) | cut[1:]) + 1
    edges = [0, *change.tolist(), len(state)]
    return list(pairwise(edges))


def _noise(time: Float[np.ndarray, " n"], angle: Float[np.ndarray, " n"]) -> float:
    """Return a robust standard deviation of the angle noise in rad.

    It comes from the deviation of each sample from the line between its two neighbours.
    """
    return robust_deviation(bends(angle, time)[1:-1]) / np.sqrt(1.5)


def cubic_noise(time: Float[np.ndarray, " n"], angle: Float[np.ndarray, " n"]) -> float:
    """Return the noise like `_noise`, but an acceleration does not increase it.

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

_RESTS = 0.9
"""Least share of steps behind which a shaft rests for at least one more reading (chosen)."""


def usual_step(values: Real[np.ndarray, " n"]) -> float:
    """Return the size of the steps that make half of the travel of a channel."""
    ordered = np.diff(values.astype(np.float64, copy=False))
    np.abs(ordered, out=ordered).sort()
    travel = np.cumsum(ordered)
    return float(ordered[np.searchsorted(travel, 0.5 * travel[-1])]) if len(travel) else 0.0


def is_at_standstill(
    values: Real[np.ndarray, " n"], time: Float[np.ndarray, " n"], *, clock: bool
) -> bool:
    """Return whether a channel was read at standstill.

    No step between two readings is then a part of the usual step, as on a ramp or at a reversal,
    and readings have no `clock` but a stated rate of at most two a second. With a clock the
    readings tell it if every place has several, or if unequal times made steps that are alike.
    Small steps that go on in one direction are motion beside the wraps of a large counter.
    """
    usual = usual_step(values)
    signed = np.diff(values.astype(np.float64, copy=False))
    step = np.abs(signed)
    moved = step > SAME * usual
    if len(step) < 3 or np.any(moved & (step < _PART * usual)):
        return False
    small = np.where(moved, np.int8(0), (signed > 0) - (signed < 0).astype(np.int8))[signed != 0]
    if np.sum(small[1:] * small[:-1]) > 0:  # noise turns back more often than not
        return False
    del signed, small
    took = np.diff(time)
    slow = bool(np.median(took) >= LONG_S)
    if not clock or (moved[:-1].any() and np.mean(~moved[1:][moved[:-1]]) >= _RESTS):
        return slow or clock
    step, took = step[moved], took[moved]
    uneven, steps, speeds = (
        float(np.std(one)) / max(float(np.mean(one)), 1e-300)
        for one in (took, step, step / np.maximum(took, 1e-300))
    )
    return slow and uneven > _UNEVEN and speeds**2 > 2 * steps**2
