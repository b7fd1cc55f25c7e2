"""Summary of one flank: lag products of its conditioned rows, and their likelihood.

The rows Z = [regressors, y] are stored as Z = U F with nearly orthonormal columns U and an upper
triangle F. Products are formed only of the rows of U, so the condition number of the regressors is
not squared. Only the spread of the noise spectrum is squared, which is known beforehand.

Rows at unequal times have Ornstein–Uhlenbeck noise and are compressed at nodes of its correlation
time. Noise with correlation exp(−|t|/τ) is whitened by

    (z_t − ρ_t z_{t−1})/√(1 − ρ_t²),  ρ_t = exp(−Δt/τ).

The products of the whitened rows are a smooth function of log τ. Their values at the Chebyshev
nodes of log τ therefore determine them at every other τ, and the rows are not needed again.

τ is expressed by the partial autocorrelation ρ = exp(−Δ/τ) of rows at the median distance Δ. The
functions for a first-order autoregression therefore apply to it too; at equal distances the two
kinds of noise are the same.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float, Int
from numpy.polynomial import chebyshev
from scipy.linalg import solve_triangular

from ...base.arrays import Number, Numbers, namespace
from ...base.errors import NoAnswerError
from ...base.numerics.partial_autocorrelation import log_initial_determinant
from ...pair.gear_pair import Flank
from .orthogonal import conditioned, orthonormal, triangle_of

_CACHED_ROWS = 512  # rows per piece of the lag products, which fits in the cache; chosen value

_LOST_DIGITS = 1e-13
"""Share of the squared norm of a column, well above the rounding of products (1e-16)."""


Runs = tuple[list[Float[np.ndarray, "_ q"]], Float[np.ndarray, "q q"], Float[np.ndarray, "q q"]]
"""Rows U of every run, the pseudo-observations, and the common triangle F."""


@dataclass(frozen=True)
class FlankSummary:
    """Lag products of the block rows of one flank, summed over its runs.

    **Arguments**
    - `triangle`: F, shape (q, q); y is the last of the q columns of the rows Z = U F.
    - `lag_products`: Γ_0 … Γ_L of the rows u of U, shape (L + 1, q, q). The order of the noise
      determines L, which is at most 16. Γ_0 includes the pseudo-observations.
    - `heads`, `tails`: the first and last L rows of U of every run, shape (runs, L, q).
    - `rows`: number of block rows of all runs together.
    """

    flank: Flank
    triangle: Float[np.ndarray, "q q"]
    lag_products: Float[np.ndarray, "lags q q"]
    heads: Float[np.ndarray, "runs lag q"]
    tails: Float[np.ndarray, "runs lag q"]
    rows: int

    def __add__(self, other: "FlankSummary") -> "FlankSummary":
        """Return the summary of the runs of both summaries.

        Each run keeps its own start and end: no lag product extends from one run to another.
        """
        upper, lower, pseudo, triangle = _stacked(self.triangle, other.triangle)
        one, two = self._turned(upper, triangle), other._turned(lower, triangle)
        return one._joined(two)._observed(pseudo)

    def transformed(self, matrix: Float[np.ndarray, "new q"]) -> "FlankSummary":
        """Return the summary of the rows `matrix` z instead of z."""
        turn, _, pseudo, triangle = _stacked(self.triangle @ matrix.T)
        return self._turned(turn, triangle)._observed(pseudo)

    def selected(self, keep: Int[np.ndarray, " kept"]) -> "FlankSummary":
        """Return the summary of rows with only the columns `keep`, in this order."""
        return self.transformed(np.eye(len(self.triangle))[keep])

    def inner(self, filter_: Float[np.ndarray, " taps"]) -> Float[np.ndarray, "q q"]:
        """Return the upper triangle C with CᵀC = Uᵀ Σ⁻¹ U for innovations of variance one.

        **Raises** `NoAnswerError` if the range of the noise spectrum exceeds the digits of a float.
        """
        try:
            return np.linalg.cholesky(self._inner_products(filter_)).T
        except np.linalg.LinAlgError:
            raise NoAnswerError(
                "the residual is so smooth that its noise cannot be told from slow structure;"
                " record more turns, or list fewer orders in [fit]."
            ) from None

    def factor(self, filter_: Float[np.ndarray, " taps"]) -> Float[np.ndarray, "q q"]:
        """Return the upper triangle R with RᵀR = Zᵀ Σ⁻¹ Z."""
        return self.inner(filter_) @ self.triangle

    def residual(self, filter_: Float[np.ndarray, " taps"]) -> Float[np.ndarray, " q"]:
        """Return the weights w: u · w is the residual of y by generalised least squares."""
        inner = self.inner(filter_)
        last = np.zeros(len(inner))
        last[-1] = inner[-1, -1] * self.triangle[-1, -1]
        return solve_triangular(inner, last, check_finite=False)

    def square(self, column: int) -> float:
        """Return the sum of squares of one column of the rows Z."""
        own = self.triangle[:, column]
        return float(own @ self.lag_products[0] @ own)

    def log_determinant(self, partial: Float[np.ndarray, " p"]) -> float:
        """Return the log-determinant of the covariance of all rows, for innovation variance one."""
        return len(self.heads) * float(log_initial_determinant(partial))

    @property
    def ends(self) -> Float[np.ndarray, "ends lag q"]:
        """First L and last L rows of U of every run, the outermost first."""
        return np.concatenate([self.heads, self.tails[:, ::-1]])

    def _inner_products(self, filter_: Float[np.ndarray, " taps"]) -> Float[np.ndarray, "q q"]:
        """Return Uᵀ Σ⁻¹ U.

        The filter is applied to every run with zeros before and after it, which gives Σ_{jk}
        filter_j filter_k Γ_{k−j}. The response after the end of the run is subtracted, and, with
        time reversed, the response before its start. The result is the exact quadratic form,
        initial samples included (I. Gohberg, A. Semencul 1972).
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

    def _turned(
        self, matrix: Float[np.ndarray, "q new"], triangle: Float[np.ndarray, "new new"]
    ) -> "FlankSummary":
        """Return the summary of the same runs with the rows `matrix`ᵀ u and another triangle."""
        return replace(
            self,
            triangle=triangle,
            lag_products=matrix.T @ self.lag_products @ matrix,
            heads=self.heads @ matrix,
            tails=self.tails @ matrix,
        )

    def _joined(self, other: "FlankSummary") -> "FlankSummary":
        """Return the summary of the runs of both; both have the same triangle."""
        return replace(
            self,
            lag_products=self.lag_products + other.lag_products,
            heads=np.concatenate([self.heads, other.heads]),
            tails=np.concatenate([self.tails, other.tails]),
            rows=self.rows + other.rows,
        )

    def _observed(self, pseudo: Float[np.ndarray, "q q"]) -> "FlankSummary":
        """Return the summary with the pseudo-observations, which are uncorrelated."""
        products = self.lag_products.copy()
        products[0] += pseudo.T @ pseudo
        return replace(self, lag_products=products)


