"""Draws of the linear coefficients that the likelihood integrates out.

A point holds sampled parameters and noise parameters; one set of coefficients is drawn for it.

A compiled JAX program computes the random numbers, the noise weights and the tied coefficients of
every point. NumPy then factors the small matrices of all points of a chunk in one call.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Key

from ...base.arrays import Numbers
from .likelihood import Likelihood, ridged

_CHUNK = 250
"""Points per compiled call (chosen)."""


def coefficient_draws(
    likelihood: Likelihood, points: Float[np.ndarray, "m d"], seed: int, widening: float = 1.0
) -> Float[np.ndarray, "m flanks columns"]:
    """Draw the coefficients of all columns of the design matrix once for each row of `points`.

    A row holds sampled parameters, log std and partial autocorrelations. The noise std is
    multiplied by `widening` when the integrated-out coefficients are drawn. The last axis of the
    result holds the free columns, then the tied columns.
    """
    count = len(points)
    if count == 0:
        return np.zeros((0, len(likelihood.triangles), likelihood.triangles.shape[-1] - 1))
    padded = np.concatenate([points, np.repeat(points[-1:], -count % _CHUNK, axis=0)])
    std = widening * np.exp(padded[:, len(likelihood.sampled_indices)])
    keys = jnp.pad(jax.random.split(jax.random.key(seed), count), (0, -count % _CHUNK), "edge")
    drawn = []
    for start in range(0, count, _CHUNK):
        part = slice(start, start + _CHUNK)
        inputs = map(np.asarray, _inputs(likelihood, padded[part], keys[part]))
        drawn.append(_drawn(likelihood, std[part], *inputs))
    return np.concatenate(drawn)[:count]


@eqx.filter_jit
def _inputs(
    likelihood: Likelihood, points: Float[Numbers, "m d"], keys: Key[Array, " m"]
) -> tuple[Numbers, Numbers, Array, Array]:
    """Return four arrays with one row per point, the inputs of `_drawn`.

    They are the weights of the lag products, the tied coefficients, and standard normal numbers for
    the nuisance parameters and for the free columns.
    """
    count, places = len(likelihood.sampled_indices), jnp.asarray(likelihood.sampled_indices)
    free = likelihood.products.shape[1], likelihood.free

    def of_one(point, key):
        parameters = jnp.asarray(likelihood.fixed).at[places].set(point[:count])
        nuisance_key, free_key = jax.random.split(key)
        return (
            likelihood.kind.product_weights(point[count + 1 :]),
            likelihood.relation.coefficients(parameters),
            jax.random.normal(nuisance_key, (likelihood.spread.shape[0],)),
            jax.random.normal(free_key, free),
        )

    return jax.vmap(of_one)(jnp.asarray(points), keys)


def _drawn(
    likelihood: Likelihood,
    std: Float[np.ndarray, " m"],
    weights: Float[np.ndarray, "m products"],
    tied: Float[np.ndarray, "m flanks tied"],
    normal: Float[np.ndarray, "m nuisance"],
    free_normal: Float[np.ndarray, "m flanks free"],
) -> Float[np.ndarray, "m flanks columns"]:
    """Return one draw of the coefficients of all columns for each point.

    `std` is the standard deviation of the noise innovations, rad. `weights` depend on the noise and
    multiply `likelihood.products`. `tied` are the tied coefficients before the draw of the nuisance
    parameters is added. `normal` and `free_normal` are standard normal numbers.
    """
    free, spread = likelihood.free, np.asarray(likelihood.spread)
    lower = np.linalg.cholesky(np.tensordot(weights, np.asarray(likelihood.products), 1))
    upper = np.swapaxes(lower, -1, -2) @ np.asarray(likelihood.triangles)
    if len(spread):
        rows = upper[:, :, free:-1, free:]
        residual = (rows[..., :-1] @ tied[..., None])[..., 0] - rows[..., -1]
        columns = np.einsum("mfij,nfj->mfin", rows[..., :-1], spread, optimize=True)
        columns = columns.reshape(len(std), -1, len(spread))
        transposed = np.swapaxes(columns, 1, 2)
        factor = np.swapaxes(np.linalg.cholesky(ridged(transposed @ columns)), 1, 2)
        right = -(transposed @ residual.reshape(len(std), -1, 1))
        mean = np.linalg.solve(factor, np.linalg.solve(np.swapaxes(factor, 1, 2), right))
        scattered = mean + np.linalg.solve(factor, (std[:, None] * normal)[..., None])
        tied = tied + np.tensordot(scattered[..., 0], spread, 1)
    target = upper[:, :, :free, -1] - (upper[:, :, :free, free:-1] @ tied[..., None])[..., 0]
    target = target + std[:, None, None] * free_normal
    own = np.linalg.solve(upper[:, :, :free, :free], target[..., None])[..., 0]
    return np.concatenate([own, tied], axis=-1)
