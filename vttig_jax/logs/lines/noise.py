"""Autoregression of the noise along every run, and whitening by it.

A run is an uninterrupted stretch of rows.
"""

import numpy as np
from jaxtyping import Float
from numpy.lib.stride_tricks import sliding_window_view
from scipy.ndimage import correlate1d

from ...base.numerics.autoregression import whitening_filter
from .rows import Rows

HIGHEST_ORDER = 32
_ROWS_PER_LAG = 12
"""Highest order p of the autoregression, and least number of rows per unit of p (chosen)."""


def noise_filter(rows: Rows, residual: Float[np.ndarray, " n"]) -> Float[np.ndarray, " taps"]:
    """Return the whitening filter (1, −a₁, …, −a_p) of a residual; BIC selects the order p."""
    longest = max(run.stop - run.start for run in rows.runs)
    most = min(HIGHEST_ORDER, len(residual) // _ROWS_PER_LAG, longest // 4)
    products = np.zeros(most + 1)
    for run in rows.runs:
        values = residual[run]
        for lag in range(min(most + 1, len(values))):
            products[lag] += values[lag:] @ values[: len(values) - lag]
    order = len(whitening_filter(products / len(residual), len(residual))) - 1
    return filter_of_order(rows, residual, order)


def filter_of_order(
    rows: Rows, residual: Float[np.ndarray, " n"], order: int
) -> Float[np.ndarray, " taps"]:
    """Return the whitening filter (1, −a₁, …, −a_p) of order p from a least-squares fit.

    Every value of the residual that has p predecessors in its run is regressed on them (covariance
    method). The Yule–Walker equations are not used, because the autocovariance treats the values
    beyond the ends of a run as zeros. In a short log this makes a resonance of the noise too broad,
    and the remaining part of the resonance looks like a line.
    """
    if order == 0:
        return np.ones(1)
    past = [
        sliding_window_view(residual[run], order + 1)
        for run in rows.runs
        if run.stop - run.start > order
    ]
    windows = np.concatenate(past)[:, ::-1]
    taps = np.linalg.lstsq(windows[:, 1:], windows[:, 0], rcond=None)[0]
    return np.concatenate([[1.0], -taps])


def whitened(
    rows: Rows, columns: Float[np.ndarray, " n *k"], taps: Float[np.ndarray, " taps"]
) -> Float[np.ndarray, " n *k"]:
    """Return the columns filtered along every run.

    The filter `taps` has order p. The first p rows of every run have too few predecessors and
    become 0.
    """
    order = len(taps) - 1
    if order == 0:
        return columns
    shift = order - (order + 1) // 2  # the last tap belongs to the row itself
    # Every column is contiguous in memory, which the filter needs to be fast.
    filtered = correlate1d(columns.T, taps[::-1], axis=-1, mode="constant", origin=shift).T
    for run in rows.runs:
        filtered[run.start : min(run.start + order, run.stop)] = 0.0
    return filtered


def transposed(
    innovations: Float[np.ndarray, " n"], taps: Float[np.ndarray, " taps"]
) -> Float[np.ndarray, " n"]:
    """Return Wᵀ e, where e are the `innovations` and W is the matrix of the filter in `whitened`.

    The innovations must be 0 in the first rows of every run, as in a result of `whitened`.
    """
    order = len(taps) - 1
    if order == 0:
        return innovations
    return correlate1d(innovations, taps, mode="constant", origin=-((order + 1) // 2))
