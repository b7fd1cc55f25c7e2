"""Lag products of readings inside a compiled program, and their whitening.

All functions handle one log; `jax.vmap` makes them functions of many.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...identify.compress.block_means import chunk_sums
from ...identify.model.column_layout import ColumnLayout
from ...identify.settings import HIGHEST_LAG
from .rigs import Readings


class Compressed(NamedTuple):
    """Rows of one log, flank by flank, in the form of `LaggedFlank`.

    **Arguments**
    - `lag_products`: Γ_0 … Γ_16.
    - `ends`: the 16 rows next to both ends of the run, the outermost first.
    - `scatter`: sum of squares of the sample noise about the row means.
    """

    lag_products: Float[Array, "flanks lags q q"]
    ends: Float[Array, "flanks 2 lag q"]
    scatter: Float[Array, " flanks"]


def compress(readings: Readings, columns: ColumnLayout, size: int, ratio: float) -> Compressed:
    """Compute the row means of all columns and their lag products; a row is `size` samples."""
    error = readings.driven - ratio * readings.driving

    def of_flank(flank):
        driving, driven, y, clean = flank
        rows = _rows(columns, size, driving, driven, y)
        ends = jnp.stack([rows[:HIGHEST_LAG], rows[::-1][:HIGHEST_LAG]])
        return _lag_products(rows), ends, _scatter(y - clean, size)

    # One flank at a time, so that the code compiles once and the rows stay in cache.
    flanks = (readings.driving, readings.driven, error, readings.clean)
    return Compressed(*jax.lax.map(of_flank, flanks))


def _rows(
    columns: ColumnLayout,
    size: int,
    driving: Float[Array, " n"],
    driven: Float[Array, " n"],
    error: Float[Array, " n"],
) -> Float[Array, "blocks q"]:
    """Return row means in the layout [free | offset | tied | y], without an incomplete last row."""
    blocks = error.shape[0] // size
    tables = [part[: blocks * size].reshape(blocks, size).T for part in (driving, driven)]
    orders = np.asarray(columns.free + columns.tied, np.float64).reshape(-1, 2)
    means = chunk_sums(jnp.asarray(orders), size, *tables) / size
    y = error[: blocks * size].reshape(blocks, size).mean(axis=1)
    free = columns.free_width
    return jnp.concatenate([means[:free], jnp.ones((1, blocks)), means[free:], y[None]]).T


def _lag_products(rows: Float[Array, "n q"]) -> Float[Array, "lags q q"]:
    """Return Σ_t z_t z_{t−l}ᵀ for l = 0 … 16."""
    count = rows.shape[0]
    return jnp.stack([rows[lag:].T @ rows[: count - lag] for lag in range(HIGHEST_LAG + 1)])


def _scatter(noise: Float[Array, " n"], size: int) -> Float[Array, ""]:
    """Return the sum of squares of the samples about the mean of their row."""
    blocks = noise.shape[0] // size
    table = noise[: blocks * size].reshape(blocks, size)
    return jnp.sum((table - table.mean(axis=1, keepdims=True)) ** 2)


RIDGE = 1e-13
"""Ridge relative to the square of every column, as in `identify.compress.flank_summary`."""

TAPS = HIGHEST_LAG + 1

Partial = Float[Array, " highest"]
Filter = Float[Array, " taps"]

_PLACE = np.arange(TAPS)
REVERSED = (
    (_PLACE[None, :, None] + _PLACE[None, None, :]) == np.arange(1, TAPS)[:, None, None]
).astype(float)
"""Matrix of every order k that turns (f_0 … f_{k−1}, 0 …) into (0, f_{k−1} … f_0, 0 …)."""


def filter_of(partial: Partial) -> Filter:
    """Return the whitening filter by Levinson's recursion, for π_k = 0 beyond the order."""

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
    """Return Zᵀ Σ⁻¹ Z of every flank by the method of `LaggedFlank._inner_products`."""
    products = jnp.stack([filter_[: TAPS - lag] @ filter_[lag:] for lag in range(TAPS)])
    total = jnp.tensordot(products, lag_products, ((0,), (1,)))
    total = total + jnp.swapaxes(total, 1, 2) - products[0] * lag_products[:, 0]
    later = np.add.outer(np.arange(1, TAPS), np.arange(HIGHEST_LAG))
    hankel = jnp.where(later < TAPS, filter_[np.minimum(later, HIGHEST_LAG)], 0.0)
    rings = jnp.einsum("aj,frjq->fraq", hankel, ends)
    return total - jnp.einsum("frap,fraq->fpq", rings, rings)


def upper_factor(gram: Float[Array, "flanks q q"]) -> Float[Array, "flanks q q"]:
    """Return the upper Cholesky factor of every flank's normal matrix, with scaled columns."""
    size = jnp.sqrt(jnp.maximum(jnp.diagonal(gram, axis1=1, axis2=2), 0.0))
    size = jnp.where(size == 0, 1.0, size)
    scaled = gram / (size[:, :, None] * size[:, None, :])
    lower = jnp.linalg.cholesky(scaled + RIDGE * jnp.eye(gram.shape[-1])[None])
    return jnp.swapaxes(lower, 1, 2) * size[:, None, :]


def log_initial_determinant(partial: Partial) -> Float[Array, ""]:
    """Return −Σ_k k log(1 − π_k²)."""
    return -jnp.sum(jnp.arange(1, TAPS) * jnp.log1p(-(partial**2)))