def summarise_flank(
    flank: Flank, runs: Sequence[Float[np.ndarray, "_ q"]], lags: int
) -> FlankSummary:
    """Return the summary of runs, each of which has more than `lags` rows."""
    return summarise_conditioned(flank, conditioned_runs(runs), lags)


def summarise_conditioned(flank: Flank, factored: Runs, lags: int) -> FlankSummary:
    """Return the summary of runs that are already conditioned."""
    pieces, pseudo, triangle = factored
    return FlankSummary(
        flank,
        triangle,
        np.sum([_lag_products(rows, lags) for rows in pieces], axis=0),
        np.stack([rows[:lags] for rows in pieces]),
        np.stack([rows[len(rows) - lags :] for rows in pieces]),
        sum(map(len, pieces)),
    )._observed(pseudo)


def conditioned_runs(runs: Sequence[Float[np.ndarray, "_ q"]]) -> Runs:
    """Condition the rows of all runs together."""
    whole = conditioned(np.concatenate(runs))
    return np.split(whole.rows, np.cumsum([len(rows) for rows in runs])[:-1]), *whole[1:]


def flank_of_products(
    flank: Flank,
    lag_products: Float[np.ndarray, "lags q q"],
    heads: Float[np.ndarray, "runs lag q"],
    tails: Float[np.ndarray, "runs lag q"],
    rows: int,
) -> FlankSummary:
    """Return the summary of rows Z of which only the lag products are known.

    The products keep half the digits of the rows. `_LOST_DIGITS` is added in every direction, so
    that the triangle exists although the other digits are lost.
    """
    size = np.sqrt(np.maximum(np.diag(lag_products[0]), 0.0))
    size[size == 0] = 1.0
    values, vectors = np.linalg.eigh(lag_products[0] / np.outer(size, size))
    root = np.sqrt(np.maximum(values, 0.0) + _LOST_DIGITS)[:, None] * vectors.T * size
    triangle = triangle_of(root)
    plain = FlankSummary(flank, np.eye(len(triangle)), lag_products, heads, tails, rows)
    turned = plain._turned(np.linalg.inv(triangle), triangle)
    turned.lag_products[0] = np.eye(len(triangle))
    return turned


