"""Whitening of lag products with filters of one length, zeros behind a lower order.

All functions are for one log; `jax.vmap` makes them functions of many.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...identify.summary import HIGHEST_LAG

RIDGE = 1e-13
"""As in `identify.normal_equations`, relative to every column's own square."""

TAPS = HIGHEST_LAG + 1

Partial = Float[Array, " highest"]
Filter = Float[Array, " taps"]

_PLACE = np.arange(TAPS)
REVERSED = (
    (_PLACE[None, :, None] + _PLACE[None, None, :]) == np.arange(1, TAPS)[:, None, None]
).astype(float)
"""For every order k: the matrix that turns (f_0 … f_{k−1}, 0 …) into (0, f_{k−1} … f_0, 0 …)."""


def filter_of(partial: Partial) -> Filter:
    """Whitening filter by Levinson's recursion; partial autocorrelations 0 behind the order."""

    def longer(filter_, step):
        reverse, value = step
        return filter_ - value * (reverse @ filter_), None

    start = jnp.zeros(TAPS).at[0].set(1.0)
    return jax.lax.scan(longer, start, (jnp.asarray(REVERSED), partial))[0]


def whitened(
    lag_products: Float[Array, "flanks lags q q"],
    ends: Float[Array, "flanks 2 lag q"],
    filter_: Filter,
) -> Float[Array, "flanks q q"]:
    """Zᵀ Σ⁻¹ Z of every flank: what `FlankSummary.whitened` does."""
    products = jnp.stack([filter_[: TAPS - lag] @ filter_[lag:] for lag in range(TAPS)])
    total = jnp.tensordot(products, lag_products, ((0,), (1,)))
    total = total + jnp.swapaxes(total, 1, 2) - products[0] * lag_products[:, 0]
    later = np.add.outer(np.arange(1, TAPS), np.arange(HIGHEST_LAG))
    hankel = jnp.where(later < TAPS, filter_[np.minimum(later, HIGHEST_LAG)], 0.0)
    rings = jnp.einsum("aj,frjq->fraq", hankel, ends)
    return total - jnp.einsum("frap,fraq->fpq", rings, rings)


def upper_factor(gram: Float[Array, "flanks q q"]) -> Float[Array, "flanks q q"]:
    """Upper Cholesky factor of every flank's normal matrix, factored with its columns at one."""
    size = jnp.sqrt(jnp.maximum(jnp.diagonal(gram, axis1=1, axis2=2), 0.0))
    size = jnp.where(size == 0, 1.0, size)
    scaled = gram / (size[:, :, None] * size[:, None, :])
    lower = jnp.linalg.cholesky(scaled + RIDGE * jnp.eye(gram.shape[-1]))
    return jnp.swapaxes(lower, 1, 2) * size[:, None, :]


def log_initial_determinant(partial: Partial) -> Float[Array, ""]:
    """−Σ_k k log(1 − π_k²)."""
    return -jnp.sum(jnp.arange(1, TAPS) * jnp.log1p(-(partial**2)))
