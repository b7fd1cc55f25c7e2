"""Averages of a log over short blocks: what a linear model of the transmission error needs to see.

A block mean of y = Xβ + ε is the mean of X times β plus the mean of ε, whatever the motion inside
the block was. So averaging the regressors themselves loses nothing but frequencies above the block
rate, shortens the log and whitens its noise.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..base.sincos import sincos
from ..kinematics.orders import Term

Samples = Float[np.ndarray, " n"]

_CHUNK_SAMPLES = 8192

_MOMENTS = 10
"""Powers of the angle inside a block that its mean takes into account."""


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
    """Block means of cosine and sine of every term.

    With ψ the angle of a term, ψ̄ its block mean and d = ψ − ψ̄, the mean of exp(jkψ) is
    exp(jkψ̄) Σ_n (jk)ⁿ mean(dⁿ)/n!. The powers of d serve every multiple k of an angle, and the
    series ends below 1e-8 where a block is a quarter of the highest cycle.
    """
    multiples: dict[Term, list[int]] = {}
    for term in terms:
        base, multiple = _base(term)
        multiples.setdefault(base, []).append(multiple)
    found = {}
    for base, orders in multiples.items():
        angle = base[0] * driving + base[1] * driven
        middle = angle.mean(axis=0)
        moments = _moments(angle - middle)
        for order in orders:
            sine, cosine = sincos(order * middle)
            real, imaginary = _characteristic(moments, order)
            found[base, order] = (
                cosine * real - sine * imaginary,
                sine * real + cosine * imaginary,
            )
    columns = [column for term in terms for column in found[_base(term)]]
    return jnp.stack(columns, axis=1) if columns else jnp.zeros((driving.shape[1], 0))


def _base(term: Term) -> tuple[Term, int]:
    """The angle a term is a multiple of: that of one shaft, or its own."""
    first, second = term
    if second == 0:
        return (1, 0), first
    return ((0, 1), second) if first == 0 else (term, 1)


def _moments(deviation: Float[Array, "size rows"]) -> list[Float[Array, " rows"]]:
    """mean(dⁿ) for n = 2 … `_MOMENTS`."""
    moments, power = [], deviation
    for _ in range(2, _MOMENTS + 1):
        power = power * deviation
        moments.append(power.mean(axis=0))
    return moments


def _characteristic(
    moments: list[Float[Array, " rows"]], order: int
) -> tuple[Float[Array, " rows"], Float[Array, " rows"]]:
    """Real and imaginary part of Σ_n (j·order)ⁿ mean(dⁿ)/n!."""
    parts = [jnp.ones_like(moments[0]), jnp.zeros_like(moments[0])]
    for n, moment in enumerate(moments, start=2):
        sign = 1.0 if n % 4 < 2 else -1.0
        parts[n % 2] = parts[n % 2] + sign * (float(order) ** n / math.factorial(n)) * moment
    return parts[0], parts[1]
