"""Averages of a log over short blocks: what a linear model of the transmission error needs to see.

A block mean of y = Xβ + ε is the mean of X times β plus the mean of ε, exactly, whatever the motion
inside the block was. So averaging the regressors themselves loses nothing but frequencies above the
block rate, shortens the log and whitens its noise.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..base.sincos import sincos
from ..base.units import REV
from ..kinematics.orders import Term

Samples = Float[np.ndarray, " n"]

_CHUNK_CELLS = 32_768
"""Terms times rows of a chunk: the sums of a chunk stay in cache."""

_MOST_ROWS = 2048


@dataclass(frozen=True)
class BlockPlan:
    """Columns of a block row: the free terms, 1, powers of time, the tied terms, and y.

    **Arguments**
    - `free`, `tied`: orders (n₁, n₂) of the harmonics, a cosine and a sine column each.
    - `drift_order`: highest power of the scaled time (0: the constant only).
    - `size`: samples in a block.
    """

    free: tuple[Term, ...]
    tied: tuple[Term, ...]
    drift_order: int
    size: int

    @property
    def width(self) -> int:
        """Number of columns, y included."""
        return 2 * len(self.free) + 2 * len(self.tied) + self.drift_order + 2

    @property
    def tied_columns(self) -> int:
        """Number of columns between the free ones and y."""
        return self.width - 2 * len(self.free) - 1


def block_size(samples_per_turn: float, highest_order: float) -> int:
    """Samples a block: four blocks a cycle of the highest order, 32 to 256 blocks a turn.

    Beyond 256 only as far as the highest order asks for it, so that no modelled order is averaged
    away.
    """
    blocks = max(min(4.0 * highest_order, 256.0), 32.0, 2.5 * highest_order)
    return max(1, int(samples_per_turn / blocks))


def block_rows(
    plan: BlockPlan,
    driving_angle: Samples,
    driven_angle: Samples,
    time: Samples,
    error: Samples,
) -> Float[np.ndarray, "blocks columns"]:
    """Block means of every column over one uninterrupted run; a last incomplete block is dropped.

    Angles in rad, `time` scaled to O(1), `error` in any unit.
    """
    blocks = len(error) // plan.size
    free = 2 * len(plan.free)
    rows = np.empty((blocks, plan.width))
    harmonics = np.delete(np.arange(plan.width - 1), slice(free, free + plan.drift_order + 1))
    orders = np.asarray(plan.free + plan.tied, np.float64).reshape(-1, 2)
    per_chunk = max(1, min(_CHUNK_CELLS // max(len(orders), 1), _MOST_ROWS))
    for start, channels in _chunks(plan.size, per_chunk, blocks, driving_angle, driven_angle):
        means = np.asarray(_chunk_means(orders, *channels)).T
        rows[start : start + per_chunk, harmonics] = means[: blocks - start]
    rows[:, free] = 1.0
    for power in range(1, plan.drift_order + 1):
        rows[:, free + power] = block_means(time**power, plan.size)
    rows[:, -1] = block_means(error, plan.size)
    return rows


def block_means(channel: Samples, size: int) -> Float[np.ndarray, " blocks"]:
    """Mean of every `size` samples; a last incomplete block is dropped."""
    blocks = len(channel) // size
    return channel[: blocks * size].reshape(blocks, size).mean(axis=1)


def _chunks(
    size: int, per_chunk: int, blocks: int, *channels: Samples
) -> Iterator[tuple[int, list[np.ndarray]]]:
    """Cut channels into (size, per_chunk) tables, the last one padded with zeros.

    A block is a column: sums over it then run in vector lanes.
    """
    for start in range(0, blocks, per_chunk):
        used = min(per_chunk, blocks - start)
        tables = []
        for channel in channels:
            table = np.zeros((size, per_chunk))
            table[:, :used] = channel[start * size : (start + used) * size].reshape(used, size).T
            tables.append(table)
        yield start, tables


@jax.jit
def _chunk_means(
    orders: Float[Array, "terms 2"],
    driving: Float[Array, "size rows"],
    driven: Float[Array, "size rows"],
) -> Float[Array, "columns rows"]:
    """Block means of cosine and sine of every term, the two of a term beside each other.

    A loop over the samples of a block keeps the sums of all terms in cache and the blocks in vector
    lanes; XLA's own reductions take half as long again and three times as long to compile.
    """
    # Whole turns go first, so that a multiple of the angle loses no digits to them.
    driving, driven = (angle - REV * jnp.round(angle / REV) for angle in (driving, driven))

    def add(index, sums):
        phase = orders[:, :1] * driving[index] + orders[:, 1:] * driven[index]
        sine, cosine = sincos(phase)
        return sums[0] + cosine, sums[1] + sine

    zero = jnp.zeros((orders.shape[0], driving.shape[1]))
    sums = jax.lax.fori_loop(0, driving.shape[0], add, (zero, zero))
    return jnp.stack(sums, axis=1).reshape(-1, driving.shape[1]) / driving.shape[0]
