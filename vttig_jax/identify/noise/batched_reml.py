"""Noise of many logs by restricted maximum likelihood, inside a compiled program.

The likelihood, its bound and the constants are those of `restricted_likelihood`. The order varies
from log to log and the shapes do not: partial autocorrelations beyond the order are zero. All
functions handle one log; `jax.vmap` makes them functions of many.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from ...base.arrays import Numbers
from ...base.numerics.autoregression import mirror_places
from ...base.numerics.partial_autocorrelation import filter_of
from ..compress.row_products import RowProducts, Upper, inner, upper_and_inverse
from .restricted_likelihood import (
    MOST_STEPS,
    SEARCHES,
    SETTLED,
    SWEEPS,
    Bound,
    best_partial,
    flank_form,
    misfit_weight,
    rounding_form,
)

_NEAR = 1e-2
"""Largest change of a π_k in the last Newton step; a larger step is not taken (chosen)."""

Partial = Float[Array, " lags"]


class Noise(NamedTuple):
    """Autoregression of the rows: order, and partial autocorrelations, zero beyond the order."""

    partial: Partial
    order: Int[Array, ""]


def estimated_noise(
    products: RowProducts, most: Int[Numbers, ""], rounding: Float[Array, ""]
) -> Noise:
    """Return the noise whose order, at most `most`, has the lowest BIC.

    `rounding` is the sum of squares of the rounding errors of y, rad², which count as white noise.
    The result is differentiable at a fixed order: the last step is a Newton step on the restricted
    likelihood, and its derivative is that of the maximum of the likelihood.
    """
    fixed = jax.lax.stop_gradient((products, rounding))
    found = _descended(*fixed, most)
    slope, push = jax.linearize(lambda at: _slope(at, products, rounding), found.partial)
    curvature = jax.vmap(push)(jnp.eye(products.lags))
    free = jnp.arange(products.lags) < found.order
    return Noise(newton_step(found.partial, slope, curvature, free, _NEAR), found.order)


def _slope(partial: Partial, products: RowProducts, rounding: Float[Array, ""]) -> Partial:
    """Return the gradient of F = −2 ln(restricted likelihood) with respect to the π_k.

    It equals the gradient of the bound that touches F at `partial`.
    """
    bound = _touching_bound(products, rounding, partial)
    filter_, turn = jax.vjp(filter_of, partial)
    own = -2 * jnp.arange(1, partial.shape[0] + 1) * partial / (partial**2 - 1)
    return 2 * turn(bound.form @ filter_)[0] + bound.runs * own


def newton_step(
    start: Float[Array, " p"],
    slope: Float[Array, " p"],
    curvature: Float[Array, "p p"],
    free: Bool[Array, " p"],
    most: float,
) -> Float[Array, " p"]:
    """Return `start` after one Newton step in the components `free`.

    `slope` is the gradient g of the function to be minimised, and `curvature` is its Hessian H.
    Automatic differentiation by the data passes through `slope` only. At a minimum the derivative
    of the result is therefore −H⁻¹ ∂g/∂data, which is the derivative of the minimum itself. With
    the Gauss–Newton approximation of H it would be another one. If any component of the step
    exceeds `most`, the step is not taken.
    """
    start, curvature = jax.lax.stop_gradient((start, curvature))
    both = free[:, None] & free[None, :]
    inverse = upper_and_inverse(jnp.where(both, curvature, jnp.eye(len(start)))).inverse
    inverse = jnp.where(jnp.all(jnp.isfinite(inverse)), inverse, 0.0)
    step = inverse @ (inverse.T @ jnp.where(free, slope, 0.0))
    near = jnp.max(jnp.abs(jax.lax.stop_gradient(step)), initial=0.0) <= most
    return start - jnp.where(near, step, 0.0)


def _descended(products: RowProducts, rounding: Float[Array, ""], most: Int[Numbers, ""]) -> Noise:
    """Return the noise: search the order by BIC, then lower the bound at this order repeatedly."""
    total = jnp.sum(products.rows)

    def search(_, state):
        return _of_best_order(_touching_bound(products, rounding, state[0]), most, total)

    start = jnp.zeros(products.lags), jnp.zeros((), int)
    partial, order = jax.lax.fori_loop(0, SEARCHES, search, start)

    def unsettled(state):
        _, moved, step = state
        return (step < MOST_STEPS) & (moved >= SETTLED)

    def descend(state):
        before, _, step = state
        after = _lowered(_touching_bound(products, rounding, before), before, order)
        return after, jnp.max(jnp.abs(after - before)), step + 1

    partial, _, _ = jax.lax.while_loop(unsettled, descend, (partial, jnp.asarray(jnp.inf), 0))
    return Noise(partial, order)


def needed_lags(
    autocovariance: Float[Array, "flanks taps"], rows: Float[Array, " flanks"], most: Int[Array, ""]
) -> Int[Array, ""]:
    """Return the number of lags, as `needed_lags` of `harmonic_summary` does, at most `most`.

    It is the autoregressive order of the residual of ordinary least squares, plus two.
    `autocovariance` is that of this residual on every flank.
    """
    orders = jax.vmap(_yule_walker_order)(autocovariance, rows, jnp.stack([most] * len(rows)))
    return jnp.clip(jnp.max(orders) + 2, 1, most)


def freedom_left(products: RowProducts) -> Float[Array, ""]:
    """Return the number of rows minus the number of coefficients of all flanks, at least 1."""
    flanks, _, width, _ = products.lag_products.shape
    return jnp.maximum(jnp.sum(products.rows) - flanks * (width - 1), 1.0)


def misfit_of(products: RowProducts, upper: Upper) -> Float[Array, ""]:
    """Return the squared length of the whitened residual of one log, summed over its flanks, rad².

    `upper` is the result of `inner` for the same `products` and the filter of the noise. The length
    follows from `upper` and `products.triangle` together; see `_residual_length`.
    """
    return jnp.sum(_residual_length(products, upper) ** 2)


def residual_rows(products: RowProducts, upper: Upper) -> Float[Array, "flanks q"]:
    """Return one weight vector w per flank, which turns a row into its residual y − xβ, rad.

    The residual of generalised least squares, not whitened, is u · w. Here u is a row of U, the
    conditioned rows from which `products` was computed; y is part of their last column. `upper` is
    the result of `inner` for the same `products` and the filter of the noise.
    """
    return _residual_length(products, upper)[:, None] * upper.inverse[:, :, -1]


def _residual_length(products: RowProducts, upper: Upper) -> Float[Array, " flanks"]:
    """Return the length |Σ^(−1/2) (y − X β)| of the whitened residual of every flank, rad.

    `upper` is the triangle C of `inner` for the filter of the noise. With the triangle F of
    `products`, the length is the last diagonal element of C F.
    """
    return upper.triangle[:, -1, -1] * products.triangle[:, -1, -1]


def _of_best_order(
    bound: Bound, most: Int[Numbers, ""], rows: Float[Array, ""]
) -> tuple[Partial, Int[Array, ""]]:
    """Return the partial autocorrelations of the order with the lowest BIC, and this order.

    Each order starts from the result of the previous order. `rows` is the number of all rows.
    """
    cost = jnp.log(jnp.maximum(rows, 2.0))

    def longer(step, state):
        partial, best, order, score = state
        sweep = lambda _, partial: _lowered(bound, partial, step + 1)  # noqa: E731
        partial = jax.lax.fori_loop(0, SWEEPS, sweep, partial)
        bic = bound.at(partial, filter_of(partial)) + (step + 1) * cost
        better = bic < score
        return (
            partial,
            jnp.where(better, partial, best),
            jnp.where(better, step + 1, order),
            jnp.where(better, bic, score),
        )

    zero = jnp.zeros(bound.form.shape[0] - 1)
    start = (zero, zero, jnp.zeros((), int), bound.at(zero, filter_of(zero)))
    _, best, order, _ = jax.lax.fori_loop(0, most, longer, start)
    return best, order


def _lowered(bound: Bound, partial: Partial, order: Int[Array, ""]) -> Partial:
    """Return `partial` after one coordinate descent: the bound is minimised over one π_k at a time.

    k runs from `order` down to 1.
    """

    def better(step, partial):
        k = order - 1 - step
        without, with_ = jax.vmap(lambda value: filter_of(partial.at[k].set(value)))(
            jnp.arange(2.0)
        )
        slope = with_ - without
        along = bound.form @ slope
        best = best_partial(slope @ along, without @ along, bound.runs * (k + 1))
        return partial.at[k].set(best)

    return jax.lax.fori_loop(0, order, better, partial)


def _touching_bound(products: RowProducts, rounding: Float[Array, ""], partial: Partial) -> Bound:
    """Return the bound that touches the restricted likelihood at `partial`."""
    filter_ = filter_of(partial)
    upper = inner(products, filter_)
    left = _residual_length(products, upper)
    weight = misfit_weight(left @ left, freedom_left(products), rounding, filter_)
    forms = jax.vmap(flank_form, in_axes=(0, 0, 0, 0, None))(
        products.lag_products, products.ends, upper.inverse, left, weight
    )
    form = jnp.sum(forms, axis=0) + rounding_form(rounding, weight, len(filter_))
    return Bound(form, jnp.sum(products.runs))


def _yule_walker_order(
    autocovariance: Float[Array, " taps"], rows: Float[Array, ""], most: Int[Array, ""]
) -> Int[Array, ""]:
    """Return the order, at most `most`, with the lowest BIC in Levinson's recursion."""
    taps = autocovariance.shape[0]
    rows, least = jnp.maximum(rows, 2.0), 1e-300

    def longer(state, step):
        filter_, variance = state
        order, places = step
        mirrored = filter_[places]
        partial = mirrored @ autocovariance / variance
        variance = jnp.maximum(variance * (1 - partial**2), least)
        score = rows * jnp.log(variance) + jnp.log(rows) * order
        score = jnp.where(order <= most, score, jnp.inf)
        return (filter_ - partial * mirrored, variance), score

    first = jnp.maximum(autocovariance[0], least)
    start = jnp.zeros(taps).at[0].set(1.0), first
    steps = jnp.arange(1, taps), jnp.asarray(mirror_places(taps - 1))
    _, scores = jax.lax.scan(longer, start, steps)
    return jnp.argmin(jnp.concatenate([rows * jnp.log(first)[None], scores]))
