"""Outliers: a contaminated normal, decided by readings that stand alone."""

import numpy as np
from jaxtyping import Float
from scipy.ndimage import median_filter

_WIDER = 10.0
_WINDOW = 21
_ENOUGH = 20.0


def is_heavy(residual: Float[np.ndarray, " n"]) -> bool:
    """Return whether (1 − ε) N(0, s²) + ε N(0, (10 s)²) explains values better than N(0, s²).

    Better means that ln L is larger by 20. A slow deviation of many rows is no outlier: the
    running median is taken off first.
    """
    alone = residual - median_filter(residual, _WINDOW, mode="nearest")
    deviation, share = spread(alone), 0.05
    for _ in range(30):
        good, bad = _mixture(alone, deviation, share)
        sure = good / (good + bad + 1e-300)
        share = float(np.clip(np.mean(1 - sure), 1e-6, 0.5))
        squares = (sure + (1 - sure) / _WIDER**2) * alone**2
        deviation = float(np.sqrt(np.mean(squares))) + 1e-300
    good, bad = _mixture(alone, deviation, share)
    mixed = np.sum(np.log((good + bad + 1e-300) / deviation))
    normal = -0.5 * len(alone) * (1 + np.log(np.mean(alone**2) + 1e-300))
    return bool(mixed - normal > _ENOUGH)


def weights_of(
    columns: Float[np.ndarray, "n q"], readings: Float[np.ndarray, " n"], ridge: float = 1e-4
) -> tuple[Float[np.ndarray, " n"], float]:
    """Return the probability of every row that it is no outlier, and the share of outliers.

    The fit starts at the least absolute residuals. A row beyond 30 standard deviations has the
    weight 0.
    """
    weight = np.ones(len(readings))
    hold = ridge * len(readings) * np.eye(columns.shape[1])
    share, deviation = 0.05, 0.0
    for number in range(12):
        heavy = columns * weight[:, None]
        solution = np.linalg.solve(heavy.T @ columns + hold, heavy.T @ readings)
        residual = readings - columns @ solution
        if number < 4:
            deviation = spread(residual)
            weight = 1 / np.maximum(np.abs(residual) / deviation, 0.5) / 2
            continue
        for _ in range(3):
            good, bad = _mixture(residual, deviation, share)
            near = np.abs(residual) < 30 * deviation
            weight = np.where(near, good / (good + bad + 1e-300), 0.0)
            share = float(np.clip(np.mean(1 - weight), 1e-6, 0.5))
            deviation = float(np.sqrt(np.sum(weight * residual**2) / np.sum(weight))) + 1e-300
    return weight, share


def spread(values: Float[np.ndarray, " n"]) -> float:
    """Return a standard deviation from the median of magnitudes."""
    return 1.4826 * float(np.median(np.abs(values))) + 1e-300


def _mixture(values: np.ndarray, deviation: float, share: float) -> tuple[np.ndarray, np.ndarray]:
    scaled = np.minimum(np.abs(values) / deviation, 1 / np.finfo(float).eps)
    good = (1 - share) * np.exp(-0.5 * scaled**2)
    return good, share / _WIDER * np.exp(-0.5 * (scaled / _WIDER) ** 2)
