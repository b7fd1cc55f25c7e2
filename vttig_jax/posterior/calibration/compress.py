"""From readings to lag products inside a compiled program: what `identify` does in NumPy."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...identify.blocks import chunk_sums
from ...identify.columns import Columns
from ...identify.summary import HIGHEST_LAG
from .rigs import Readings


class Compressed(NamedTuple):
    """Rows of one log, as `identify.summary.FlankSummary` keeps them, flank by flank.

    **Arguments**
    - `lag_products`: Γ_0 … Γ_16.
    - `ends`: the 16 rows next to both ends of the run, the outermost first.
    - `scatter`: squares of the noise of the samples about the means of their rows.
    """

    lag_products: Float[Array, "flanks lags q q"]
    ends: Float[Array, "flanks 2 lag q"]
    scatter: Float[Array, " flanks"]


def compress(readings: Readings, columns: Columns, size: int, ratio: float) -> Compressed:
    """Row means of all columns, then their lag products; `size` samples make a row."""
    error = readings.driven - ratio * readings.driving

    def one(flank):
        driving, driven, y, clean = flank
        rows = _rows(columns, size, driving, driven, y)
        ends = jnp.stack([rows[:HIGHEST_LAG], rows[::-1][:HIGHEST_LAG]])
        return _lag_products(rows), ends, _scatter(y - clean, size)

    # One flank after the other: it compiles once, and its rows stay in cache.
    flanks = (readings.driving, readings.driven, error, readings.clean)
    return Compressed(*jax.lax.map(one, flanks))


def _rows(
    columns: Columns,
    size: int,
    driving: Float[Array, " n"],
    driven: Float[Array, " n"],
    error: Float[Array, " n"],
) -> Float[Array, "blocks q"]:
    """Row means in the layout [free | offset | tied | y]; a last incomplete row is dropped."""
    blocks = error.shape[0] // size
    tables = [part[: blocks * size].reshape(blocks, size).T for part in (driving, driven)]
    orders = np.asarray(columns.free + columns.tied, np.float64).reshape(-1, 2)
    means = chunk_sums(jnp.asarray(orders), size, *tables) / size
    y = error[: blocks * size].reshape(blocks, size).mean(axis=1)
    free = columns.free_width
    return jnp.concatenate([means[:free], jnp.ones((1, blocks)), means[free:], y[None]]).T


def _lag_products(rows: Float[Array, "n q"]) -> Float[Array, "lags q q"]:
    """Σ_t z_t z_{t−l}ᵀ for l = 0 … 16."""
    count = rows.shape[0]
    return jnp.stack([rows[lag:].T @ rows[: count - lag] for lag in range(HIGHEST_LAG + 1)])


def _scatter(noise: Float[Array, " n"], size: int) -> Float[Array, ""]:
    """Squares about the means of every row."""
    blocks = noise.shape[0] // size
    table = noise[: blocks * size].reshape(blocks, size)
    return jnp.sum((table - table.mean(axis=1, keepdims=True)) ** 2)
