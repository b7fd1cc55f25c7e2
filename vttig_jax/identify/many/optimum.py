"""Parameters of one compressed log for a given noise inside a compiled, differentiable program."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from ...base.arrays import Numbers
from ..compress.row_products import RIDGE, RowProducts, Upper, upper_and_inverse
from ..model.forward_model import ForwardModel
from ..noise.batched_reml import freedom_left, misfit_of, newton_step, residual_rows

_STEPS = 5
"""Gauss–Newton steps: the forward model is linear to 1e-3, so each step gains three digits."""

_NEAR = 1.0  # largest change by the last Newton step, in standard errors of a parameter (chosen)

_SETTLED, _NOT_ABOVE, _ROUNDING = 0.01, 0.01, 1e-6
"""Limits by which a point counts as a minimum; see `solve.least_squares`."""

_LEAST_SHARE = 1e-6
"""The samples do not determine all parameters if less than this share of the length of a column of
the scaled Jacobian is orthogonal to the columns before it (chosen)."""


class Estimate(NamedTuple):
    """Parameters of a forward model (mm and rad) for a given noise.

    **Arguments**
    - `values`, `covariance`: parameters and their covariance.
    - `innovation_std`: standard deviation of the innovations, rad.
    - `converged`, `determined`: whether the solver reached a minimum, and whether the samples
      determine every parameter.
    """

    values: Float[Numbers, "*logs p"]
    covariance: Float[Numbers, "*logs p p"]
    innovation_std: Float[Numbers, "*logs"]
    converged: Bool[Numbers, "*logs"]
    determined: Bool[Numbers, "*logs"]


class _Search(NamedTuple):
    """State of the Gauss–Newton steps.

    **Arguments**
    - `values`: parameters.
    - `tied`, `slopes`: the coefficients of the forward model and their derivatives, of the step
      before or, at the end, at `values`.
    - `linear_misfit`: misfit after the first step.
    """

    values: Float[Array, " p"]
    tied: Float[Array, "flanks t"]
    slopes: Float[Array, "flanks t p"]
    linear_misfit: Float[Array, ""]


def estimate(
    products: RowProducts,
    upper: Upper,
    relation: ForwardModel,
    free: int,
    rounding: Float[Array, ""],
) -> Estimate:
    """Return the generalised least-squares parameters of one log, as `whiten` and `solve` do.

    **Arguments**
    - `upper`: triangular factors of the whitened rows, from `inner`. - `relation`: forward model.
    - `free`: number of first columns that are eliminated (free harmonics, offset and drift).
    - `rounding`: smallest residual sum of squares, rad².

    Gauss–Newton steps find the minimum; one Newton step then makes the result differentiable.
    """
    misfit = jnp.maximum(misfit_of(products, upper), rounding)
    variance = misfit / freedom_left(products)
    factor = upper.triangle @ products.triangle / jnp.sqrt(variance)
    matrix, target = factor[:, free:-1, free:-1], factor[:, free:-1, -1]
    searched = jax.lax.stop_gradient(_searched(relation, *jax.lax.stop_gradient((matrix, target))))
    start = searched.values
    slopes, left = _whitened(matrix, target, searched.tied, searched.slopes)
    scale = jax.lax.stop_gradient(_scale(slopes))
    bend = _bend(relation, start, jax.lax.stop_gradient(jnp.einsum("fij,fi->fj", matrix, left)))
    curvature = slopes.reshape(-1, len(start)).T @ slopes.reshape(-1, len(start)) + bend
    values = scale * newton_step(
        start / scale,
        scale * jnp.einsum("fip,fi->p", slopes, left),
        curvature * scale[:, None] * scale[None],
        free=jnp.ones(len(start), bool),
        most=_NEAR,
    )
    slopes, left = _whitened(matrix, target, *_linearised(relation, values))
    scaled = slopes.reshape(-1, len(start)) * scale[None]
    gain, found = _gauss_newton(scaled, left.ravel())
    inverse = found.inverse @ found.inverse.T
    return Estimate(
        values=values,
        covariance=inverse * scale[:, None] * scale[None],
        innovation_std=jnp.sqrt(variance),
        converged=_is_minimum(left, target, scaled @ gain, searched.linear_misfit),
        determined=jnp.min(jnp.diagonal(found.triangle)) > _LEAST_SHARE,
    )


def _searched(
    relation: ForwardModel, matrix: Float[Array, "flanks t t"], target: Float[Array, "flanks t"]
) -> _Search:
    """Return the parameters after the Gauss–Newton steps, which start at zero.

    `matrix` and `target` are the whitened tied columns and the whitened y of each flank. The last
    pass of the loop only evaluates the forward model, so that the program contains it once.
    """

    def step(number, state):
        tied, derivatives = _linearised(relation, state.values)
        slopes, left = _whitened(matrix, target, tied, derivatives)
        scale = _scale(slopes)
        gain, _ = _gauss_newton(slopes.reshape(-1, len(scale)) * scale[None], left.ravel())
        reached = jnp.where(number == 1, jnp.linalg.norm(left), state.linear_misfit)
        values = jnp.where(number < _STEPS, state.values - scale * gain, state.values)
        return _Search(values, tied, derivatives, reached)

    count = len(relation.names)
    none = jnp.zeros(target.shape), jnp.zeros((*target.shape, count))
    start = _Search(jnp.zeros(count), *none, jnp.asarray(jnp.inf))
    return jax.lax.fori_loop(0, _STEPS + 1, step, start)


def _linearised(
    relation: ForwardModel, values: Float[Array, " p"]
) -> tuple[Float[Array, "flanks t"], Float[Array, "flanks t p"]]:
    """Return the tied coefficients of the forward model and their derivatives at `values`."""

    def twice(values):
        tied = relation.coefficients(values)
        return tied, tied

    slopes, tied = jax.jacfwd(twice, has_aux=True)(values)
    return tied, slopes


def _bend(
    relation: ForwardModel, values: Float[Array, " p"], weights: Float[Array, "flanks t"]
) -> Float[Array, "p p"]:
    """Return the Hessian, with respect to the parameters, of Σ weights · (tied coefficients)."""
    return jax.jacfwd(lambda x: jnp.einsum("ft,ftp->p", weights, _linearised(relation, x)[1]))(
        values
    )


def _whitened(
    matrix: Float[Array, "flanks t t"],
    target: Float[Array, "flanks t"],
    tied: Float[Array, "flanks t"],
    slopes: Float[Array, "flanks t p"],
) -> tuple[Float[Array, "flanks t p"], Float[Array, "flanks t"]]:
    """Return Jacobian and residual of the whitened equations, in innovation standard deviations."""
    return matrix @ slopes, jnp.einsum("fij,fj->fi", matrix, tied) - target


def _scale(slopes: Float[Array, "flanks t p"]) -> Float[Array, " p"]:
    """Return the standard error of each parameter in a fit of it alone; 1 if it has no effect."""
    size = jnp.sqrt(jnp.sum(slopes**2, axis=(0, 1)))
    return 1 / jnp.where(size > 0, size, 1.0)


def row_std(products: RowProducts, upper: Upper) -> Float[Array, ""]:
    """Return the rms of the unwhitened residual of generalised least squares, rad."""
    weights = residual_rows(products, upper)
    square = jnp.einsum("fp,fpq,fq->", weights, products.lag_products[:, 0], weights)
    return jnp.sqrt(jnp.maximum(square, 0.0) / jnp.maximum(jnp.sum(products.rows), 1.0))


def _gauss_newton(
    slopes: Float[Array, "r p"], left: Float[Array, " r"]
) -> tuple[Float[Array, " p"], Upper]:
    """Return the least-squares solution x of slopes · x = left, and the factor of slopes."""
    upper = upper_and_inverse(slopes.T @ slopes + RIDGE * jnp.eye(slopes.shape[1]))
    return upper.inverse @ (upper.inverse.T @ (slopes.T @ left)), upper


def _is_minimum(
    left: Float[Array, "flanks t"],
    target: Float[Array, "flanks t"],
    gain: Float[Array, " r"],
    linear_misfit: Float[Array, ""],
) -> Bool[Array, ""]:
    """Return whether the Gauss–Newton steps have reached a minimum.

    A further step (`gain`) must reduce the residual `left` very little, and the misfit must not be
    much larger than `linear_misfit`, the misfit after the first step.
    """
    whole = jnp.linalg.norm(target)
    first = jnp.where(jnp.isfinite(linear_misfit), linear_misfit, whole)
    bound = first + _NOT_ABOVE * jnp.maximum(first, 1.0) + _ROUNDING * whole
    return (jnp.linalg.norm(gain) <= _SETTLED) & (jnp.linalg.norm(left) <= bound)
