"""Flank summary for autoregressive noise of rows at equal times, and for white noise."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, final

import numpy as np
from jaxtyping import Float

from ...base.arrays import Number, Numbers, namespace
from ...base.numerics.partial_autocorrelation import filter_of, log_initial_determinant
from ...pair.gear_pair import Flank
from .flank_summary import Filter, FlankSummary, Rows, Times
from .lagged_forms import whitened_products
from .orthogonal import ConditionedRuns

_CACHED_ROWS = 512  # rows per piece of the lag products, which fits in the cache; chosen value


@final
@dataclass(frozen=True)
class LaggedFlank(FlankSummary):
    """Lag products of the block rows of one flank.

    The order of the noise determines the number L of lags, which is at most 16; it is 0 for white
    noise.
    """

    STACKS: ClassVar[tuple[str, ...]] = ("lag_products",)
    SUMS: ClassVar[tuple[str, ...]] = ()
    QUADRATIC: ClassVar[bool] = True

    @classmethod
    def of_runs(
        cls, flank: Flank, runs: ConditionedRuns, times: Sequence[Times], block_s: float, lags: int
    ) -> FlankSummary:
        """Return the summary of conditioned runs at equal times."""
        counts = [len(rows) for rows in runs.runs]
        return cls(
            flank=flank,
            triangle=runs.triangle,
            lag_products=np.sum([_lag_products(runs, k, lags) for k in range(len(counts))], axis=0),
            heads=np.stack([runs.part(k, 0, lags) for k in range(len(counts))]),
            tails=np.stack([runs.part(k, n - lags, n) for k, n in enumerate(counts)]),
            rows=sum(counts),
        ).observed(runs.pseudo)

    @staticmethod
    def whitened(rows: Rows, time: Times, filter_: Filter, block_s: float) -> Rows:
        """Return the filtered rows of one run, without the first p rows for a filter of order p."""
        order, count = len(filter_) - 1, len(rows)
        white = np.zeros_like(rows[order:])
        for lag, weight in enumerate(filter_):
            white += weight * rows[order - lag : count - lag]
        return white

    def log_determinant(self, partial: Float[np.ndarray, " p"]) -> float:
        """Return the log-determinant of the covariance of all rows, for innovation variance one."""
        return len(self.heads) * float(log_initial_determinant(partial))

    def weighted_products(self, order: int) -> Float[np.ndarray, "products q q"]:
        """Return Γ_0, Γ_l + Γ_lᵀ for l = 1 … `order`, and the products of the ends of the runs."""
        lagged = self.lag_products[: order + 1]
        lagged = [gram + gram.T if lag else gram for lag, gram in enumerate(lagged)]
        ends = self.ends[:, :order]
        rings = np.einsum("rai,rbj->abij", ends, ends)
        for place in range(1, order):
            rings[place, 1:] += rings[place - 1, :-1]
        pairs = [
            -(rings[j, k] + rings[k, j]) if j != k else -rings[j, k]
            for j in range(order)
            for k in range(j, order)
        ]
        return np.stack([*lagged, *pairs])

    @staticmethod
    def product_weights(partial: Float[Numbers, " order"]) -> Float[Numbers, " products"]:
        """Return Σ_j f_j f_{j+l} for every lag l, then f_j f_k for 1 ≤ j ≤ k; f is the filter."""
        xp = namespace(partial)
        filter_ = filter_of(partial)
        taps = filter_.shape[0]
        lagged = [filter_[: taps - lag] @ filter_[lag:] for lag in range(taps)]
        first, second = np.triu_indices(taps - 1)
        return xp.concatenate([xp.stack(lagged), filter_[1 + first] * filter_[1 + second]])

    def determinant_terms(self, order: int) -> Float[np.ndarray, ""]:
        """Return the number of runs."""
        return np.asarray(float(len(self.heads)))

    @staticmethod
    def determinant_of(
        terms: Float[Numbers, ""], partial: Float[Numbers, " order"]
    ) -> Float[Number, ""]:
        """Return the log-determinant for the number of runs, `terms`."""
        return terms * log_initial_determinant(partial)

    def _inner_products(self, filter_: Filter) -> Float[np.ndarray, "q q"]:
        """Return Uᵀ Σ⁻¹ U."""
        taps = len(filter_)
        lagged, ends = self.lag_products[:taps], self.ends[:, : taps - 1]
        return np.asarray(whitened_products(lagged, ends, filter_))


def _lag_products(runs: ConditionedRuns, run: int, lags: int) -> Float[np.ndarray, "lags q q"]:
    """Return Σ_t u_t u_{t−l}ᵀ of one run for l = 0 … lags.

    The rows are computed in pieces that stay in the cache for all lags.
    """
    width, count = len(runs.triangle), len(runs.runs[run])
    products = np.zeros((lags + 1, width, width))
    for start in range(0, count, _CACHED_ROWS):
        first = max(start - lags, 0)
        rows = runs.part(run, first, min(start + _CACHED_ROWS, count))
        for lag in range(lags + 1):
            now = rows[max(start - first, lag) :]
            products[lag] += now.T @ rows[len(rows) - len(now) - lag : len(rows) - lag]
    return products
