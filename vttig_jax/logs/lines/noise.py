"""Autoregression of the noise along every run, and whitening by it.

A run is an uninterrupted stretch of rows.
"""

from typing import Any

import numpy as np
from jaxtyping import Float
from numpy.lib.stride_tricks import sliding_window_view
from scipy.linalg import get_blas_funcs

from ...base.numerics.autoregression import whitening_filter
from .rows import Rows

_axpy: Any = get_blas_funcs("axpy", dtype=np.float64)
"""Return a x + y, written into y."""

HIGHEST_ORDER = 32
_ROWS_PER_LAG = 12
"""Highest order p of the autoregression, and least number of rows per unit of p (chosen)."""

_INDEPENDENT = 1e-8
"""The normal equations of the autoregression are solved if the least eigenvalue of the normalised
products is above this value; the coefficients then keep eight digits (chosen)."""


def noise_filter(rows: Rows, residual: Float[np.ndarray, " n"]) -> Float[np.ndarray, " taps"]:
    """Return the whitening filter (1, −a₁, …, −a_p) of a residual; BIC selects the order p."""
    longest = max(run.stop - run.start for run in rows.runs)
    most = min(HIGHEST_ORDER, len(residual) // _ROWS_PER_LAG, longest // 4)
    products = np.zeros(most + 1)
    for run in rows.runs:
        values = residual[run]
        padded = np.concatenate([np.zeros(most), values])
        products += np.correlate(padded, values, mode="valid")[::-1]
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
    runs = [residual[run] for run in rows.runs if run.stop - run.start > order]
    products = np.sum([_products(values, order) for values in runs], axis=0)
    size = np.sqrt(np.maximum(np.diag(products), 1e-300))
    products /= np.outer(size, size)
    least = np.linalg.eigvalsh(products[1:, 1:])[0]
    if least > _INDEPENDENT:
        taps = np.linalg.solve(products[1:, 1:], products[1:, 0]) * size[0] / size[1:]
    else:
        windows = np.concatenate([sliding_window_view(values, order + 1) for values in runs])
        taps = np.linalg.lstsq(windows[:, -2::-1], windows[:, -1], rcond=None)[0]
    return np.concatenate([[1.0], -taps])


def _products(values: Float[np.ndarray, " n"], order: int) -> Float[np.ndarray, "lags lags"]:
    """Return Σ x[t − i] x[t − j] over all t that have `order` predecessors, for lags i and j.

    Row 0 is a correlation. Every other product is its upper left neighbour with the first term
    added and the last one removed.
    """
    products = np.empty((order + 1, order + 1))
    products[0] = products[:, 0] = np.correlate(values, values[order:], mode="valid")[::-1]
    first, last = values[:order][::-1], values[: -order - 1 : -1]
    change = np.outer(first, first) - np.outer(last, last)
    for lag in range(order):
        products[lag + 1, lag + 1 :] = products[lag, lag:-1] + change[lag, lag:]
        products[lag + 1 :, lag + 1] = products[lag + 1, lag + 1 :]
    return products


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
    left = np.ascontiguousarray(columns.T)  # one column after the other
    filtered = np.zeros_like(left)
    for lag, tap in enumerate(taps):
        filtered = _axpy(left.ravel(), filtered.ravel(), n=left.size - lag, a=tap, offy=lag)
    filtered = filtered.reshape(left.shape)
    for run in rows.runs:
        filtered[..., run.start : min(run.start + order, run.stop)] = 0.0
    return filtered.T


def transposed(
    innovations: Float[np.ndarray, " n"], taps: Float[np.ndarray, " taps"]
) -> Float[np.ndarray, " n"]:
    """Return Wᵀ e, where e are the `innovations` and W is the matrix of the filter in `whitened`.

    The innovations must be 0 in the first rows of every run, as in a result of `whitened`.
    """
    count = len(innovations)
    result = np.zeros(count)
    for lag, tap in enumerate(taps[:count]):
        result = _axpy(innovations, result, n=count - lag, a=tap, offx=lag)
    return result
