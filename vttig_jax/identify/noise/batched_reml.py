"""Restricted maximum likelihood of the noise inside a compiled program, for many logs at once.

The bound, its descent one π_k at a time and the choice of the order by BIC are those of `reml`.
The order varies from log to log and the shapes do not: partial autocorrelations beyond the order
are zero. All functions handle one log; `jax.vmap` makes them functions of many.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ...base.arrays import Numbers
from ..compress.row_products import RowProducts, Upper, inner, upper_and_inverse
from .reml import LARGEST

_SEARCHES, _SWEEPS = 2, 3  # searches for the order, sweeps per order; chosen values, as in `reml`
_MOST_STEPS, _SETTLED = 40, 1e-7  # steps of the descent, change of π that ends it, as in `reml`
_POLISH = 6  # Newton steps on the root of the cubic; chosen value
_NEAR = 1e-2
"""Largest change of a π_k by the last Newton step; a larger one is no polish (chosen)."""

Partial = Float[Array, " lags"]
Filter = Float[Array, " taps"]


class Noise(NamedTuple):
    """Autoregression of the rows: partial autocorrelations, zero beyond the order, and order."""

    partial: Partial
    order: Int[Array, ""]


class _Bound(NamedTuple):
    """Upper bound fᵀ `form` f − `runs` Σ_k k log(1 − π_k²) of the restricted likelihood."""

    form: Float[Array, "taps taps"]
    runs: Float[Array, ""]

    def at(self, partial: Partial) -> Float[Array, ""]:
        filter_ = filter_of(partial)
        return filter_ @ self.form @ filter_ + self.runs * log_initial_determinant(partial)

    def lowered(self, partial: Partial, order: Int[Array, ""]) -> Partial:
        """Return `partial` with every π_k up to `order` minimised in turn, the last first."""

        def better(step, partial):
            k = order - 1 - step
            without, with_ = jax.vmap(lambda value: filter_of(partial.at[k].set(value)))(
                jnp.arange(2.0)
            )
            slope = with_ - without
            along = self.form @ slope
            best = best_pi(slope @ along, without @ along, self.runs * (k + 1))
            return partial.at[k].set(jnp.clip(best, -LARGEST, LARGEST))

        return jax.lax.fori_loop(0, order, better, partial)


def estimated_noise(
    products: RowProducts, most: Int[Numbers, ""], rounding: Float[Array, ""]
) -> Noise:
    """Return the noise whose order, at most `most`, has the lowest BIC.

    `rounding` is the sum of squares that counts as white noise, because its digits have no meaning.
    The result is differentiable at a fixed order: its last step is a Newton step on the restricted
    likelihood, whose derivative is that of the maximum.
    """
    fixed = jax.lax.stop_gradient((products, rounding))
    found = _descended(*fixed, most)
    slope, push = jax.linearize(lambda at: _slope(at, products, rounding), found.partial)
    curvature = jax.vmap(push)(jnp.eye(products.lags))
    free = jnp.arange(products.lags) < found.order
    return Noise(newton_step(found.partial, slope, curvature, free, _NEAR), found.order)


def _slope(partial: Partial, products: RowProducts, rounding: Float[Array, ""]) -> Partial:
    """Return the gradient of the restricted likelihood, which is that of the touching bound."""
    bound = _bound(products, rounding, partial)
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

    Only `slope` may depend on the data for a derivative. At a minimum the derivative of the step is
    then −H⁻¹ ∂g/∂data with the gradient g and its derivative H, which is that of the minimum. The
    curvature of a Gauss–Newton step is not H and gives another derivative. A step above `most` in
    any component is not taken.
    """
    start, curvature = jax.lax.stop_gradient((start, curvature))
    both = free[:, None] & free[None, :]
    inverse = upper_and_inverse(jnp.where(both, curvature, jnp.eye(len(start)))).inverse
    inverse = jnp.where(jnp.all(jnp.isfinite(inverse)), inverse, 0.0)
    step = inverse @ (inverse.T @ jnp.where(free, slope, 0.0))
    near = jnp.max(jnp.abs(jax.lax.stop_gradient(step)), initial=0.0) <= most
    return start - jnp.where(near, step, 0.0)


