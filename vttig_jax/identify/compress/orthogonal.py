"""Least squares by triangular factors that exist for any rows.

The condition number of a normal matrix is the square of that of its rows. The last digits, which
differ between processors, would then decide whether it has a Cholesky factor. A QR factor always
exists. Many rows are conditioned first, with a shift that has no effect on the result.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple, Protocol, final, runtime_checkable

import numpy as np
from jaxtyping import Float
from scipy.linalg import get_blas_funcs, qr, solve_triangular

from ...base.numerics.counting import pieces

PSEUDO_OBSERVATION = 1e-10
"""Weight of the observation "this coefficient is zero" of every column, relative to the length of
the column. It decides the coefficients of columns that the data do not determine, for example a
column of zeros or the second of two equal columns. Such a column keeps 1e-10 of its length, which
is above rounding (1e-15) and 1e4 times below the limit of a determined direction (`solve`). All
other coefficients change by less than 1e-14 of their value for a condition number of 1e3."""

EMPTY = 1e-16
"""A column with a smaller sum of squares counts as zero. The pseudo-observation of a column of
zeros has the square 1e-20."""

_SHIFT = 1e-12
"""Share of every squared column that is added before rows are conditioned: a hundred times the
rounding error of a sum of 10⁵ squares, so that the Cholesky factor exists on every processor."""

_TRSM: Any = get_blas_funcs("trsm", dtype="d")  # faster for few rows than `solve_triangular`

_GROWTH = 1e4
"""Largest growth of a rounding error by a product with an inverse instead of a substitution; four
of sixteen digits (chosen)."""

_PIECE = 4096  # rows that are read at once; chosen value


class Factored(NamedTuple):
    """Factored rows Z = U F, with the pseudo-observations below them.

    **Arguments**
    - `rows`: U.
    - `pseudo`: the rows of U that belong to the pseudo-observations.
    - `triangle`: F, upper triangular, without negative numbers on its diagonal.
    """

    rows: Float[np.ndarray, "n q"]
    pseudo: Float[np.ndarray, "q q"]
    triangle: Float[np.ndarray, "q q"]


def orthonormal(rows: Float[np.ndarray, "n q"]) -> Factored:
    """Factor rows and pseudo-observations together, so that the columns of U are orthonormal."""
    factored: Any = qr(_observed(rows), mode="economic", check_finite=False, overwrite_a=True)
    full, triangle = factored
    sign = _signs(triangle)
    full *= sign
    return Factored(full[: len(rows)], full[len(rows) :], triangle * sign[:, None])


@runtime_checkable
class RowTable(Protocol):
    """Rows of one run, as an array or as a table whose rows are computed when they are read."""

    def __len__(self) -> int: ...

    def __getitem__(self, part: slice, /) -> np.ndarray: ...


@final
@dataclass(frozen=True, eq=False)
class ConditionedRuns:
    """Rows Z = U F of several runs, where the columns of U are nearly orthonormal.

    F is the Cholesky factor of ZᵀZ + 1e-12 of its diagonal, and U = Z F⁻¹ by substitution, which is
    exact to the last digits of Z, and much faster than QR. With pseudo-observations no singular
    value of U is below 1e-4, so products of its rows keep eight digits in the worst direction
    (shifted CholeskyQR, T. Fukaya et al., SIAM J. Sci. Comput. 42 (2020) A477). The condition
    number of ZᵀZ has no effect. Rows of U are computed when they are read, so that a long log is
    not in memory twice.

    **Arguments**
    - `runs`: the rows Z of every run.
    - `pseudo`: rows of U of the pseudo-observations, and of the rows `held` that are no
      measurements.
    - `triangle`: F, upper triangular.
    """

    runs: Sequence[RowTable]
    pseudo: Float[np.ndarray, "_ q"]
    triangle: Float[np.ndarray, "q q"]

    @classmethod
    def of(cls, runs: Sequence[RowTable], held: Float[np.ndarray, "_ q"]) -> "ConditionedRuns":
        """Condition the rows of all runs together with the rows `held`, such as `Drift.held`."""
        gram = held.T @ held
        for rows in runs:
            for part in pieces(len(rows), _PIECE):
                piece = rows[part]
                gram += piece.T @ piece
        size = np.sqrt(np.diag(gram))
        size[size == 0] = 1.0
        gram /= np.outer(size, size)
        gram[np.diag_indices(len(gram))] += _SHIFT
        triangle = np.linalg.cholesky(gram).T * size
        pseudo = np.concatenate([PSEUDO_OBSERVATION * np.diag(size), held])
        return cls(runs, _substituted(triangle, pseudo), triangle)

    def part(self, run: int, start: int, stop: int) -> Float[np.ndarray, "n q"]:
        """Return the rows `start` … `stop` of U of one run."""
        rows = self.runs[run][start:stop]
        if self._inverse is None:
            return _substituted(self.triangle, np.array(rows, order="C"))
        return rows @ self._inverse

    @cached_property
    def _inverse(self) -> Float[np.ndarray, "q q"] | None:
        """F⁻¹ if a product with it is as exact as the substitution, which takes three times longer.

        The error of Z − U F is a rounding error times the largest sum of |F⁻¹| |F| (R. D. Skeel,
        J. ACM 26 (1979) 494). It is small even if columns depend on each other.
        """
        size = np.linalg.norm(self.triangle, axis=0)
        size[size == 0] = 1.0
        scaled = self.triangle / size
        inverse: Any = solve_triangular(scaled, np.eye(len(scaled)), check_finite=False)
        growth = np.max(np.sum(np.abs(inverse) @ np.abs(scaled), axis=0), initial=0.0)
        return inverse / size[:, None] if growth < _GROWTH else None

    def last_column(self, run: int) -> Float[np.ndarray, " n"]:
        """Return the last column of U of one run, the scaled residual of y on the others."""
        last = np.zeros(len(self.triangle))
        last[-1] = 1.0
        weights = solve_triangular(self.triangle, last, check_finite=False)
        rows = self.runs[run]
        return np.concatenate([rows[part] @ weights for part in pieces(len(rows), _PIECE)])


def triangle_of(rows: Float[np.ndarray, "n q"]) -> Float[np.ndarray, "q q"]:
    """Return the upper triangle R, RᵀR = rowsᵀ rows + pseudo-observations, diagonal positive."""
    factored: Any = qr(_observed(rows), mode="r", check_finite=False, overwrite_a=True)
    triangle = factored[0][: rows.shape[1]]
    return triangle * _signs(triangle)[:, None]


def least_squares(triangle: Float[np.ndarray, "q q"]) -> Float[np.ndarray, " c"]:
    """Return the least-squares coefficients of y, the last column, on the other columns."""
    return solve_triangular(triangle[:-1, :-1], triangle[:-1, -1], check_finite=False)


def residual_weights(triangle: Float[np.ndarray, "q q"]) -> Float[np.ndarray, " q"]:
    """Return the weights (−β, 1) with rows @ weights = residuals; β: least-squares coefficients."""
    return np.append(-least_squares(triangle), 1.0)


def _observed(rows: Float[np.ndarray, "n q"]) -> Float[np.ndarray, "m q"]:
    """Return the rows with the pseudo-observations below them."""
    return np.vstack([rows, PSEUDO_OBSERVATION * np.diag(_sizes(rows))])


def _sizes(rows: Float[np.ndarray, "n q"]) -> Float[np.ndarray, " q"]:
    """Return the lengths of the columns; 1 for a column of zeros."""
    size = np.linalg.norm(rows, axis=0)
    size[size == 0] = 1.0
    return size


def _substituted(
    triangle: Float[np.ndarray, "q q"], rows: Float[np.ndarray, "n q"]
) -> Float[np.ndarray, "n q"]:
    """Return `rows` times the inverse of an upper triangle; the array `rows` is overwritten."""
    if not len(rows):
        return rows
    solved = _TRSM(1.0, triangle, rows.T, trans_a=1, overwrite_b=1)
    return solved.T


def _signs(triangle: Float[np.ndarray, "q q"]) -> Float[np.ndarray, " q"]:
    return np.where(np.diag(triangle) < 0, -1.0, 1.0)
