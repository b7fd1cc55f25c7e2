"""Averages of a log over short blocks: what a linear model of the transmission error needs to see.

A block mean of y = Xβ + ε is the mean of X times β plus the mean of ε, exactly, whatever the motion
inside the block was. So averaging the regressors themselves loses nothing but frequencies above the
block rate, shortens the log and whitens its noise.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..base.sincos import sincos
from ..base.units import REV
from ..kinematics.orders import Term

Samples = Float[np.ndarray, " n"]

_CHUNK_SAMPLES = 8192


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
    per_chunk = max(1, _CHUNK_SAMPLES // plan.size)
    free = 2 * len(plan.free)
    rows = np.empty((blocks, plan.width))
    harmonics = np.delete(np.arange(plan.width - 1), slice(free, free + plan.drift_order + 1))
    terms = plan.free + plan.tied
    for start, channels in _chunks(plan.size, per_chunk, blocks, driving_angle, driven_angle):
        means = np.asarray(_chunk_means(terms, *channels))
        rows[start : start + per_chunk, harmonics] = means[: blocks - start]
    for power in range(plan.drift_order + 1):
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


@partial(jax.jit, static_argnums=0)
def _chunk_means(
    terms: tuple[Term, ...], driving: Float[Array, "size rows"], driven: Float[Array, "size rows"]
) -> Float[Array, "rows columns"]:
    """Block means of cosine and sine of every term."""
    driving_powers, driven_powers = (
        _powers(angle, {abs(term[shaft]) for term in terms})
        for shaft, angle in enumerate((driving, driven))
    )
    columns = []
    for first, second in terms:
        columns += _product(
            _signed(driving_powers[abs(first)], first), _signed(driven_powers[abs(second)], second)
        )
    if not columns:
        return jnp.zeros((driving.shape[1], 0))
    return jnp.stack([column.mean(axis=0) for column in columns], axis=1)


def _powers(angle, needed: set[int]):
    """(cos kφ, sin kφ) for the orders needed, by products of earlier ones; 0 is None."""
    turns = jnp.round(angle * (1 / REV))
    sine, cosine = sincos(angle - turns * REV)
    powers = {0: None, 1: jax.lax.optimization_barrier((cosine, sine))}

    def power(order: int):
        if order not in powers:
            half = order // 2
            product = _product(power(half), power(order - half))
            # Without the barrier XLA computes every power anew for each column that uses it.
            powers[order] = jax.lax.optimization_barrier(product)
        return powers[order]

    for order in sorted(needed):
        power(order)
    return powers


def _signed(pair, order: int):
    return pair if pair is None or order >= 0 else (pair[0], -pair[1])


def _product(first: Any, second: Any) -> Any:
    """Product of two unit phasors given as (cosine, sine); None is 1."""
    if first is None or second is None:
        return first if second is None else second
    return first[0] * second[0] - first[1] * second[1], first[0] * second[1] + first[1] * second[0]
