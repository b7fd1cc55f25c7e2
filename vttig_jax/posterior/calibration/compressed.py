"""Compression of simulated readings inside a compiled program, for one log or under `jax.vmap`."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ...identify.compress.block_means import chunk_sums
from ...identify.compress.row_products import (
    RowProducts,
    conditioned,
    residual_autocovariance,
    row_products,
)
from ...identify.model.column_layout import ColumnLayout
from ...identify.noise.batched_reml import needed_lags
from ...identify.settings import HIGHEST_LAG
from .rigs import Readings


class Compressed(NamedTuple):
    """Block rows of one log in the compressed form that its fit needs.

    **Arguments**
    - `products`: lag products of the rows. - `needed`: number of lags that the noise needs.
    - `square`: sum of squares of y, rad².
    - `scatter`: sum over each flank of (sample noise − its mean over the row)², rad².
    """

    products: RowProducts
    needed: Int[Array, ""]
    square: Float[Array, ""]
    scatter: Float[Array, " flanks"]


def compress(readings: Readings, columns: ColumnLayout, size: int, ratio: float) -> Compressed:
    """Average all columns over rows of `size` samples, and return the products of these rows.

    `columns` is the layout of the rows, and `ratio` is driven speed over driving speed.
    """
    error = readings.driven - ratio * readings.driving

    def of_flank(flank):
        driving, driven, y, clean = flank
        return _rows(columns, size, driving, driven, y), _scatter(y - clean, size)

    # One flank at a time, so that the code compiles once and the rows stay in cache.
    flanks = (readings.driving, readings.driven, error, readings.clean)
    rows, scatter = jax.lax.map(of_flank, flanks)
    white, triangle = conditioned(rows[:, None])
    count = rows.shape[1]
    counts = jnp.full((len(rows), 1), count)
    number = jnp.full(len(rows), float(count))
    most = jnp.asarray(int(np.clip(count // 8, 1, HIGHEST_LAG)))
    correlated = residual_autocovariance(white, number, HIGHEST_LAG)
    return Compressed(
        products=row_products(white, triangle, counts, HIGHEST_LAG),
        needed=needed_lags(correlated, number, most),
        square=jnp.sum(rows[..., -1] ** 2),
        scatter=scatter,
    )


def _rows(
    columns: ColumnLayout,
    size: int,
    driving: Float[Array, " n"],
    driven: Float[Array, " n"],
    error: Float[Array, " n"],
) -> Float[Array, "blocks q"]:
    """Return block rows with the columns [free | offset | tied | y].

    A row is the mean over `size` samples; samples behind the last complete row are left out.
    """
    blocks = error.shape[0] // size
    tables = [part[: blocks * size].reshape(blocks, size).T for part in (driving, driven)]
    orders = np.asarray(columns.free + columns.tied, np.float64).reshape(-1, 2)
    means = chunk_sums(jnp.asarray(orders), size, *tables) / size
    y = error[: blocks * size].reshape(blocks, size).mean(axis=1)
    free = columns.free_width
    return jnp.concatenate([means[:free], jnp.ones((1, blocks)), means[free:], y[None]]).T


def _scatter(noise: Float[Array, " n"], size: int) -> Float[Array, ""]:
    """Return Σ (sample − mean of its row)² over all complete rows of `size` samples."""
    blocks = noise.shape[0] // size
    table = noise[: blocks * size].reshape(blocks, size)
    return jnp.sum((table - table.mean(axis=1, keepdims=True)) ** 2)
