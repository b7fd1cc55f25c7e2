"""Speed of a shaft from its angle, free of count quantisation, and runs of one state."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Float, Shaped

from .spikes import spikes, without_spikes

TRAVEL = 199.9
"""A speed is taken over a travel of this many quanta at top speed: 0.5 % of quantisation.

This limit and those below are no whole numbers and no round shares: speeds and travels of counters
are whole numbers of counts, and one that lies on a limit would be judged by rounding."""

DWELL = 0.010_001
"""Slower than this share of the top speed is standstill."""

STILL = 4.5
"""Slower than this many quanta in the window of a speed is standstill."""


@dataclass(frozen=True)
class Speed:
    """Smoothed speed. `window` samples lie between the two ends of each difference."""

    value: Float[np.ndarray, " n"]
    window: int
    quantum: float
    dwell: float


def smooth_speed(
    time: Float[np.ndarray, " n"], angle: Float[np.ndarray, " n"], resolution: float
) -> Speed:
    """Central differences (φ_{k+w/2} − φ_{k−w/2}) / (t_{k+w/2} − t_{k−w/2}), shorter at the ends.

    The window w is as short as quantisation and noise allow: at the top speed it covers `TRAVEL`
    quanta (the larger of `resolution` in rad and twice the noise), but never more than a
    twentieth of the log. Spikes (`logs.spikes`) are interpolated first.
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
    """Stretches [start, stop) of equal `state`; a new one also begins where `cut` is true."""
    change = np.flatnonzero((state[1:] != state[:-1]) | cut[1:]) + 1
    edges = [0, *change.tolist(), len(state)]
    return list(pairwise(edges))


def _noise(time: Float[np.ndarray, " n"], angle: Float[np.ndarray, " n"]) -> float:
    """Robust noise of the angle: deviation from the straight line between both neighbours."""
    span = time[2:] - time[:-2]
    share = np.divide(time[1:-1] - time[:-2], span, out=np.full_like(span, 0.5), where=span > 0)
    off = angle[1:-1] - angle[:-2] - share * (angle[2:] - angle[:-2])
    return float(np.median(np.abs(off - np.median(off)))) / 0.6745 / np.sqrt(1.5)
