"""Noise model of a line search: an autoregression along every run with varying local size."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Float, Inexact
from numpy.lib.stride_tricks import sliding_window_view
from scipy.linalg import qr, qr_multiply, solve_triangular
from scipy.ndimage import correlate1d, uniform_filter1d

from ...base.numerics.autoregression import whitening_filter
from .rows import Rows

HIGHEST_ORDER = 32
_ROWS_PER_LAG = 12
"""Highest order of the autoregression, and least number of rows per order (chosen)."""

_WINDOWS = 16
_LEAST_WINDOW = 80
"""The local size is averaged over n/16 rows, but over at least 80 rows (chosen)."""

_REPEATS = 3  # iterations of least squares and autoregression (chosen)


@dataclass(frozen=True)
class Whitening:
    """Linear map of columns to rows with independent noise of equal size.

    **Arguments**
    - `filter`: filter (1, −a₁, …, −a_p) along every run.
    - `weight`: inverse of the local size of the noise, shape (n,); 0 in the first p rows of a run.
    """

    filter: Float[np.ndarray, " taps"]
    weight: Float[np.ndarray, " n"]

    @property
    def rows(self) -> int:
        """Number of rows with a weight above 0."""
        return int(np.count_nonzero(self.weight))

    def __call__(self, columns: Inexact[np.ndarray, "*k n"]) -> Inexact[np.ndarray, "*k n"]:
        """Filter columns along the last axis and multiply them by the weights."""
        taps = self.filter[::-1]
        if len(taps) == 1:
            return columns * self.weight
        shift = len(taps) - 1 - len(taps) // 2  # the last tap belongs to the row itself
        return correlate1d(columns, taps, mode="constant", origin=shift) * self.weight


def no_whitening(rows: Rows) -> Whitening:
    """Return the identity: no filter and equal weights."""
    return Whitening(np.ones(1), np.ones(len(rows.value)))


def estimate_noise(
    rows: Rows, columns: Float[np.ndarray, "n q"], start: Whitening
) -> tuple[Whitening, float]:
    """Estimate the noise in the residual of `columns`; return it with its sum of squares.

    Least squares and the autoregression of the residual alternate, starting from `start`.
    """
    whitening = start
    for _ in range(_REPEATS):
        residual = residual_of(rows, columns, whitening)
        filter_ = _autoregression(rows, residual, _order(rows, residual))
        whitening = Whitening(filter_, _usable(rows, len(filter_) - 1))
        whitening = replace(whitening, weight=_local_weight(whitening(residual), whitening))
    return whitening, misfit(rows, columns, whitening)


def mean_square(rows: Rows, columns: Float[np.ndarray, "n q"], whitening: Whitening) -> float:
    """Return the mean weighted squared innovation in the residual of the columns."""
    return misfit(rows, columns, whitening) / max(whitening.rows, 1)


def noise_of_order(
    rows: Rows, columns: Float[np.ndarray, "n q"], whitening: Whitening, order: int
) -> Whitening:
    """Estimate an autoregression of given order for other columns with the same weights.

    Sums of squares are comparable only with equal weights; separate weights would change the
    likelihood ratio by several units.
    """
    whitening = replace(whitening, weight=whitening.weight * _usable(rows, order))
    for _ in range(_REPEATS):
        residual = residual_of(rows, columns, whitening)
        whitening = replace(whitening, filter=_autoregression(rows, residual, order))
    return whitening


def residual_of(
    rows: Rows, columns: Float[np.ndarray, "n q"], whitening: Whitening
) -> Float[np.ndarray, " n"]:
    """Return the unwhitened residual of the whitened least-squares fit of the columns."""
    whitened, size = scaled(columns, whitening)
    factors: Any = qr_multiply(whitened, whitening(rows.value), mode="right", pivoting=True)
    projected, upper, order = factors
    rank = _rank(upper)
    solution = np.zeros(columns.shape[1])
    solution[order[:rank]] = solve_triangular(upper[:rank, :rank], projected[:rank])
    return rows.value - columns @ (solution / size)


def misfit(rows: Rows, columns: Float[np.ndarray, "n q"], whitening: Whitening) -> float:
    """Return the sum of squared innovations in the residual of the columns."""
    innovations = whitening(residual_of(rows, columns, whitening))
    return float(innovations @ innovations)


def orthonormal(
    columns: Float[np.ndarray, "n q"], whitening: Whitening
) -> tuple[Float[np.ndarray, "n r"], Float[np.ndarray, "q r"]]:
    """Return an orthonormal basis = whitened columns @ mixing, and the matrix mixing.

    Linearly dependent columns are omitted, for example the constant of a run without usable rows.
    """
    whitened, size = scaled(columns, whitening)
    basis, mixing = factored(whitened)
    return basis, mixing / size[:, None]


def factored(
    columns: Float[np.ndarray, "n q"],
) -> tuple[Float[np.ndarray, "n r"], Float[np.ndarray, "q r"]]:
    """Return an orthonormal basis = columns @ mixing and mixing, for columns of norm 1 or less."""
    factors: Any = qr(columns, mode="economic", pivoting=True, check_finite=False)
    basis, upper, order = factors
    rank = _rank(upper)
    mixing = np.zeros((columns.shape[1], rank))
    mixing[order[:rank]] = np.linalg.inv(upper[:rank, :rank])
    return basis[:, :rank], mixing


def scaled(
    columns: Float[np.ndarray, "n q"], whitening: Whitening
) -> tuple[Float[np.ndarray, "n q"], Float[np.ndarray, " q"]]:
    """Return the whitened columns scaled to norm 1, and their norms."""
    whitened = whitening(columns.T).T
    size = np.linalg.norm(whitened, axis=0)
    size[size == 0] = 1.0
    return whitened / size, size


def _rank(upper: Float[np.ndarray, "r q"]) -> int:
    """Return the rank from the pivoted triangle of columns of norm 1 or less."""
    return int(np.count_nonzero(np.abs(np.diag(upper)) > 1e-10))


def _order(rows: Rows, residual: Float[np.ndarray, " n"]) -> int:
    """Select the order of the autoregression by BIC, from lag products inside runs."""
    longest = max(run.stop - run.start for run in rows.runs)
    most = min(HIGHEST_ORDER, len(residual) // _ROWS_PER_LAG, longest // 4)
    products = np.zeros(most + 1)
    for run in rows.runs:
        values = residual[run]
        for lag in range(min(most + 1, len(values))):
            products[lag] += values[lag:] @ values[: len(values) - lag]
    return len(whitening_filter(products / len(residual), len(residual))) - 1


def _autoregression(
    rows: Rows, residual: Float[np.ndarray, " n"], order: int
) -> Float[np.ndarray, " taps"]:
    """Return the whitening filter with the least squared innovations.

    Lag products assume zeros beyond the ends of a run. In a short log this flattens a resonance of
    the noise, and the part that the filter misses looks like a line.
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


def _usable(rows: Rows, order: int) -> Float[np.ndarray, " n"]:
    """Return weights of 1, and of 0 in the first `order` rows of each run."""
    weight = np.ones(len(rows.value))
    for run in rows.runs:
        weight[run.start : min(run.start + order, run.stop)] = 0.0
    return weight


def _local_weight(
    innovation: Float[np.ndarray, " n"], whitening: Whitening
) -> Float[np.ndarray, " n"]:
    """Return weights inverse to the local size of the innovations, their mean magnitude nearby.

    With equal weights, rows with larger noise (for example at high speed) would cause false lines.
    The magnitude is less sensitive to outliers than the square.
    """
    width = max(len(innovation) // _WINDOWS, _LEAST_WINDOW)
    if len(innovation) < 2 * width:
        return whitening.weight
    usable = uniform_filter1d(whitening.weight, width, mode="nearest")
    size = uniform_filter1d(np.abs(innovation), width, mode="nearest") / np.maximum(usable, 1e-12)
    size = np.maximum(size, 1e-3 * size.max())
    if size.max() == 0:
        return whitening.weight
    return whitening.weight * (np.median(size) / size)