def _descended(products: RowProducts, rounding: Float[Array, ""], most: Int[Numbers, ""]) -> Noise:
    """Return the noise by searches of the order and descents at this order."""
    total = jnp.sum(products.rows)

    def search(_, state):
        return _of_best_order(_bound(products, rounding, state[0]), most, total)

    start = jnp.zeros(products.lags), jnp.zeros((), int)
    partial, order = jax.lax.fori_loop(0, _SEARCHES, search, start)

    def unsettled(state):
        _, moved, step = state
        return (step < _MOST_STEPS) & (moved >= _SETTLED)

    def descend(state):
        before, _, step = state
        after = _bound(products, rounding, before).lowered(before, order)
        return after, jnp.max(jnp.abs(after - before)), step + 1

    partial, _, _ = jax.lax.while_loop(unsettled, descend, (partial, jnp.asarray(jnp.inf), 0))
    return Noise(partial, order)


def needed_lags(
    autocovariance: Float[Array, "flanks taps"], rows: Float[Array, " flanks"], most: Int[Array, ""]
) -> Int[Array, ""]:
    """Return the number of lags as `compress` does: order of the ordinary residual plus two."""
    orders = jax.vmap(_yule_walker_order)(autocovariance, rows, jnp.stack([most] * len(rows)))
    return jnp.clip(jnp.max(orders) + 2, 1, most)


def best_pi(
    curvature: Float[Array, ""], slope: Float[Array, ""], count: Float[Array, ""]
) -> Float[Array, ""]:
    """Return π within ±1 that minimises curvature π² + 2 slope π − count log(1 − π²).

    The derivative times (1 − π²) is a cubic with three real roots; the middle one is within ±1.
    """
    a, b, d = slope / curvature, -(curvature + count) / curvature, -slope / curvature
    q = (a**2 - 3 * b) / 9
    r = (2 * a**3 - 9 * a * b + 27 * d) / 54
    angle = jnp.arccos(jnp.clip(r / q**1.5, -1.0, 1.0))
    root = -2 * jnp.sqrt(q) * jnp.cos((angle - 2 * jnp.pi) / 3) - a / 3
    # If the minimum is beyond ±1/2, 1 − |π| is at least 1 − `inside`.
    inside = 1 - jnp.minimum(0.5, count / (4 * (curvature + jnp.abs(slope))))
    for _ in range(_POLISH):
        root = jnp.clip(root, -inside, inside)
        rest = 1 - root**2
        value = curvature * root + slope + count * root / rest
        root = root - value / (curvature + count * (1 + root**2) / rest**2)
    return jnp.clip(root, -inside, inside)


def filter_of(partial: Partial) -> Filter:
    """Return the whitening filter by Levinson's recursion, for π_k = 0 beyond the order."""

    def longer(filter_, step):
        mirror, value = step
        return filter_ - value * (mirror @ filter_), None

    start = jnp.zeros(partial.shape[0] + 1).at[0].set(1.0)
    return jax.lax.scan(longer, start, (jnp.asarray(_mirrors(partial.shape[0])), partial))[0]


def _mirrors(lags: int) -> Float[np.ndarray, "lags taps taps"]:
    """Return for every order k the matrix from (f_0 … f_{k−1}, 0 …) to (0, f_{k−1} … f_0, 0 …)."""
    place = np.arange(lags + 1)
    sums = place[:, None] + place[None, :]
    return (sums[None] == np.arange(1, lags + 1)[:, None, None]).astype(float)


def log_initial_determinant(partial: Partial) -> Float[Array, ""]:
    """Return −Σ_k k log(1 − π_k²)."""
    return -jnp.sum(jnp.arange(1, partial.shape[0] + 1) * jnp.log1p(-(partial**2)))


def freedom_left(products: RowProducts) -> Float[Array, ""]:
    """Return the rows minus the number of coefficients, at least 1."""
    flanks, _, width, _ = products.lag_products.shape
    return jnp.maximum(jnp.sum(products.rows) - flanks * (width - 1), 1.0)


def misfit_of(products: RowProducts, upper: Upper) -> Float[Array, ""]:
    """Return the whitened misfit of all flanks from the triangles of `inner`."""
    return jnp.sum((upper.triangle[:, -1, -1] * products.triangle[:, -1, -1]) ** 2)


