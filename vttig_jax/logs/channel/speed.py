"""Speed of a shaft from its angle, smoothed over many encoder steps, and runs of equal state."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Float, Shaped

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
