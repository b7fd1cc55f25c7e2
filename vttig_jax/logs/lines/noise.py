"""Noise of a line search: an autoregression along every run, of a strength that may change."""

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
"""Rows that every order of the autoregression needs."""

_WINDOWS = 16
_LEAST_WINDOW = 80
"""The strength of the noise is followed over this share of the rows, or so many of them."""

_REPEATS = 3
_ROUNDING = 1e-13
"""Share of a column's size below which what is left of it is rounding."""


@dataclass(frozen=True)
class Whitening:
    """Takes columns to rows of equal and independent noise.

    **Arguments**
    - `filter`: (1, −a₁, …, −a_p), run along every run.
    - `weight`: over the local size of the noise, shape (n,); zero in the first p rows of a run.
    """

    filter: Float[np.ndarray, " taps"]
    weight: Float[np.ndarray, " n"]

    @property
    def rows(self) -> int:
        """Rows that carry information."""
        return int(np.count_nonzero(self.weight))

    def __call__(self, columns: Inexact[np.ndarray, "*k n"]) -> Inexact[np.ndarray, "*k n"]:
        """Filter and weigh along the last axis."""
        taps = self.filter[::-1]
        if len(taps) == 1:
            return columns * self.weight
        shift = len(taps) - 1 - len(taps) // 2  # the last tap meets the row itself
        return correlate1d(columns, taps, mode="constant", origin=shift) * self.weight


def plain(rows: Rows) -> Whitening:
    """No filter and equal weights."""
    return Whitening(np.ones(1), np.ones(len(rows.value)))


def estimate(
    rows: Rows, columns: Float[np.ndarray, "n q"], start: Whitening
) -> tuple[Whitening, float]:
    """Noise that is left beside `columns`, and the sum of its squared innovations.

    Least squares and the autoregression of its residual take turns, from `start` on.
    """
    whitening = start
    for _ in range(_REPEATS):
        residual = left(rows, columns, whitening)
        filter_ = _autoregression(rows, residual, _order(rows, residual))
        whitening = Whitening(filter_, _usable(rows, len(filter_) - 1))
        whitening = replace(whitening, weight=_local_weight(whitening(residual), whitening))
    return whitening, misfit(rows, columns, whitening)


def mean_square(rows: Rows, columns: Float[np.ndarray, "n q"], whitening: Whitening) -> float:
    """Mean squared innovation beside columns, each row counted by its weight."""
    return misfit(rows, columns, whitening) / max(whitening.rows, 1)


def of_order(
    rows: Rows, columns: Float[np.ndarray, "n q"], whitening: Whitening, order: int
) -> Whitening:
    """Noise of an autoregression of given order beside other columns, under the same weights.

    Two sums of squares are comparable under one set of weights only: weights of their own would
    scatter the likelihood ratio by several units.
    """
    whitening = replace(whitening, weight=whitening.weight * _usable(rows, order))
    for _ in range(_REPEATS):
        residual = left(rows, columns, whitening)
        whitening = replace(whitening, filter=_autoregression(rows, residual, order))
    return whitening


def left(
    rows: Rows, columns: Float[np.ndarray, "n q"], whitening: Whitening
) -> Float[np.ndarray, " n"]:
    """Value less its best combination of columns, not whitened."""
    whitened, size = scaled(columns, whitening)
    factors: Any = qr_multiply(whitened, whitening(rows.value), mode="right", pivoting=True)
    projected, upper, order = factors
    rank = _rank(upper)
    found = np.zeros(columns.shape[1])
    found[order[:rank]] = solve_triangular(upper[:rank, :rank], projected[:rank])
    return rows.value - columns @ (found / size)


def misfit(rows: Rows, columns: Float[np.ndarray, "n q"], whitening: Whitening) -> float:
    """Sum of squared innovations beside the columns."""
    rest = whitening(left(rows, columns, whitening))
    return float(rest @ rest)


def orthonormal(
    columns: Float[np.ndarray, "n q"], whitening: Whitening
) -> tuple[Float[np.ndarray, "n r"], Float[np.ndarray, "q r"]]:
    """Orthonormal basis of the whitened columns, and what makes it of them.

    Columns that others explain (the constant of a run that the filter has used up) are left out.
    """
    whitened, size = scaled(columns, whitening)
    basis, mixing = factored(whitened)
    return basis, mixing / size[:, None]


def factored(
    columns: Float[np.ndarray, "n q"],
) -> tuple[Float[np.ndarray, "n r"], Float[np.ndarray, "q r"]]:
    """Orthonormal basis of columns of size 1 or less, and what makes it of them."""
    factors: Any = qr(columns, mode="economic", pivoting=True, check_finite=False)
    basis, upper, order = factors
    rank = _rank(upper)
    mixing = np.zeros((columns.shape[1], rank))
    mixing[order[:rank]] = np.linalg.inv(upper[:rank, :rank])
    return basis[:, :rank], mixing


def scaled(
    columns: Float[np.ndarray, "n q"], whitening: Whitening
) -> tuple[Float[np.ndarray, "n q"], Float[np.ndarray, " q"]]:
    """Whitened columns of size 1, and the sizes they had."""
    whitened = whitening(columns.T).T
    size = np.linalg.norm(whitened, axis=0)
    size[size == 0] = 1.0
    return whitened / size, size


def _rank(upper: Float[np.ndarray, "r q"]) -> int:
    """Columns of size 1 or less that a pivoted triangle tells apart."""
    return int(np.count_nonzero(np.abs(np.diag(upper)) > 1e-10))


def _order(rows: Rows, residual: Float[np.ndarray, " n"]) -> int:
    """Order of the autoregression of residual rows by BIC, from lag products inside runs."""
    longest = max(run.stop - run.start for run in rows.runs)
    most = min(HIGHEST_ORDER, len(residual) // _ROWS_PER_LAG, longest // 4)
    products = np.zeros(most + 1)
    for run in rows.runs:
        own = residual[run]
        for lag in range(min(most + 1, len(own))):
            products[lag] += own[lag:] @ own[: len(own) - lag]
    return len(whitening_filter(products / len(residual), len(residual))) - 1


def _autoregression(
    rows: Rows, residual: Float[np.ndarray, " n"], order: int
) -> Float[np.ndarray, " taps"]:
    """Whitening filter of least squared innovations.

    Lag products would do for long logs; in short ones the ends, which they take for zeros, flatten
    a resonance of the noise, and its top is left to pass for a line.
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
    """1, and 0 in the first rows of a run, which have no past."""
    weight = np.ones(len(rows.value))
    for run in rows.runs:
        weight[run.start : min(run.start + order, run.stop)] = 0.0
    return weight


def _local_weight(
    innovation: Float[np.ndarray, " n"], whitening: Whitening
) -> Float[np.ndarray, " n"]:
    """One over the local size of the innovations, from their mean magnitude nearby.

    A scan weighs all rows alike; where the noise is stronger at speed, the rows at speed would
    make lines of it. The magnitude bears an outlier better than the square does.
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
