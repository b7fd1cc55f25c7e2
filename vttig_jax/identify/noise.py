"""Correlated noise of the block rows: an autoregression, and least squares that knows it."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ..base.autoregression import whitening_filter
from .columns import OFFSET
from .normal_equations import cholesky, residual_weights
from .summary import FlankSummary, HarmonicSummary

_ROUNDING = 1e-14
"""Share of y² below which a residual is rounding."""

_REPEATS = 2
"""Further rounds of autoregression and generalised least squares; the second moves nothing."""


@dataclass(frozen=True)
class NoiseModel:
    """AR(p) noise of block means, ε_t = Σ_j coefficients_j ε_{t−j} + innovation.

    **Arguments**
    - `coefficients`: shape (p,).
    - `innovation_std`: rad.
    - `std`: of the block means, rad.
    - `block_s`: duration of a block.
    """

    coefficients: Float[np.ndarray, " p"]
    innovation_std: float
    std: float
    block_s: float

    @property
    def filter(self) -> Float[np.ndarray, " taps"]:
        """Whitening filter (1, −a₁, …, −a_p)."""
        return np.concatenate([[1.0], -self.coefficients])

    @property
    def correlation_s(self) -> float:
        """Integrated correlation time of the blocks, half the two-sided sum of correlations."""
        gain = self.innovation_std / np.sum(self.filter)
        return 0.5 * self.block_s * float((gain / self.std) ** 2) if self.std else 0.0


@dataclass(frozen=True)
class WhitenedFlank:
    """Upper Cholesky factor of the whitened normal matrix of one flank, in units of the innovation.

    Columns keep the order of the block plan: free, tied, y. The squared length of
    R_tt h − R_ty is the misfit of tied coefficients h once the free ones are at their best.
    """

    factor: Float[np.ndarray, "q q"]
    free: int

    @property
    def tied(self) -> tuple[Float[np.ndarray, "t t"], Float[np.ndarray, " t"]]:
        """R_tt and R_ty."""
        return self.factor[self.free : -1, self.free : -1], self.factor[self.free : -1, -1]

    def free_given(self, tied: Float[np.ndarray, " t"]) -> Float[np.ndarray, " f"]:
        """Best free coefficients for given tied ones."""
        right = self.factor[: self.free, -1] - self.factor[: self.free, self.free : -1] @ tied
        return np.linalg.solve(self.factor[: self.free, : self.free], right)

    def covariance(self, of_tied: Float[np.ndarray, "t t"]) -> Float[np.ndarray, "c c"]:
        """Covariance of (free, tied) coefficients when the tied ones have covariance `of_tied`."""
        inverse = np.linalg.inv(self.factor[: self.free, : self.free])
        follow = -inverse @ self.factor[: self.free, self.free : -1]
        spread = np.vstack([follow, np.eye(len(of_tied))])
        total = spread @ of_tied @ spread.T
        total[: self.free, : self.free] += inverse @ inverse.T
        return total


def whiten(
    summary: HarmonicSummary, variance_factor: float = 1.0
) -> tuple[NoiseModel, tuple[WhitenedFlank, ...]]:
    """Estimate the noise and factor the normal matrices it whitens.

    Starts from ordinary least squares; then the autoregression of the residual, with its order by
    BIC, and generalised least squares take turns. `variance_factor` is what a robust loss adds to
    the variance.
    """
    columns = summary.columns.width - 1
    filter_ = autoregression(summary)
    solved = residual_rows(summary, filter_)
    order = len(filter_) - 1
    factors = [cholesky(flank.whitened(filter_)) for flank in summary.flanks]
    rows = counted_share(summary) * sum(flank.whitened_rows(order) for flank in summary.flanks)
    left = sum(factor[-1, -1] ** 2 for factor in factors)
    variance = variance_factor * left / max(rows - columns * len(summary.flanks), 1)
    scale = 1 / np.sqrt(variance) if variance > 0 else 1.0
    free = summary.columns.free_width
    noise = NoiseModel(
        -filter_[1:],
        float(np.sqrt(variance)),
        float(np.sqrt(_autocovariance(summary.flanks, solved)[0])),
        summary.block_s,
    )
    return noise, tuple(WhitenedFlank(factor * scale, free) for factor in factors)


def autoregression(summary: HarmonicSummary) -> Float[np.ndarray, " taps"]:
    """Whitening filter of what a linear fit leaves."""
    filter_ = np.ones(1)
    for _ in range(1 + _REPEATS):
        solved = residual_rows(summary, filter_)
        rows = sum(flank.rows for flank in summary.flanks)
        filter_ = whitening_filter(_autocovariance(summary.flanks, solved), rows)
    return filter_


def residual_rows(
    summary: HarmonicSummary, filter_: Float[np.ndarray, " taps"]
) -> list[Float[np.ndarray, " q"]]:
    """The row of every flank that makes residuals, by generalised least squares."""
    return [residual_weights(flank.whitened(filter_)) for flank in summary.flanks]


def counted_share(summary: HarmonicSummary) -> float:
    """Share of the rows that the weights of a robust loss leave; 1 without weights."""
    offsets = [summary.columns.index(OFFSET, log) for log in range(len(summary.columns.own))]
    counted = sum(float(f.lag_products[0][k, k]) for f in summary.flanks for k in offsets)
    return counted / max(summary.rows, 1)


def _autocovariance(
    flanks: tuple[FlankSummary, ...], residuals: list[Float[np.ndarray, " q"]]
) -> Float[np.ndarray, " lags"]:
    """Autocovariance of the residual rows at every lag, all flanks together.

    Divided by all rows at every lag: that keeps it positive, and the autoregression stationary.
    What rounding leaves of y counts as white, or a log without noise would be whitened by digits
    that mean nothing.
    """
    lags = min(len(flank.lag_products) for flank in flanks)
    total = np.zeros(lags)
    for flank, residual in zip(flanks, residuals, strict=True):
        total += np.einsum("i,lij,j->l", residual, flank.lag_products[:lags], residual)
        total[0] += _ROUNDING * flank.lag_products[0, -1, -1]
    return total / sum(flank.rows for flank in flanks)
