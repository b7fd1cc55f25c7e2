"""Averages of a log over short blocks, from which a linear model of the transmission error is
fitted.

A block mean of y = Xβ + ε is exactly the mean of X times β plus the mean of ε, for any motion
inside the block. Averaging the regressors and y therefore loses only frequencies above the block
rate; it shortens the log and makes its noise whiter. The same holds for weighted means. If the
samples have weights with the mean s in a block, the row of this block is its weighted mean times
√s.
"""

from collections.abc import Iterable, Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ...base.arrays import Numbers, namespace
from ...base.numerics.counting import whole_below
from ...base.numerics.sincos import sincos
from ...base.units import REV
from ..model.column_layout import ColumnLayout
from ..model.harmonics import AnyTerm
from ..model.waves import Waves, product

Samples = Float[np.ndarray, " n"]

_CHUNK = 8192  # samples whose waves are computed at once, so that they stay in cache (chosen)

_SHORT = 64
"""Samples of a block from which on a block is summed by itself; of shorter blocks those of a chunk
are summed side by side (chosen)."""


def block_size(samples_per_turn: float, highest_order: float, given_order: float = 0.0) -> int:
    """Return the number of samples per block; all orders are in cycles per driving turn.

    There are four blocks per cycle of `highest_order`, limited to 32 … 256 blocks per turn, but
    at least 2.5 blocks per cycle, so that the means keep every modelled order. For a given flank
    model there are at least 16 blocks per cycle of its highest order, `given_order`: its orders may
    be parameters, and means over a sixteenth of a cycle increase their standard errors by 0.6 %.
    """
    blocks = max(min(4.0 * highest_order, 256.0), 32.0, 2.5 * highest_order, 16.0 * given_order)
    return max(1, whole_below(samples_per_turn / blocks))


def block_rows(
    columns: ColumnLayout,
    size: int,
    driving_angle: Samples,
    driven_angle: Samples,
    own: Iterable[Samples] | Float[np.ndarray, "own n"],
    error: Samples,
    weight: Samples | None = None,
) -> Float[np.ndarray, "blocks columns"]:
    """Return the block means of every column over one uninterrupted run.

    An incomplete last block is left out.

    **Arguments**
    - `columns`: layout of one log.
    - `size`: samples per block.
    - `driving_angle`, `driven_angle`: shaft angles, rad.
    - `own`: samples of the own columns of the log, such as drift, without the offset.
    - `error`: transmission error y, in any unit.
    - `weight`: weight of every sample, 0 … 1; None for equal weights.
    """
    blocks = len(error) // size
    rows = np.empty((blocks, columns.width))
    own_columns = columns.own_slice
    harmonics = np.delete(np.arange(columns.width - 1), own_columns)
    terms = columns.free + columns.tied
    per_chunk = max(1, _CHUNK // size)
    channels = [driving_angle, driven_angle] + ([] if weight is None else [weight])
    for start in range(0, blocks if terms else 0, per_chunk):
        used = min(per_chunk, blocks - start)
        part = slice(start * size, (start + used) * size)
        tables = [channel[part].reshape(used, size) for channel in channels]
        rows[start : start + used, harmonics] = _sums(terms, *tables) / size
    weighted = (lambda values: values) if weight is None else (lambda values: weight * values)
    rows[:, own_columns.start] = 1.0 if weight is None else block_means(weight, size)
    for place, values in enumerate(own, own_columns.start + 1):
        rows[:, place] = block_means(weighted(values), size)
        del values  # before the next column is computed, which is as long
    rows[:, -1] = block_means(weighted(error), size)
    if weight is not None:
        share = rows[:, own_columns.start].copy()
        rows /= np.sqrt(np.where(share > 0, share, 1.0))[:, None]
    return rows


def block_means(channel: Samples, size: int) -> Float[np.ndarray, " blocks"]:
    """Return the mean of every `size` samples, without an incomplete last block."""
    blocks = len(channel) // size
    return channel[: blocks * size].reshape(blocks, size).mean(axis=1)


def _sums(
    terms: Sequence[AnyTerm],
    driving: Float[np.ndarray, "rows size"],
    driven: Float[np.ndarray, "rows size"],
    weight: Float[np.ndarray, "rows size"] | None = None,
) -> Float[np.ndarray, "rows columns"]:
    """Return the sums of `harmonic_sums`, with NumPy; a table has one row for every block.

    NumPy forms high orders as products of lower ones and compiles nothing.
    """
    axis = 1 if driving.shape[1] >= _SHORT else 0
    shape = driving.shape if axis else driving.shape[::-1]
    first, second = (Waves((x if axis else x.T).ravel()) for x in (driving, driven))
    share = None if weight is None else (weight if axis else weight.T).ravel()
    found = np.empty((len(driving), len(terms)), np.complex128)
    for place, term in enumerate(terms):
        wave = product(first, second, term)
        wave = wave if share is None else wave * share
        found[:, place] = wave.reshape(shape).sum(axis=axis)
    return found.view(np.float64)


def without_turns(angle: Float[Numbers, "*shape"], orders: Float[Numbers, "terms 2"]):
    """Return an angle (rad) minus its whole turns, so that its multiples keep all digits.

    If one of the orders is fractional, the angle is returned unchanged, because whole turns change
    the phase of this order.
    """
    xp = namespace(angle, orders)
    whole = xp.all(orders == xp.round(orders))
    return angle - xp.where(whole, REV * xp.round(angle / REV), 0.0)


def harmonic_sums(
    orders: Float[Numbers, "terms 2"],
    size: int | Int[Array, ""],
    driving: Float[Array, "height rows"],
    driven: Float[Array, "height rows"],
    weight: Float[Array, "height rows"] | None = None,
) -> Float[Array, "columns rows"]:
    """Return the sums of cosine and sine of every term over the first `size` rows of the tables.

    A table has one column per block, and the phase of a term (n₁, n₂) is n₁ φ₁ + n₂ φ₂. In the
    result the cosine and the sine of a term are adjacent rows. The loop over the samples of a block
    keeps the sums of all terms in cache and the blocks in vector lanes. Reductions of XLA would
    take 1.5 times as long to run and three times as long to compile. Reverse-mode differentiation
    requires that `size` is a Python integer.
    """
    orders = jnp.asarray(orders)
    driving, driven = (without_turns(angle, orders) for angle in (driving, driven))

    def add(index, sums):
        phase = orders[:, :1] * driving[index][None] + orders[:, 1:] * driven[index][None]
        sine, cosine = sincos(phase)
        if weight is not None:
            sine, cosine = weight[index][None] * sine, weight[index][None] * cosine
        return sums[0] + cosine, sums[1] + sine

    zero = jnp.zeros((orders.shape[0], driving.shape[1]))
    sums = jax.lax.fori_loop(0, size, add, (zero, zero))
    return jnp.stack(sums, axis=1).reshape(-1, driving.shape[1])


chunk_sums = jax.jit(harmonic_sums)
"""`harmonic_sums` as a program of its own."""
