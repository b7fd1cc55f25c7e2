"""Speed of a shaft from its angle, smoothed over many encoder steps, and runs of equal state."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Float, Shaped

from .spikes import spikes, without_spikes

TRAVEL = 199.9
"""Travel, in quanta (encoder steps), of one speed difference at top speed; a quantum is then 0.5 %
of the travel. This limit and the two below are chosen and deliberately not round: counters travel
whole counts, and rounding errors would decide about a travel that lies exactly on a limit."""

DWELL = 0.010_001
"""Speeds below this fraction of the top speed are standstill."""

STILL = 4.5
"""Speeds below this many quanta per smoothing window are standstill."""


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
    """
    angle = without_spikes(angle, time, spikes(angle, time, resolution))
    count = len(time)
    lag = max(1, count // 100)
    interval = np.median(np.diff(time))
    coarse = np.abs(angle[lag:] - angle[:-lag]) / np.maximum(time[lag:] - time[:-lag], interval)
    top = float(np.quantile(coarse, 0.95))
    if top == 0:
        top = float(coarse.max())
    quantum = max(resolution, 2.0 * _noise(time, angle))
    half = int(np.clip(np.ceil(TRAVEL * quantum / (top * interval) / 2), 1, max(1, count // 40)))
    low = np.maximum(np.arange(count) - half, 0)
    high = np.minimum(np.arange(count) + half, count - 1)
    elapsed = np.maximum(time[high] - time[low], 1e-3 * interval)
    value = (angle[high] - angle[low]) / elapsed
    dwell = max(DWELL * top, STILL * quantum / (2 * half * interval))
    return Speed(value, 2 * half, quantum, float(dwell))


def runs(state: Shaped[np.ndarray, " n"], cut: Bool[np.ndarray, " n"]) -> list[tuple[int, int]]:
    """Return stretches [start, stop) of equal `state`; each true `cut` starts a new stretch."""
    change = np.flatnonzero((state[1:] != state[:-1]) | cut[1:]) + 1
    edges = [0, *change.tolist(), len(state)]
    return list(pairwise(edges))


def _noise(time: Float[np.ndarray, " n"], angle: Float[np.ndarray, " n"]) -> float:
    """Return a robust standard deviation of the angle noise in rad.

    It comes from the deviation of each sample from the line between its two neighbours.
    """
    span = time[2:] - time[:-2]
    weight = np.divide(time[1:-1] - time[:-2], span, out=np.full_like(span, 0.5), where=span > 0)
    bend = angle[1:-1] - angle[:-2] - weight * (angle[2:] - angle[:-2])
    return float(np.median(np.abs(bend - np.median(bend)))) / 0.6745 / np.sqrt(1.5)
