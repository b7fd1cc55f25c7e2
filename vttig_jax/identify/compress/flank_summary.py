"""Summary of one flank: products of its conditioned rows, and their likelihood.

The rows Z = [regressors, y] are stored as Z = U F with nearly orthonormal columns U and an upper
triangle F. Products are formed only of the rows of U, so the condition number of the regressors is
not squared. Only the spread of the noise spectrum is squared, which is known beforehand.

Each subclass is for one kind of noise with the covariance Σ. It keeps the products of the rows from
which Uᵀ Σ⁻¹ U can be computed for any parameters of this noise, so that the rows are not needed
again. The parameters are partial autocorrelations, or the whitening filter that follows from them.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import ClassVar

import numpy as np
from jaxtyping import Float, Int
from scipy.linalg import solve_triangular

from ...base.arrays import Number, Numbers
from ...base.errors import NoAnswerError
from ...pair.gear_pair import Flank
from .orthogonal import ConditionedRuns, orthonormal, triangle_of

_LOST_DIGITS = 1e-13
"""Ridge that `of_products` adds, relative to the squared norm of a column. It is well above the
rounding of products (1e-16)."""

_KNOWN = 2  # filters whose factor is kept: the noise model and one before it; chosen value

Rows = Float[np.ndarray, "_ q"]
"""Rows of one run."""

Times = Float[np.ndarray, " _"]
"""Mean times of the rows of one run, s."""

Filter = Float[np.ndarray, " _"]
"""Whitening filter of the noise."""


@dataclass(frozen=True)
class FlankSummary(ABC):
    """Products of the block rows of one flank, summed over its runs.

    A subclass adds its own products. `STACKS` names the arrays of (q, q) matrices, which change if
    the columns of U are transformed. `SUMS` names the arrays that do not change then. The first
    matrix of a stack contains the pseudo-observations.

    **Arguments**
    - `triangle`: F, shape (q, q); y is the last of the q columns of the rows Z = U F.
    - `lag_products`: Γ_0 … Γ_L of the rows u of U, shape (L + 1, q, q).
    - `heads`, `tails`: the first and last L rows of U of every run, shape (runs, L, q).
    - `rows`: number of block rows of all runs together.
    """

    flank: Flank
    triangle: Float[np.ndarray, "q q"]
    lag_products: Float[np.ndarray, "lags q q"]
    heads: Float[np.ndarray, "runs lag q"]
    tails: Float[np.ndarray, "runs lag q"]
    rows: int

    STACKS: ClassVar[tuple[str, ...]]
    SUMS: ClassVar[tuple[str, ...]]
    QUADRATIC: ClassVar[bool]
    """Whether Uᵀ Σ⁻¹ U is a quadratic form of the whitening filter whose coefficients are the lag
    products. If it is not, the noise has at most one partial autocorrelation."""

    @classmethod
    @abstractmethod
    def of_runs(
        cls, flank: Flank, runs: ConditionedRuns, times: Sequence[Times], block_s: float, lags: int
    ) -> "FlankSummary":
        """Return the summary of conditioned runs, each of which has more than `lags` rows.

        `times` are the mean times of the rows, and `block_s` is their median distance in s.
        """

    @staticmethod
    @abstractmethod
    def whitened(rows: Rows, time: Times, filter_: Filter, block_s: float) -> Rows:
        """Return the innovations of the rows of one run.

        The first rows, as many as the order of the noise, have no complete history and are left
        out.
        """

    @abstractmethod
    def log_determinant(self, partial: Float[np.ndarray, " p"]) -> float:
        """Return the log-determinant of the covariance of all rows, for innovation variance one."""

    @abstractmethod
    def weighted_products(self, order: int) -> Float[np.ndarray, "products q q"]:
        """Return the matrices P_k with Uᵀ Σ⁻¹ U = Σ_k w_k P_k for noise of this order."""

    @staticmethod
    @abstractmethod
    def product_weights(partial: Float[Numbers, " order"]) -> Float[Numbers, " products"]:
        """Return the weights w_k of `weighted_products`."""

    @abstractmethod
    def determinant_terms(self, order: int) -> Float[np.ndarray, "*terms"]:
        """Return the numbers from which `determinant_of` computes the log-determinant.

        `order` is the order of the autoregression. The numbers of two flanks may be added: the sum
        gives the log-determinant of both flanks together.
        """

    @staticmethod
    @abstractmethod
    def determinant_of(
        terms: Float[Numbers, "*terms"], partial: Float[Numbers, " order"]
    ) -> Float[Number, ""]:
        """Return the log-determinant that `log_determinant` returns, for compiled functions."""

    @abstractmethod
    def _inner_products(self, filter_: Filter) -> Float[np.ndarray, "q q"]:
        """Return Uᵀ Σ⁻¹ U for a whitening filter and innovations of variance one."""

    @classmethod
    def of_products(
        cls, flank: Flank, rows: int, *, lag_products: Float[np.ndarray, "lags q q"], **parts
    ) -> "FlankSummary":
        """Return the summary of a flank from the lag products of its rows Z, without the rows.

        The products keep only half the digits of the rows. The ridge `_LOST_DIGITS` is added in
        every direction, so that the triangle exists in spite of the lost digits.
        """
        size = np.sqrt(np.maximum(np.diag(lag_products[0]), 0.0))
        size[size == 0] = 1.0
        values, vectors = np.linalg.eigh(lag_products[0] / np.outer(size, size))
        root = np.sqrt(np.maximum(values, 0.0) + _LOST_DIGITS)[:, None] * vectors.T * size
        triangle, one = triangle_of(root), np.eye(len(size))
        plain = cls(flank, one, lag_products=lag_products, rows=rows, **parts)
        turned = plain._turned(np.linalg.inv(triangle), triangle)
        lost = one - turned.lag_products[0]
        for name in cls.STACKS:
            getattr(turned, name)[0] += lost
        turned.lag_products[0] = one
        return turned

    def __add__(self, other: "FlankSummary") -> "FlankSummary":
        """Return the summary of the runs of both summaries.

        Each run keeps its own start and end: no product extends from one run to another.
        """
        upper, lower, pseudo, triangle = _stacked(self.triangle, other.triangle)
        one, two = self._turned(upper, triangle), other._turned(lower, triangle)
        return one._joined(two).observed(pseudo)

    def transformed(self, matrix: Float[np.ndarray, "new q"]) -> "FlankSummary":
        """Return the summary of the transformed rows `matrix` · z, where z is a row of Z."""
        turn, _, pseudo, triangle = _stacked(self.triangle @ matrix.T)
        return self._turned(turn, triangle).observed(pseudo)

    def selected(self, keep: Int[np.ndarray, " kept"]) -> "FlankSummary":
        """Return the summary of rows with only the columns `keep`, in this order."""
        return self.transformed(np.eye(len(self.triangle))[keep])

    def observed(self, pseudo: Float[np.ndarray, "_ q"]) -> "FlankSummary":
        """Return the summary with the rows `pseudo` added, the pseudo-observations.

        Their errors are uncorrelated, so only the first matrix of every stack changes.
        """
        stacks = {name: getattr(self, name).copy() for name in self.STACKS}
        for stack in stacks.values():
            stack[0] += pseudo.T @ pseudo
        return replace(self, **stacks)

    def inner(self, filter_: Filter) -> Float[np.ndarray, "q q"]:
        """Return the upper triangle C with CᵀC = Uᵀ Σ⁻¹ U for innovations of variance one.

        **Raises** `NoAnswerError` if the range of the noise spectrum exceeds the digits of a float.
        """
        known, key = self._inner_of, filter_.tobytes()
        if key in known:
            return known[key]
        try:
            triangle = np.linalg.cholesky(self._inner_products(filter_)).T
        except np.linalg.LinAlgError:
            raise NoAnswerError(
                "the residual is so smooth that its noise cannot be told from slow structure;"
                " record more turns, or list fewer orders in [fit]."
            ) from None
        known[key] = triangle
        if len(known) > _KNOWN:
            del known[next(iter(known))]
        return triangle

    @cached_property
    def _inner_of(self) -> dict[bytes, Float[np.ndarray, "q q"]]:
        """Last results of `inner`, by the bytes of the filter."""
        return {}

    def factor(self, filter_: Filter) -> Float[np.ndarray, "q q"]:
        """Return the upper triangle R with RᵀR = Zᵀ Σ⁻¹ Z."""
        return self.inner(filter_) @ self.triangle

    def residual(self, filter_: Filter) -> Float[np.ndarray, " q"]:
        """Return weights w such that, for a row u of U, u · w is the residual of y.

        The residual is that of generalised least squares under the noise of `filter_`.
        """
        inner = self.inner(filter_)
        last = np.zeros(len(inner))
        last[-1] = inner[-1, -1] * self.triangle[-1, -1]
        return solve_triangular(inner, last, check_finite=False)

    def square(self, column: int) -> float:
        """Return the sum of squares of one column of the rows Z."""
        own = self.triangle[:, column]
        return float(own @ self.lag_products[0] @ own)

    @property
    def ends(self) -> Float[np.ndarray, "ends lag q"]:
        """First L and last L rows of U of every run, the outermost first."""
        return np.concatenate([self.heads, self.tails[:, ::-1]])

    def _turned(
        self, matrix: Float[np.ndarray, "q new"], triangle: Float[np.ndarray, "new new"]
    ) -> "FlankSummary":
        """Return the summary of the same runs with the rows `matrix`ᵀ u and another triangle."""
        stacks = {name: matrix.T @ getattr(self, name) @ matrix for name in self.STACKS}
        heads, tails = self.heads @ matrix, self.tails @ matrix
        return replace(self, triangle=triangle, heads=heads, tails=tails, **stacks)

    def _joined(self, other: "FlankSummary") -> "FlankSummary":
        """Return the summary of the runs of both summaries, which have the same triangle."""
        names = ("rows", *self.STACKS, *self.SUMS)
        return replace(
            self,
            heads=np.concatenate([self.heads, other.heads]),
            tails=np.concatenate([self.tails, other.tails]),
            **{name: getattr(self, name) + getattr(other, name) for name in names},
        )


def _stacked(*triangles: Float[np.ndarray, "_ q"]):
    """Factor the rows that one or two triangles stand for together.

    **Returns** the matrix that maps the rows U of each triangle to the common rows U, the
    pseudo-observations, and the common triangle.
    """
    whole = orthonormal(np.vstack(triangles))
    first = len(triangles[0])
    return whole.rows[:first], whole.rows[first:], whole.pseudo, whole.triangle
