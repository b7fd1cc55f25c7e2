"""Flank summary for Ornstein–Uhlenbeck noise of rows at unequal times.

Noise with correlation exp(−|t|/τ) is whitened by

    (z_t − ρ_t z_{t−1})/√(1 − ρ_t²),  ρ_t = exp(−Δt/τ).

The products of the whitened rows are a smooth function of log τ. Their values at the Chebyshev
nodes of log τ therefore determine them at every other τ.

τ is expressed by the partial autocorrelation ρ = exp(−Δ/τ) of rows at the median distance Δ. The
functions for a first-order autoregression therefore apply to it too; at equal distances the two
kinds of noise are the same.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import ClassVar, final

import numpy as np
from jaxtyping import Float
from numpy.polynomial import chebyshev

from ...base.arrays import Number, Numbers, namespace
from ...pair.gear_pair import Flank
from .flank_summary import Filter, FlankSummary, Rows, Times
from .orthogonal import ConditionedRuns

NODES = 64  # Chebyshev nodes of log τ; chosen value
_SMALLEST, _LARGEST = 0.01, 0.999
"""Limits of ρ between which the nodes lie; chosen values."""


@final
@dataclass(frozen=True)
class IrregularFlank(FlankSummary):
    """Products of the whitened rows U of one flank as functions of log τ.

    `lag_products` contains only Γ_0.

    **Arguments**
    - `matrices`: Chebyshev coefficients of Uᵀ Σ⁻¹ U over the nodes, shape (nodes, q, q).
    - `determinants`: Chebyshev coefficients of the log-determinant of Σ for innovations of variance
      one.
    """

    matrices: Float[np.ndarray, "nodes q q"] = field(kw_only=True)
    determinants: Float[np.ndarray, " nodes"] = field(kw_only=True)

    STACKS: ClassVar[tuple[str, ...]] = ("lag_products", "matrices")
    SUMS: ClassVar[tuple[str, ...]] = ("determinants",)
    QUADRATIC: ClassVar[bool] = False

    @classmethod
    def of_runs(
        cls, flank: Flank, runs: ConditionedRuns, times: Sequence[Times], block_s: float, lags: int
    ) -> FlankSummary:
        """Return the summary of conditioned runs; ρ belongs to the distance `block_s`."""
        width = len(runs.triangle)
        nodes = chebyshev.chebpts1(NODES)
        ends = [-np.log(-np.log(end)) for end in (_SMALLEST, _LARGEST)]
        places = 0.5 * (nodes * (ends[1] - ends[0]) + ends[0] + ends[1])
        matrices, determinants = np.zeros((NODES, width, width)), np.zeros(NODES)
        plain = np.zeros((width, width))
        for run, time in enumerate(times):
            rows = runs.part(run, 0, len(runs.runs[run]))
            plain += rows.T @ rows
            for node, rho in enumerate(np.exp(-np.exp(-places))):
                white, own = whitened_run(rows, time, float(rho), block_s)
                matrices[node] += white.T @ white
                determinants[node] += own
        inverse = np.linalg.inv(chebyshev.chebvander(nodes, NODES - 1))
        none = np.empty((len(runs.runs), 0, width))
        return cls(
            flank=flank,
            triangle=runs.triangle,
            lag_products=plain[None],
            heads=none,
            tails=none,
            rows=sum(map(len, runs.runs)),
            matrices=np.tensordot(inverse, matrices, 1),
            determinants=inverse @ determinants,
        ).observed(runs.pseudo)

    @staticmethod
    def whitened(rows: Rows, time: Times, filter_: Filter, block_s: float) -> Rows:
        """Return the innovations of one run for the filter (1, −ρ) without the first row."""
        if len(filter_) == 1:
            return rows
        return whitened_run(rows, time, -float(filter_[1]), block_s)[0][1:]

    def log_determinant(self, partial: Float[np.ndarray, " p"]) -> float:
        """Return the log-determinant of the covariance of all rows, for innovation variance one."""
        if len(partial) == 0 or partial[0] < _SMALLEST:
            return 0.0
        return float(node_weights(partial[0]) @ self.determinants)

    def weighted_products(self, order: int) -> Float[np.ndarray, "products q q"]:
        """Return the coefficients of Uᵀ Σ⁻¹ U, or Γ_0 for white noise."""
        return self.matrices if order else self.lag_products

    @staticmethod
    def product_weights(partial: Float[Numbers, " order"]) -> Float[Numbers, " products"]:
        """Return the weights of the Chebyshev coefficients, or 1 for white noise."""
        return node_weights(partial[0]) if partial.shape[0] else namespace(partial).ones(1)

    def determinant_terms(self, order: int) -> Float[np.ndarray, " terms"]:
        """Return the coefficients of the log-determinant, which is zero for white noise."""
        return self.determinants if order else np.zeros(1)

    @staticmethod
    def determinant_of(
        terms: Float[Numbers, " terms"], partial: Float[Numbers, " order"]
    ) -> Float[Number, ""]:
        """Return the log-determinant from its Chebyshev coefficients `terms`."""
        return IrregularFlank.product_weights(partial) @ terms

    def _inner_products(self, filter_: Filter) -> Float[np.ndarray, "q q"]:
        """Return Uᵀ Σ⁻¹ U for the filter (1, −ρ); ρ below the nodes counts as white noise."""
        rho = -filter_[1] if len(filter_) > 1 else 0.0
        if rho < _SMALLEST:
            return self.lag_products[0]
        return np.tensordot(node_weights(rho), self.matrices, 1)


def node_weights(rho: float | Number) -> Float[Numbers, " nodes"]:
    """Return the Chebyshev polynomials at log τ, with ρ = exp(−Δ/τ).

    They are the weights of the Chebyshev coefficients.
    """
    xp = namespace(rho)
    ends = [-np.log(-np.log(end)) for end in (_SMALLEST, _LARGEST)]
    place = -xp.log(-xp.log(rho))
    scaled = (2 * place - ends[0] - ends[1]) / (ends[1] - ends[0])
    return xp.cos(np.arange(NODES) * xp.arccos(xp.clip(scaled, -1.0, 1.0)))


def whitened_run(
    rows: Float[np.ndarray, "n q"], time: Float[np.ndarray, " n"], rho: float, distance_s: float
) -> tuple[Float[np.ndarray, "n q"], float]:
    """Return the whitened rows of one run, and log|Σ|.

    `rho` is the correlation ρ of rows at the distance `distance_s`, in s. Σ is the covariance of
    noise with the variance 1/(1 − ρ²): as in a first-order autoregression, rows at this distance
    then have innovations of variance one.
    """
    ratio = rho ** (np.diff(time) / distance_s)
    left = np.sqrt(1 - ratio**2)
    white = rows.copy()
    white[1:] = (rows[1:] - ratio[:, None] * rows[:-1]) / left[:, None]
    unit = 1 - rho**2
    return np.sqrt(unit) * white, float(2 * np.sum(np.log(left)) - len(rows) * np.log(unit))
