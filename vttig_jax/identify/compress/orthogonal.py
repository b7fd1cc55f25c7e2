"""Least squares by triangular factors that exist whatever the rows are.

Squares of rows have the square of their condition, so that the last digits, which differ between
processors, would decide whether a normal matrix has a Cholesky factor. A QR factor always exists;
where there are many rows, they are conditioned first, with a shift that decides nothing.
"""

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.linalg import qr, solve_triangular

PSEUDO_OBSERVATION = 1e-10
"""Weight of the observation "this coefficient is zero" that every column takes part in, relative to
the length of the column. It decides the coefficients of columns that the data leave open, such as a
column of zeros or the second of two equal ones. Such a column then keeps 1e-10 of its length, which
rounding (1e-15) does not reach, and which lies a factor of 1e4 below what counts as determined
(`solve`). Every other coefficient moves by less than 1e-14 of itself for a condition of 1e3."""

EMPTY = 1e-16
"""Sum of squares below which a column holds zeros only: its pseudo-observations sum to 1e-20."""

_SHIFT = 1e-12
"""Share of every squared column that is added before rows are conditioned: a hundred times what
rounding makes of a sum of 10⁵ squares, so that the Cholesky factor exists on every processor."""


class Factored(NamedTuple):
    """Rows Z = U F, pseudo-observations below them.

    **Arguments**
    - `rows`: U.
    - `pseudo`: the rows of U that belong to the pseudo-observations.
    - `triangle`: F, upper triangular, no negative number on its diagonal.
    """

    rows: Float[np.ndarray, "n q"]
    pseudo: Float[np.ndarray, "q q"]
    triangle: Float[np.ndarray, "q q"]


def orthonormal(rows: Float[np.ndarray, "n q"]) -> Factored:
    """Rows with orthonormal columns U, pseudo-observations counted."""
    factored: Any = qr(_observed(rows), mode="economic", check_finite=False, overwrite_a=True)
    full, triangle = factored
    sign = _signs(triangle)
    full *= sign
    return Factored(full[: len(rows)], full[len(rows) :], triangle * sign[:, None])


def conditioned(rows: Float[np.ndarray, "n q"]) -> Factored:
    """Rows U with nearly orthonormal columns, for many rows: far faster than a QR factor.

    F is the Cholesky factor of ZᵀZ + 1e-12 of its diagonal, and U = Z F⁻¹ by substitution, which is
    exact to the last digits of Z. With pseudo-observations no singular value of U lies below 1e-4:
    products of its rows keep eight digits in the worst direction (shifted CholeskyQR, T. Fukaya et
    al., SIAM J. Sci. Comput. 42 (2020) A477). The condition of ZᵀZ decides nothing.
    """
    size = _sizes(rows)
    scaled = rows / size
    gram = scaled.T @ scaled
    gram[np.diag_indices(len(gram))] += _SHIFT
    triangle = np.linalg.cholesky(gram).T
    white = _substituted(triangle, scaled)
    return Factored(
        white, _substituted(triangle, PSEUDO_OBSERVATION * np.eye(len(gram))), triangle * size
    )


def triangle_of(rows: Float[np.ndarray, "n q"]) -> Float[np.ndarray, "q q"]:
    """Upper triangle R with RᵀR = rowsᵀ rows + pseudo-observations, its diagonal positive."""
    factored: Any = qr(_observed(rows), mode="r", check_finite=False, overwrite_a=True)
    triangle = factored[0][: rows.shape[1]]
    return triangle * _signs(triangle)[:, None]


def least_squares(triangle: Float[np.ndarray, "q q"]) -> Float[np.ndarray, " c"]:
    """Coefficients of y, the last column, on the columns before it."""
    return solve_triangular(triangle[:-1, :-1], triangle[:-1, -1], check_finite=False)


def residual_weights(triangle: Float[np.ndarray, "q q"]) -> Float[np.ndarray, " q"]:
    """(−β, 1) with β the least-squares coefficients of y: rows @ weights are the residuals."""
    return np.append(-least_squares(triangle), 1.0)


def _observed(rows: Float[np.ndarray, "n q"]) -> Float[np.ndarray, "m q"]:
    """The rows with the pseudo-observations below them."""
    return np.vstack([rows, PSEUDO_OBSERVATION * np.diag(_sizes(rows))])


def _sizes(rows: Float[np.ndarray, "n q"]) -> Float[np.ndarray, " q"]:
    """Lengths of the columns; 1 for a column of zeros."""
    size = np.linalg.norm(rows, axis=0)
    size[size == 0] = 1.0
    return size


def _substituted(
    triangle: Float[np.ndarray, "q q"], rows: Float[np.ndarray, "n q"]
) -> Float[np.ndarray, "n q"]:
    """`rows` times the inverse of an upper triangle."""
    solved: Any = solve_triangular(triangle, rows.T, trans=1, check_finite=False)
    return solved.T


def _signs(triangle: Float[np.ndarray, "q q"]) -> Float[np.ndarray, " q"]:
    return np.where(np.diag(triangle) < 0, -1.0, 1.0)
