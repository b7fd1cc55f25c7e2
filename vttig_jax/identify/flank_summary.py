"""Lag products of one flank: its normal equations under any autoregressive noise, in O(L p²)."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int

from ..base.partial import log_initial_determinant
from ..pair.gears import Flank

_CACHED_ROWS = 512


@dataclass(frozen=True)
class FlankSummary:
    """Lag products of the block rows of one flank, summed over its runs.

    **Arguments**
    - `lag_products`: Γ_0 … Γ_L, shape (L + 1, q, q); y is the last of the q columns. L is what
      the noise of the logs asks for, 16 at most.
    - `heads`, `tails`: the first and last L rows of every run, shape (runs, L, q).
    - `rows`: number of block rows in all runs together.
    """

    flank: Flank
    lag_products: Float[np.ndarray, "lags q q"]
    heads: Float[np.ndarray, "runs lag q"]
    tails: Float[np.ndarray, "runs lag q"]
    rows: int

    def __add__(self, other: "FlankSummary") -> "FlankSummary":
        """Both together: nothing reaches from a run of one into a run of the other."""
        return FlankSummary(
            self.flank,
            self.lag_products + other.lag_products,
            np.concatenate([self.heads, other.heads]),
            np.concatenate([self.tails, other.tails]),
            self.rows + other.rows,
        )

    def transformed(self, matrix: Float[np.ndarray, "new q"]) -> "FlankSummary":
        """The summary of rows z ↦ `matrix` z."""
        return replace(
            self,
            lag_products=matrix @ self.lag_products @ matrix.T,
            heads=self.heads @ matrix.T,
            tails=self.tails @ matrix.T,
        )

    def selected(self, keep: Int[np.ndarray, " kept"]) -> "FlankSummary":
        """The summary of rows with these columns only."""
        return replace(
            self,
            lag_products=self.lag_products[:, keep][:, :, keep],
            heads=self.heads[:, :, keep],
            tails=self.tails[:, :, keep],
        )

    def whitened(self, filter_: Float[np.ndarray, " taps"]) -> Float[np.ndarray, "q q"]:
        """Zᵀ Σ⁻¹ Z of the rows Z under autoregressive noise whose innovations have variance one.

        Filtering every run between zeros gives Σ_{jk} filter_j filter_k Γ_{k−j}. What then still
        rings after the end is taken away, and the same before the start with time reversed: that
        leaves the exact quadratic form, initial samples included (I. Gohberg, A. Semencul 1972).
        """
        order = len(filter_) - 1
        products = np.correlate(filter_, filter_, "full")[order:]
        total = products[0] * self.lag_products[0]
        for product, gram in zip(products[1:], self.lag_products[1:], strict=False):
            total = total + product * (gram + gram.T)
        if order == 0:
            return total
        newest = self.ends[:, :order]
        rings = np.zeros_like(newest)
        for after in range(order):
            rings[:, after] = np.einsum(
                "j,rjq->rq", filter_[after + 1 :], newest[:, : order - after]
            )
        rings = rings.reshape(-1, total.shape[0])
        return total - rings.T @ rings

    def log_determinant(self, partial: Float[np.ndarray, " p"]) -> float:
        """Log-determinant of the covariance of all rows, innovations of variance one."""
        return len(self.heads) * float(log_initial_determinant(partial))

    @property
    def ends(self) -> Float[np.ndarray, "ends lag q"]:
        """The L rows next to both ends of every run, the outermost first."""
        return np.concatenate([self.heads, self.tails[:, ::-1]])


def summarise_flank(
    flank: Flank, runs: Sequence[Float[np.ndarray, "_ q"]], lags: int
) -> FlankSummary:
    """Lag products and ends of runs that are all longer than `lags`."""
    products = np.sum([_lag_products(rows, lags) for rows in runs], axis=0)
    return FlankSummary(
        flank,
        products,
        np.stack([rows[:lags] for rows in runs]),
        np.stack([rows[len(rows) - lags :] for rows in runs]),
        sum(map(len, runs)),
    )


def _lag_products(rows: Float[np.ndarray, "n q"], lags: int) -> Float[np.ndarray, "lags q q"]:
    """Σ_t z_t z_{t−l}ᵀ of one run for l = 0 … lags, in pieces that stay in cache for all lags."""
    products = np.zeros((lags + 1, rows.shape[1], rows.shape[1]))
    for start in range(0, len(rows), _CACHED_ROWS):
        now = rows[start : start + _CACHED_ROWS]
        for lag in range(lags + 1):
            skip = max(lag - start, 0)
            past = rows[start - lag + skip : start - lag + len(now)]
            products[lag] += now[skip:].T @ past
    return products
