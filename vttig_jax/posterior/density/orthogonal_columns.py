"""Columns of a likelihood, orthogonalised with the noise weights of one noise model.

The columns that are integrated out come first: free harmonics of every flank, then nuisance
parameters. The kept columns follow: tied columns of every flank, then the residual of the fit. At
the noise of the fit, the integrated-out columns have the identity as their Gram matrix and are
orthogonal to the kept columns; at other noise, small corrections remain.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from .likelihood import Likelihood

_DEPENDENT = 1e-12
"""Smallest accepted share of the squared norm of a column that the columns before it do not explain
(chosen). Rounding alone leaves a share of about 1e-16, and the columns of a fit leave 1e-6 and
more."""


@dataclass(frozen=True)
class OrthogonalColumns:
    """Gram matrix of the columns, which is Σ_k weight_k(noise) · gram[k].

    **Arguments**
    - `gram`: one matrix per noise weight, for all columns.
    - `eliminated`: number of columns that are integrated out.
    - `determinant`: log-determinant of the Gram matrix of the integrated-out columns at the noise
      of the fit, before they were orthogonalised.
    - `at_fit`: Gram matrix of the kept columns at the noise of the fit.
    - `flanks`: as `gram`, but of the columns of each flank alone; the last column is the residual
      of a fit of all other columns to this flank.
    - `excess`: variance factor of the likelihood (robust loss), minus 1.
    """

    gram: Float[np.ndarray, "products c c"]
    eliminated: int
    determinant: float
    at_fit: Float[np.ndarray, "kept kept"]
    flanks: Float[np.ndarray, "products flanks q q"]
    excess: float

    @property
    def squares(self) -> Float[np.ndarray, "pairs products"]:
        """Upper triangle of the Gram matrix of the kept columns, one column per noise weight."""
        kept = self.gram[:, self.eliminated :, self.eliminated :].copy()
        kept[:, -1, -1] += self.excess * self.flanks[:, :, -1, -1].sum(axis=1)
        return _upper(kept)

    @property
    def diagonal(self) -> Float[np.ndarray, "eliminated products"]:
        """Diagonal of `gram` for the integrated-out columns, one column per noise weight."""
        return np.diagonal(self.gram, axis1=1, axis2=2)[:, : self.eliminated].T

    def small_parts(
        self, weights: Float[np.ndarray, "n products"]
    ) -> Float[np.ndarray, "values n"]:
        """Return the corrections that `diagonal` and `squares` do not contain.

        `weights` has one row per noise model, and the result has one column per noise model. The
        first row corrects the log-determinant of the integrated-out columns. The other rows correct
        the upper triangle of the Gram matrix of the kept columns.

        **Raises** `numpy.linalg.LinAlgError` for a Gram matrix that is not positive definite.
        """
        gram = np.tensordot(weights, self.gram, 1)
        first = self.eliminated
        lower = np.linalg.cholesky(gram[:, :first, :first])
        diagonal = np.diagonal(gram[:, :first, :first], axis1=1, axis2=2)
        squares = np.diagonal(lower, axis1=1, axis2=2) ** 2
        determinant = np.sum(np.log(squares / diagonal), axis=1)
        between = np.linalg.solve(lower, gram[:, :first, first:])
        small = -np.swapaxes(between, 1, 2) @ between
        if self.excess:
            flanks = np.tensordot(weights, self.flanks, 1)
            others = np.linalg.solve(flanks[..., :-1, :-1], flanks[..., :-1, -1:])
            explained = np.sum(flanks[..., :-1, -1:] * others, axis=(1, 2, 3))
            small[:, -1, -1] -= self.excess * explained
        return np.concatenate([determinant[None], _upper(small)])


def orthogonal_columns(
    likelihood: Likelihood,
    partial: Float[np.ndarray, " order"],
    tied: Float[np.ndarray, "flanks tied"],
) -> OrthogonalColumns:
    """Return the columns, orthogonalised at the noise with these partial autocorrelations.

    `tied` holds the tied coefficients of the fit; the last column is the residual of the fit.

    **Raises** `numpy.linalg.LinAlgError` for columns that depend on each other.
    """
    columns, first = _columns(likelihood, tied)
    weights = np.asarray(likelihood.kind.product_weights(partial))
    products = np.asarray(likelihood.products)
    gram = _gram(columns, products).sum(axis=1)
    at_fit = np.tensordot(weights, gram, 1)
    lower = np.linalg.cholesky(at_fit[:first, :first])
    # Rounding alone decides whether a singular matrix has a Cholesky factor.
    if np.any(np.diag(lower) ** 2 < _DEPENDENT * np.diag(at_fit)[:first]):
        raise np.linalg.LinAlgError("columns depend on each other")
    turn = np.eye(len(at_fit))
    turn[:first, :first] = np.linalg.inv(lower).T
    turn[:first, first:] = -turn[:first, :first] @ (turn[:first, :first].T @ at_fit[:first, first:])
    own = np.asarray(likelihood.triangles) @ np.eye(products.shape[-1])
    other = np.tensordot(weights, _gram(own, products), 1)
    last = np.linalg.solve(other[:, :-1, :-1], other[:, :-1, -1:])
    own[..., -1:] -= own[..., :-1] @ last
    turned = _gram(columns @ turn, products).sum(axis=1)
    return OrthogonalColumns(
        gram=turned,
        eliminated=first,
        determinant=2.0 * float(np.sum(np.log(np.diag(lower)))),
        at_fit=np.tensordot(weights, turned[:, first:, first:], 1),
        flanks=_gram(own, products),
        excess=float(likelihood.variance_factor) - 1.0,
    )


def _columns(
    likelihood: Likelihood, tied: Float[np.ndarray, "flanks tied"]
) -> tuple[Float[np.ndarray, "flanks q c"], int]:
    """Return the coefficients of all columns in U, and the number of integrated-out columns.

    A column is a linear combination of the columns of U. Its coefficients are those in the columns
    of Z = U F, multiplied by F (`triangles`).
    """
    triangles, free = np.asarray(likelihood.triangles), likelihood.free
    spread = np.asarray(likelihood.spread)
    flanks, width = tied.shape
    first = flanks * free + len(spread)
    columns = np.zeros((flanks, triangles.shape[-1], first + flanks * width + 1))
    for flank in range(flanks):
        columns[flank, :free, flank * free : (flank + 1) * free] = np.eye(free)
        columns[flank, free:-1, flanks * free : first] = spread[:, flank].T
        start = first + flank * width
        columns[flank, free:-1, start : start + width] = np.eye(width)
        columns[flank, free:, -1] = np.append(tied[flank], -1.0)
    return triangles @ columns, first


def _gram(
    columns: Float[np.ndarray, "flanks q c"], products: Float[np.ndarray, "products flanks q q"]
) -> Float[np.ndarray, "products flanks c c"]:
    return np.swapaxes(columns, 1, 2) @ (products @ columns)


def _upper(matrices: Float[np.ndarray, "n k k"]) -> Float[np.ndarray, "pairs n"]:
    """Return the upper triangle of each matrix; off-diagonal elements are multiplied by 2."""
    first, second = np.triu_indices(matrices.shape[-1])
    return (matrices[:, first, second] * np.where(first == second, 1.0, 2.0)).T
