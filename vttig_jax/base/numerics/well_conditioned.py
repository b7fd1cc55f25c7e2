"""Factors of matrices that may be singular, by a quick way where their condition is good.

A singular value decomposition tells which columns depend on others. If the condition number shows
that none does, triangular factors give the same result in a fraction of the time.
"""

import numpy as np
from jaxtyping import Float

_GOOD = 1e8
"""Largest condition number, in the norm of column sums, of a matrix that is inverted directly, so
that eight of the sixteen digits are left (chosen). No eigenvalue is then below 1e-8 of the largest
one."""


def pseudo_inverse(matrix: Float[np.ndarray, "p p"], least: float) -> Float[np.ndarray, "p p"]:
    """Return the pseudo-inverse of a symmetric matrix without negative eigenvalues.

    Eigenvalues below the share `least` (at most 1e-8) of the largest one count as zero.

    **Example**
    ```python
    >>> import numpy as np
    >>> from vttig_jax.base.numerics.well_conditioned import pseudo_inverse
    >>> pseudo_inverse(np.diag([2.0, 0.0]), 1e-12).tolist()
    [[0.5, 0.0], [0.0, 0.0]]

    ```
    """
    inverse = _inverse(matrix)
    if inverse is None:
        return np.linalg.pinv(matrix, rcond=least, hermitian=True)
    return inverse


def orthonormal_basis(columns: Float[np.ndarray, "n p"], least: float) -> Float[np.ndarray, "n r"]:
    """Return orthonormal columns that span the `columns`.

    Directions whose singular value is below the share `least` (at most 1e-4) of the largest one are
    left out. Columns of good condition are factored twice by Cholesky, which leaves no error of the
    first time (Y. Yamamoto et al., ETNA 44 (2015) 306).

    **Example**
    ```python
    >>> import numpy as np
    >>> from vttig_jax.base.numerics.well_conditioned import orthonormal_basis
    >>> orthonormal_basis(np.ones((4, 2)), 1e-6).shape
    (4, 1)

    ```
    """
    gram = columns.T @ columns
    if _inverse(gram) is None:
        vectors, size, _ = np.linalg.svd(columns, full_matrices=False)
        return vectors[:, size > least * size[0]]
    basis = columns
    for _ in range(2):
        basis = basis @ np.linalg.inv(np.linalg.cholesky(basis.T @ basis)).T
    return basis


def least_squares(
    columns: Float[np.ndarray, "n p"], values: Float[np.ndarray, " n"], least: float
) -> Float[np.ndarray, " p"]:
    """Return the coefficients of `columns` that fit `values` by least squares.

    Columns of good condition are solved by normal equations of columns of length 1, and a second
    time for the residual, which removes the rounding errors of the first time. Otherwise singular
    values below the share `least` of the largest one count as zero.

    **Example**
    ```python
    >>> import numpy as np
    >>> from vttig_jax.base.numerics.well_conditioned import least_squares
    >>> least_squares(np.ones((3, 1)), np.array([1.0, 2.0, 6.0]), 1e-9).round(12).tolist()
    [3.0]

    ```
    """
    size = np.sqrt(np.einsum("np,np->p", columns, columns))
    scaled = columns / np.where(size > 0, size, 1.0)
    inverse = _inverse(scaled.T @ scaled)
    if inverse is None:
        return np.linalg.lstsq(columns, values, rcond=least)[0]
    found = inverse @ (values @ scaled)
    found += inverse @ ((values - scaled @ found) @ scaled)
    return found / size


def _inverse(matrix: Float[np.ndarray, "p p"]) -> Float[np.ndarray, "p p"] | None:
    """Return the inverse of a matrix of good condition, otherwise None."""
    try:
        inverse = np.linalg.inv(matrix)
    except np.linalg.LinAlgError:
        return None
    size, other = (float(np.abs(each).sum(axis=0).max(initial=0.0)) for each in (matrix, inverse))
    return inverse if size * other < _GOOD else None