def _stacked(*triangles: Float[np.ndarray, "_ q"]):
    """Return the common form of the rows of one or two triangles.

    **Returns** the matrix that maps the rows U of each triangle to the common rows U, the
    pseudo-observations, and the common triangle.
    """
    whole = orthonormal(np.vstack(triangles))
    first = len(triangles[0])
    return whole.rows[:first], whole.rows[first:], whole.pseudo, whole.triangle


def _lag_products(rows: Float[np.ndarray, "n q"], lags: int) -> Float[np.ndarray, "lags q q"]:
    """Return Σ_t u_t u_{t−l}ᵀ of one run for l = 0 … lags.

    The rows are processed in pieces that stay in the cache for all lags.
    """
    products = np.zeros((lags + 1, rows.shape[1], rows.shape[1]))
    for start in range(0, len(rows), _CACHED_ROWS):
        now = rows[start : start + _CACHED_ROWS]
        for lag in range(lags + 1):
            skip = max(lag - start, 0)
            past = rows[start - lag + skip : start - lag + len(now)]
            products[lag] += now[skip:].T @ past
    return products


NODES = 64  # Chebyshev nodes of log τ; chosen value
_SMALLEST, _LARGEST = 0.01, 0.999
"""Limits of ρ between which the nodes lie; chosen values."""

Times = Float[np.ndarray, " n"]


@dataclass(frozen=True)
class IrregularFlank(FlankSummary):
    """Summary of rows at unequal times: products of the whitened rows U of one flank at the nodes.

    `lag_products` contains only Γ_0.

    **Arguments**
    - `matrices`: Chebyshev coefficients of Uᵀ Σ⁻¹ U over the nodes, shape (nodes, q, q).
    - `determinants`: Chebyshev coefficients of the log-determinant of Σ for innovations of variance
      one.
    """

    matrices: Float[np.ndarray, "nodes q q"] = field(kw_only=True)
    determinants: Float[np.ndarray, " nodes"] = field(kw_only=True)

    def log_determinant(self, partial: Float[np.ndarray, " p"]) -> float:
        """Return the log-determinant of the covariance of all rows, for innovation variance one."""
        if len(partial) == 0 or partial[0] < _SMALLEST:
            return 0.0
        return float(node_weights(partial[0]) @ self.determinants)

    def _inner_products(self, filter_: Float[np.ndarray, " taps"]) -> Float[np.ndarray, "q q"]:
        """Return Uᵀ Σ⁻¹ U for the filter (1, −ρ); ρ below the nodes counts as white noise."""
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
    """Return the Chebyshev polynomials at log τ, with ρ = exp(−Δ/τ).

    They are the weights of the Chebyshev coefficients.
    """
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
    """Compress runs of rows at the given mean times; ρ belongs to the distance `distance_s`."""
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
    """Return the whitened rows of one run, and log|Σ|.

    `rho` is the correlation at the distance `distance_s`. As in a first-order autoregression with
    ρ, the unit is that of the innovations, and the noise has the variance 1/(1 − ρ²).
    """
    ratio = rho ** (np.diff(time) / distance_s)
    left = np.sqrt(1 - ratio**2)
    white = rows.copy()
    white[1:] = (rows[1:] - ratio[:, None] * rows[:-1]) / left[:, None]
    unit = 1 - rho**2
    return np.sqrt(unit) * white, float(2 * np.sum(np.log(left)) - len(rows) * np.log(unit))
