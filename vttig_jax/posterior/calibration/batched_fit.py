"""Fit of one compressed log as a fixed program for `jax.vmap`, with noise and covariance.

The order varies from log to log, the shapes do not: partial autocorrelations beyond the order are
zero. The bound that touches the likelihood, its descent one π_k at a time and the choice of the
order by BIC are those of `identify.noise.reml`; a test compares the two.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.linalg import solve_triangular
from jax.typing import ArrayLike
from jaxtyping import Array, Float, Int

from ...base.arrays import Numbers
from ...identify.model.forward_model import ForwardModel
from ...identify.settings import HIGHEST_LAG
from .compressed import (
    REVERSED,
    TAPS,
    Compressed,
    Partial,
    filter_of,
    log_initial_determinant,
    upper_factor,
    whitened,
)

FEWEST_ROWS = 8 * HIGHEST_LAG
"""Rows per flank from which on `identify` tries all orders."""

_ROUNDING = 1e-14  # white noise of rounding, relative to the squares of y (chosen)
_SEARCHES, _SWEEPS = 2, 3  # searches for the order, sweeps per order (chosen)
_MOST_STEPS, _TOLERANCE = 40, 1e-7  # steps of the descent, change of π that ends it (chosen)
_POLISH = 6
"""Newton steps on the root of the cubic (chosen)."""


class _Bound(NamedTuple):
    form: Float[Array, "taps taps"]
    runs: float

    def at(self, partial: Partial) -> Float[Array, ""]:
        filter_ = filter_of(partial)
        return filter_ @ self.form @ filter_ + self.runs * log_initial_determinant(partial)

    def coordinate_descent(self, partial: Partial, order: Int[Array, ""]) -> Partial:
        """Return `partial` with every π_k up to `order` minimised in turn, the last first."""

        def better(step, partial):
            k = order - 1 - step
            without, with_ = (filter_of(partial.at[k].set(value)) for value in (0.0, 1.0))
            slope = with_ - without
            along = self.form @ slope
            return partial.at[k].set(best_pi(slope @ along, without @ along, self.runs * (k + 1)))

        return jax.lax.fori_loop(0, order, better, partial)


def restricted_partial(log: Compressed, rows: Int[ArrayLike, ""]) -> tuple[Partial, Int[Array, ""]]:
    """Return partial autocorrelations and order of the noise of one log of `rows` rows a flank.

    A flank needs at least `FEWEST_ROWS` rows.
    """
    most = needed_lags(log, rows)
    total = rows * len(log.scatter)

    def search(_, state):
        return _partial_of_best_order(_bound(log, rows, state[0]), most, total)

    start = jnp.zeros(HIGHEST_LAG), jnp.zeros((), int)
    partial, order = jax.lax.fori_loop(0, _SEARCHES, search, start)

    def unsettled(state):
        _, moved, step = state
        return (step < _MOST_STEPS) & (moved >= _TOLERANCE)

    def descend(state):
        before, _, step = state
        after = _bound(log, rows, before).coordinate_descent(before, order)
        return after, jnp.max(jnp.abs(after - before)), step + 1

    return jax.lax.while_loop(unsettled, descend, (partial, jnp.inf, 0))[0], order


def needed_lags(log: Compressed, rows: Int[ArrayLike, ""]) -> Int[Array, ""]:
    """Return the number of lags as `identify` does: order of the ordinary residual plus two."""
    factor = upper_factor(log.lag_products[:, 0])
    weights = jax.vmap(_residual_weights)(factor)
    covariance = jnp.einsum("fp,flpq,fq->fl", weights, log.lag_products, weights) / rows
    orders = jax.vmap(lambda flank: _yule_walker_order(flank, rows))(covariance)
    return jnp.minimum(jnp.max(orders) + 2, HIGHEST_LAG)


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


def _partial_of_best_order(
    bound: _Bound, most: Int[Array, ""], rows: Int[ArrayLike, ""]
) -> tuple[Partial, Int[Array, ""]]:
    """Return the order with the lowest BIC; each order starts from the previous result."""

    def longer(step, state):
        partial, best, order, score = state
        sweep = lambda _, partial: bound.coordinate_descent(partial, step + 1)  # noqa: E731
        partial = jax.lax.fori_loop(0, _SWEEPS, sweep, partial)
        bic = bound.at(partial) + (step + 1) * jnp.log(rows)
        better = bic < score
        return (
            partial,
            jnp.where(better, partial, best),
            jnp.where(better, step + 1, order),
            jnp.where(better, bic, score),
        )

    zero = jnp.zeros(HIGHEST_LAG)
    start = (zero, zero, jnp.zeros((), int), bound.at(zero))
    _, best, order, _ = jax.lax.fori_loop(0, most, longer, start)
    return best, order


def _bound(log: Compressed, rows: Int[ArrayLike, ""], partial: Partial) -> _Bound:
    """Return the bound that touches the restricted likelihood at `partial`."""
    flanks, _, width, _ = log.lag_products.shape
    factor = upper_factor(whitened(log.lag_products, log.ends, filter_of(partial)))
    misfit = jnp.sum(factor[:, -1, -1] ** 2)
    white = _ROUNDING * jnp.sum(log.lag_products[:, 0, -1, -1])
    scale = flanks * (rows - width + 1) / (misfit + white)
    inverse = jax.vmap(lambda r: solve_triangular(r, jnp.eye(width - 1)))(factor[:, :-1, :-1])
    weights = jax.vmap(_residual_weights)(factor)
    spread = jnp.asarray(scale * weights[:, :, None] * weights[:, None, :])
    spread = spread.at[:, :-1, :-1].add(inverse @ jnp.swapaxes(inverse, 1, 2))
    form = _quadratic(log, spread) + scale * white * jnp.eye(TAPS)
    return _Bound(form, float(flanks))


def _quadratic(log: Compressed, spread: Float[Array, "flanks q q"]) -> Float[Array, "taps taps"]:
    """Return the matrix T with fᵀTf = Σ_flanks tr(spread Zᵀ Σ⁻¹ Z)."""
    lagged = jnp.einsum("flpq,fpq->l", log.lag_products, spread)
    form = jnp.take(lagged, np.abs(np.subtract.outer(np.arange(TAPS), np.arange(TAPS))))
    products = jnp.einsum("frap,fpq,frbq->ab", log.ends, spread, log.ends)

    def along_diagonals(above, row):
        sums = jnp.concatenate([jnp.zeros(1), above[:-1] + row])
        return sums, sums

    _, rings = jax.lax.scan(along_diagonals, jnp.zeros(TAPS), products)
    return form.at[1:].add(-rings)


def _residual_weights(factor: Float[Array, "q q"]) -> Float[Array, " q"]:
    """Return (−β, 1) from an upper factor, β the regression coefficients of y."""
    return jnp.append(-solve_triangular(factor[:-1, :-1], factor[:-1, -1]), 1.0)


def _yule_walker_order(
    autocovariance: Float[Array, " taps"], rows: Int[ArrayLike, ""]
) -> Int[Array, ""]:
    """Return the order with the lowest BIC in Levinson's recursion."""

    def longer(state, step):
        filter_, variance = state
        order, reverse = step
        mirrored = reverse @ filter_
        partial = mirrored @ autocovariance / variance
        variance = variance * (1 - partial**2)
        score = rows * jnp.log(variance) + jnp.log(rows) * order
        return (filter_ - partial * mirrored, variance), score

    start = jnp.zeros(TAPS).at[0].set(1.0), autocovariance[0]
    steps = jnp.arange(1, TAPS), jnp.asarray(REVERSED)
    _, scores = jax.lax.scan(longer, start, steps)
    return jnp.argmin(jnp.append(rows * jnp.log(autocovariance[0]), scores))


