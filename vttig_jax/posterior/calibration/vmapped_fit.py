"""The fit of one compressed log as a fixed program: noise, Gauss–Newton, covariance."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax.scipy.linalg import solve_triangular
from jax.typing import ArrayLike
from jaxtyping import Array, Float, Int

from ...base.arrays import Numbers
from ...identify.relation import Relation
from .compress import Compressed
from .vmapped_reml import restricted_partial
from .whitening import Partial, filter_of, upper_factor, whitened

_STEPS = 5
"""Gauss–Newton steps: the relation is linear to 1e-3, so each gains three digits."""


class Estimate(NamedTuple):
    """Parameters of a relation and their covariance.

    **Arguments**
    - `values`, `covariance`: mm and rad.
    - `innovation_std`: rad.
    """

    values: Float[Numbers, "*logs p"]
    covariance: Float[Numbers, "*logs p p"]
    innovation_std: Float[Numbers, "*logs"]


class Fitted(NamedTuple):
    """One log fitted under the noise it shows, and taking its noise for white.

    **Arguments**
    - `partial`, `order`: of the noise.
    - `white_rows`, `white_samples`: white noise of the rows; and of the samples, which is least
      squares as everybody does it: standard errors from the scatter of single samples.
    """

    modelled: Estimate
    partial: Partial
    order: Int[Array, ""]
    white_rows: Estimate
    white_samples: Estimate


def fit_compressed(
    log: Compressed,
    relation: Relation,
    free: int,
    rows: Int[ArrayLike, ""],
    size: Int[ArrayLike, ""],
) -> Fitted:
    """Fit one log of `rows` rows of `size` samples a flank; `free` columns stand for themselves."""
    partial, order = restricted_partial(log, rows)
    both = jnp.stack([partial, jnp.zeros_like(partial)])
    estimates = jax.vmap(lambda own: _estimate(log, relation, free, rows, own))(both)
    modelled, white = (jax.tree.map(lambda x, k=k: x[k], estimates) for k in range(2))
    flanks, width = len(log.scatter), log.lag_products.shape[-1]
    left = white.innovation_std**2 * (flanks * (rows - width + 1))
    counted = flanks * (rows * size - width + 1)
    sample = (size * left + jnp.sum(log.scatter)) / counted
    ratio = sample / size / white.innovation_std**2
    each = Estimate(white.values, ratio * white.covariance, jnp.sqrt(sample))
    return Fitted(modelled, partial, order, white, each)


def _estimate(
    log: Compressed, relation: Relation, free: int, rows: Int[ArrayLike, ""], partial: Partial
) -> Estimate:
    """Least squares of the parameters; what `whiten` and `solve` do."""
    factor = upper_factor(whitened(log.lag_products, log.ends, filter_of(partial)))
    flanks, width, _ = factor.shape
    variance = jnp.sum(factor[:, -1, -1] ** 2) / (flanks * (rows - width + 1))
    factor = factor / jnp.sqrt(variance)
    matrices, targets = factor[:, free:-1, free:-1], factor[:, free:-1, -1]

    def left(values):
        predicted = relation.coefficients(values)
        return (jnp.einsum("fij,fj->fi", matrices, predicted) - targets).ravel()

    def linearised(values):
        jacobian = jax.jacfwd(left)(values)
        size = jnp.linalg.norm(jacobian, axis=0)
        orthogonal, triangle = jnp.linalg.qr(jacobian / size)
        return orthogonal, triangle, size

    def step(_, values):
        orthogonal, triangle, size = linearised(values)
        return values - solve_triangular(triangle, orthogonal.T @ left(values)) / size

    values = jax.lax.fori_loop(0, _STEPS, step, jnp.zeros(len(relation.names)))
    _, triangle, size = linearised(values)
    inverse = solve_triangular(triangle, jnp.eye(len(size))) / size[:, None]
    return Estimate(values, inverse @ inverse.T, jnp.sqrt(variance))
