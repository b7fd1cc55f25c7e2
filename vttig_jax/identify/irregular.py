"""Rows at unequal times: Ornstein–Uhlenbeck noise, compressed at nodes of its correlation time.

Noise with correlation exp(−|t|/τ) is whitened by (z_t − ρ_t z_{t−1})/√(1 − ρ_t²), ρ_t = exp(−Δt/τ).
The products of the whitened rows are a smooth function of log τ, so that their values at the
Chebyshev nodes of log τ give them at every other τ without touching the rows again.

τ is stated by the partial autocorrelation ρ = exp(−Δ/τ) of rows at the median distance Δ, so that
everything made for an autoregression of first order serves it too: at equal distances they agree.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float
from numpy.polynomial import chebyshev

from ..base.arrays import Number, Numbers, namespace
from ..pair.gears import Flank
from .flank_summary import FlankSummary, conditioned_runs

NODES = 64
_SMALLEST, _LARGEST = 0.01, 0.999
"""ρ of the first and the last node."""

Times = Float[np.ndarray, " n"]


@dataclass(frozen=True)
class IrregularFlank(FlankSummary):
    """Products of the whitened rows U of one flank at the nodes.

    `lag_products` holds Γ_0 alone.

    **Arguments**
    - `matrices`: Uᵀ Σ⁻¹ U at every node as Chebyshev coefficients, shape (nodes, q, q).
    - `determinants`: the same of the log-determinant of Σ, innovations of variance one.
    """

    matrices: Float[np.ndarray, "nodes q q"] = field(kw_only=True)
    determinants: Float[np.ndarray, " nodes"] = field(kw_only=True)

    def log_determinant(self, partial: Float[np.ndarray, " p"]) -> float:
        """Log-determinant of the covariance of all rows, innovations of variance one."""
        if len(partial) == 0 or partial[0] < _SMALLEST:
            return 0.0
        return float(node_weights(partial[0]) @ self.determinants)

    def _inner_products(self, filter_: Float[np.ndarray, " taps"]) -> Float[np.ndarray, "q q"]:
        """Uᵀ Σ⁻¹ U for the filter (1, −ρ); the white one has ρ at the first node or below."""
        rho = -filter_[1] if len(filter_) > 1 else 0.0
        if rho < _SMALLEST:
            return self.lag_products[0]
        return np.tensordot(node_weights(rho), self.matrices, 1)

    def _turned(
        self, matrix: Float[np.ndarray, "q new"], triangle: Float[np.ndarray, "new new"]
    ) -> "IrregularFlank":
        return replace(
            self,
            triangle=triangle,
            lag_products=matrix.T @ self.lag_products @ matrix,
            heads=self.heads @ matrix,
            tails=self.tails @ matrix,
            matrices=matrix.T @ self.matrices @ matrix,
        )

    def _joined(self, other: FlankSummary) -> "IrregularFlank":
        joined = super()._joined(other)
        assert isinstance(joined, IrregularFlank) and isinstance(other, IrregularFlank)
        return replace(
            joined,
            matrices=self.matrices + other.matrices,
            determinants=self.determinants + other.determinants,
        )

    def _observed(self, pseudo: Float[np.ndarray, "q q"]) -> "IrregularFlank":
        observed = super()._observed(pseudo)
        assert isinstance(observed, IrregularFlank)
        matrices = self.matrices.copy()
        matrices[0] += pseudo.T @ pseudo
        return replace(observed, matrices=matrices)


def node_weights(rho: float | Number) -> Float[Numbers, " nodes"]:
    """Chebyshev polynomials at log τ of ρ = exp(−Δ/τ): what multiplies the coefficients."""
    xp = namespace(rho)
    ends = [-np.log(-np.log(end)) for end in (_SMALLEST, _LARGEST)]
    place = -xp.log(-xp.log(rho))
    scaled = (2 * place - ends[0] - ends[1]) / (ends[1] - ends[0])
    return xp.cos(np.arange(NODES) * xp.arccos(xp.clip(scaled, -1.0, 1.0)))


def irregular_flank(
    flank: Flank,
    runs: Sequence[Float[np.ndarray, "_ q"]],
    times: Sequence[Float[np.ndarray, " _"]],
    distance_s: float,
) -> IrregularFlank:
    """Compress runs of rows at the given mean times; ρ is stated at `distance_s`."""
    pieces, pseudo, triangle = conditioned_runs(runs)
    width = runs[0].shape[1]
    nodes = chebyshev.chebpts1(NODES)
    ends = [-np.log(-np.log(end)) for end in (_SMALLEST, _LARGEST)]
    places = 0.5 * (nodes * (ends[1] - ends[0]) + ends[0] + ends[1])
    matrices, determinants = [], []
    for rho in np.exp(-np.exp(-places)):
        matrix, determinant = np.zeros((width, width)), 0.0
        for rows, time in zip(pieces, times, strict=True):
            white, own = whitened_run(rows, time, float(rho), distance_s)
            matrix += white.T @ white
            determinant += own
        matrices.append(matrix)
        determinants.append(determinant)
    inverse = np.linalg.inv(chebyshev.chebvander(nodes, NODES - 1))
    none = np.empty((len(runs), 0, width))
    return IrregularFlank(
        flank,
        triangle,
        np.sum([rows.T @ rows for rows in pieces], axis=0)[None],
        none,
        none,
        sum(map(len, runs)),
        matrices=np.tensordot(inverse, np.array(matrices), 1),
        determinants=inverse @ np.array(determinants),
    )._observed(pseudo)


def whitened_run(
    rows: Float[np.ndarray, "n q"], time: Times, rho: float, distance_s: float
) -> tuple[Float[np.ndarray, "n q"], float]:
    """Rows whitened to innovations of variance 1 − ρ² relative to the noise, and log|Σ|.

    The unit is that of a first-order autoregression with ρ, at which the noise has the variance
    1/(1 − ρ²).
    """
    ratio = rho ** (np.diff(time) / distance_s)
    left = np.sqrt(1 - ratio**2)
    white = rows.copy()
    white[1:] = (rows[1:] - ratio[:, None] * rows[:-1]) / left[:, None]
    unit = 1 - rho**2
    return np.sqrt(unit) * white, float(2 * np.sum(np.log(left)) - len(rows) * np.log(unit))