_STEPS = 5
"""Gauss–Newton steps: the forward model is linear to 1e-3, so each step gains three digits."""


class BatchEstimate(NamedTuple):
    """Parameters of a forward model, their covariance and the innovation std; mm and rad."""

    values: Float[Numbers, "*logs p"]
    covariance: Float[Numbers, "*logs p p"]
    innovation_std: Float[Numbers, "*logs"]


class Fitted(NamedTuple):
    """One log fitted with its estimated noise, and with the noise taken as white.

    **Arguments**
    - `partial`, `order`: partial autocorrelations of the noise, and their number.
    - `white_rows`, `white_samples`: white noise of the rows; white noise of the samples, which is
      ordinary least squares with standard errors from the scatter of single samples.
    """

    modelled: BatchEstimate
    partial: Partial
    order: Int[Array, ""]
    white_rows: BatchEstimate
    white_samples: BatchEstimate


def fit_compressed(
    log: Compressed,
    relation: ForwardModel,
    free: int,
    rows: Int[ArrayLike, ""],
    size: Int[ArrayLike, ""],
) -> Fitted:
    """Fit one log with `rows` rows of `size` samples per flank.

    The first `free` columns are eliminated.
    """
    partial, order = restricted_partial(log, rows)
    both = jnp.stack([partial, jnp.zeros_like(partial)])
    estimates = jax.vmap(lambda noise: _least_squares(log, relation, free, rows, noise))(both)
    modelled, white_rows = (jax.tree.map(lambda x, k=k: x[k], estimates) for k in range(2))
    flanks, width = len(log.scatter), log.lag_products.shape[-1]
    misfit = white_rows.innovation_std**2 * (flanks * (rows - width + 1))
    counted = flanks * (rows * size - width + 1)
    sample = (size * misfit + jnp.sum(log.scatter)) / counted
    ratio = sample / size / white_rows.innovation_std**2
    ordinary = BatchEstimate(white_rows.values, ratio * white_rows.covariance, jnp.sqrt(sample))
    return Fitted(modelled, partial, order, white_rows, ordinary)


def _least_squares(
    log: Compressed, relation: ForwardModel, free: int, rows: Int[ArrayLike, ""], partial: Partial
) -> BatchEstimate:
    """Return the least-squares parameters of one log, as `whiten` and `solve` of `identify` do.

    The `free` first columns are eliminated; `partial` are the partial autocorrelations of the
    noise, and `rows` is the number of rows per flank.
    """
    factor = upper_factor(whitened(log.lag_products, log.ends, filter_of(partial)))
    flanks, width, _ = factor.shape
    variance = jnp.sum(factor[:, -1, -1] ** 2) / (flanks * (rows - width + 1))
    factor = factor / jnp.sqrt(variance)
    matrices, targets = factor[:, free:-1, free:-1], factor[:, free:-1, -1]

    def residual(values):
        predicted = relation.coefficients(values)
        return (jnp.einsum("fij,fj->fi", matrices, predicted) - targets).ravel()

    def linearised(values):
        jacobian = jax.jacfwd(residual)(values)
        size = jnp.linalg.norm(jacobian, axis=0)
        orthogonal, triangle = jnp.linalg.qr(jacobian / size[None])
        return orthogonal, triangle, size

    def step(_, values):
        orthogonal, triangle, size = linearised(values)
        return values - solve_triangular(triangle, orthogonal.T @ residual(values)) / size

    values = jax.lax.fori_loop(0, _STEPS, step, jnp.zeros(len(relation.names)))
    _, triangle, size = linearised(values)
    inverse = solve_triangular(triangle, jnp.eye(len(size))) / size[:, None]
    return BatchEstimate(values, inverse @ inverse.T, jnp.sqrt(variance))