def residual_rows(products: RowProducts, upper: Upper) -> Float[Array, "flanks q"]:
    """Return the weights w of every flank: u · w is the residual by generalised least squares."""
    left = upper.triangle[:, -1, -1] * products.triangle[:, -1, -1]
    return left[:, None] * upper.inverse[:, :, -1]


def _of_best_order(
    bound: _Bound, most: Int[Numbers, ""], rows: Float[Array, ""]
) -> tuple[Partial, Int[Array, ""]]:
    """Return the order with the lowest BIC; each order starts from the previous result."""
    cost = jnp.log(jnp.maximum(rows, 2.0))

    def longer(step, state):
        partial, best, order, score = state
        sweep = lambda _, partial: bound.lowered(partial, step + 1)  # noqa: E731
        partial = jax.lax.fori_loop(0, _SWEEPS, sweep, partial)
        bic = bound.at(partial) + (step + 1) * cost
        better = bic < score
        return (
            partial,
            jnp.where(better, partial, best),
            jnp.where(better, step + 1, order),
            jnp.where(better, bic, score),
        )

    zero = jnp.zeros(bound.form.shape[0] - 1)
    start = (zero, zero, jnp.zeros((), int), bound.at(zero))
    _, best, order, _ = jax.lax.fori_loop(0, most, longer, start)
    return best, order


def _bound(products: RowProducts, rounding: Float[Array, ""], partial: Partial) -> _Bound:
    """Return the bound that touches the restricted likelihood at `partial`."""
    filter_ = filter_of(partial)
    upper = inner(products, filter_)
    white = rounding * (filter_ @ filter_)
    scale = freedom_left(products) / (misfit_of(products, upper) + white)
    weights = residual_rows(products, upper)
    swallowed = upper.inverse[:, :, :-1]
    spread = swallowed @ jnp.swapaxes(swallowed, 1, 2)
    spread = spread + scale * weights[:, :, None] * weights[:, None, :]
    form = _quadratic(products, spread) + scale * rounding * jnp.eye(len(filter_))
    return _Bound(form, jnp.sum(products.runs))


def _quadratic(
    products: RowProducts, spread: Float[Array, "flanks q q"]
) -> Float[Array, "taps taps"]:
    """Return the matrix T with fᵀTf = Σ_flanks tr(spread Uᵀ Σ⁻¹ U)."""
    taps = products.lag_products.shape[1]
    lagged = jnp.einsum("flpq,fpq->l", products.lag_products, spread)
    form = jnp.take(lagged, np.abs(np.subtract.outer(np.arange(taps), np.arange(taps))))
    ends = jnp.einsum("frap,fpq->fraq", products.ends, spread)
    outer = jnp.einsum("fraq,frbq->ab", ends, products.ends)
    for shift in range(taps - 1):
        form = form.at[shift + 1 :, shift + 1 :].add(-outer[: taps - 1 - shift, : taps - 1 - shift])
    return form


def _yule_walker_order(
    autocovariance: Float[Array, " taps"], rows: Float[Array, ""], most: Int[Array, ""]
) -> Int[Array, ""]:
    """Return the order, at most `most`, with the lowest BIC in Levinson's recursion."""
    taps = autocovariance.shape[0]
    rows, least = jnp.maximum(rows, 2.0), 1e-300

    def longer(state, step):
        filter_, variance = state
        order, mirror = step
        mirrored = mirror @ filter_
        partial = mirrored @ autocovariance / variance
        variance = jnp.maximum(variance * (1 - partial**2), least)
        score = rows * jnp.log(variance) + jnp.log(rows) * order
        score = jnp.where(order <= most, score, jnp.inf)
        return (filter_ - partial * mirrored, variance), score

    first = jnp.maximum(autocovariance[0], least)
    start = jnp.zeros(taps).at[0].set(1.0), first
    steps = jnp.arange(1, taps), jnp.asarray(_mirrors(taps - 1))
    _, scores = jax.lax.scan(longer, start, steps)
    return jnp.argmin(jnp.concatenate([rows * jnp.log(first)[None], scores]))
