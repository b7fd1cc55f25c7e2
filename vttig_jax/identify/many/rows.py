"""Block rows of one log inside a compiled program, equal to those of `compress.block_rows`."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ...base.arrays import Numbers
from ...base.units import DEG, REV
from ..compress.block_means import harmonic_sums
from .batch_model import BatchModel
from .log_arrays import LogArrays


class BlockTable(NamedTuple):
    """Block rows of one log, in arrays of a fixed size; unused rows of a run are zero.

    **Arguments**
    - `rows`: rows of every flank and run, with the columns [free | offset, drift | tied | y].
    - `counts`: number of rows of every run. - `level`: angle that was subtracted from y, rad.
    - `is_finite`: whether all samples of the log are finite.
    - `fits`: whether the arrays of the program are large enough for all runs, rows and samples.
    """

    rows: Float[Array, "flanks runs n q"]
    counts: Int[Array, "flanks runs"]
    level: Float[Array, ""]
    is_finite: Bool[Array, ""]
    fits: Bool[Array, ""]


class _Samples(NamedTuple):
    """Finite samples: time scaled to −1 … 1, shaft angles and transmission error, rad."""

    time: Float[Array, " n"]
    driving: Float[Array, " n"]
    driven: Float[Array, " n"]
    error: Float[Array, " n"]


def block_table(model: BatchModel, log: LogArrays) -> BlockTable:
    """Return the block rows of a log: means of all columns over `log.size` consecutive samples."""
    shape = model.shape
    valid = jnp.arange(shape.samples) < log.length
    used = jnp.asarray(log.on_flank)[np.array(model.sides)] & valid[None]
    channels = jnp.stack([log.time, log.driving, log.driven])
    is_finite = jnp.all(jnp.isfinite(channels) | ~valid[None])
    time, driving, driven = jnp.where(valid[None] & is_finite, channels, 0.0)
    driving, driven = (_continuous(angle, valid) for angle in (driving, driven))
    if model.delayed:
        driving = shifted(time, driving, log.length, log.delay_s)
    error = driven - model.ratio * driving
    level = _level(error, jnp.any(used, axis=0))
    samples = _Samples(_scaled(time, log.length), driving, driven, error - level)
    starts, counts, fits = _runs(model, used, log.size)
    rows = _rows(model, samples, starts, counts, log.size)
    return BlockTable(rows, counts, level, is_finite, fits)


def _continuous(angle: Float[Array, " n"], valid: Bool[Array, " n"]) -> Float[Array, " n"]:
    """Return an angle (rad) unwrapped, so that neighbours differ by at most half a turn."""
    jumps = jnp.where(valid[1:], jnp.round(jnp.diff(angle) / REV), 0.0)
    return angle - REV * jnp.concatenate([jnp.zeros(1), jnp.cumsum(jumps)])


def shifted(
    time: Float[Array, " n"],
    angle: Float[Array, " n"],
    length: Int[Numbers, ""],
    delay_s: Float[Numbers, ""],
) -> Float[Array, " n"]:
    """Return the driving angle φ₁ at the times t − `delay_s`, rad, by cubic interpolation.

    The interpolation is that of `compress.regressors`: its slopes at the samples are those of
    `numpy.gradient`. Samples from the index `length` on are padding.
    """
    last = jnp.maximum(length - 1, 1)
    step = jnp.diff(time)
    step = jnp.where(step > 0, step, 1.0)
    rise = jnp.diff(angle) / step
    before, after = step[:-1], step[1:]
    middle = (before * rise[1:] + after * rise[:-1]) / (before + after)
    slope = jnp.concatenate([rise[:1], middle, rise[-1:]])
    slope = jnp.where(jnp.arange(len(angle)) == last, rise[last - 1], slope)
    at = jnp.clip(time - delay_s, time[0], time[last])
    place = jnp.clip(jnp.searchsorted(time, at, side="right") - 1, 0, last - 1)
    width = step[place]
    part = (at - time[place]) / width
    rest = 1 - part
    ends = rest**2 * (1 + 2 * part) * angle[place] + part**2 * (1 + 2 * rest) * angle[place + 1]
    bend = rest * slope[place] - part * slope[place + 1]
    return ends + width * part * rest * bend


def _level(error: Float[Array, " n"], used: Bool[Array, " n"]) -> Float[Array, ""]:
    """Return the mean of the used samples in rad, rounded to a whole number of degrees."""
    count = jnp.maximum(jnp.sum(used), 1)
    return jnp.round(jnp.sum(jnp.where(used, error, 0.0)) / count / DEG) * DEG


def _scaled(time: Float[Array, " n"], length: Int[Numbers, ""]) -> Float[Array, " n"]:
    """Return the time scaled to −1 … 1 over the log."""
    last = time[jnp.maximum(length - 1, 0)]
    half = (last - time[0]) / 2
    return (time - (time[0] + last) / 2) / jnp.where(half > 0, half, 1.0)


def _runs(
    model: BatchModel, used: Bool[Array, "flanks n"], size: Int[Numbers, ""]
) -> tuple[Int[Array, "flanks runs"], Int[Array, "flanks runs"], Bool[Array, ""]]:
    """Find the runs of every flank, that is, the sequences of consecutive samples on this flank.

    `used` marks the samples on each flank, and `size` is the number of samples of one row. The
    arrays of the compiled program have fixed sizes, `model.shape`: at most `runs` runs per flank,
    `rows` rows per run and `height` samples per row.

    **Returns** the index of the first sample of every run, its number of complete rows (limited to
    the size of the array; 0 where there is no run), and True if all runs, rows and samples fit in
    the arrays.
    """
    shape = model.shape
    wide = jnp.pad(used, ((0, 0), (1, 1)))
    first, last = wide[:, 1:-1] & ~wide[:, :-2], wide[:, 1:-1] & ~wide[:, 2:]
    place = jnp.arange(used.shape[1])[None]

    def next_run(before, _):
        found = [jnp.argmax(edges & (place > before[:, None]), axis=1) for edges in (first, last)]
        return found[1], (found[0], found[1])

    none = jnp.full(used.shape[0], -1)
    _, (starts, stops) = jax.lax.scan(next_run, none, None, length=shape.runs)
    starts, stops = starts.T, stops.T
    found = jnp.sum(first, axis=1)
    there = jnp.arange(shape.runs)[None] < found[:, None]
    size = jnp.maximum(size, 1)
    counts = jnp.where(there, (stops + 1 - starts) // size, 0)
    room = jnp.all(found <= shape.runs) & jnp.all(counts <= shape.rows) & (size <= shape.height)
    return starts, jnp.minimum(counts, shape.rows), room


def _rows(
    model: BatchModel,
    samples: _Samples,
    starts: Int[Array, "flanks runs"],
    counts: Int[Array, "flanks runs"],
    size: Int[Numbers, ""],
) -> Float[Array, "flanks runs n q"]:
    shape, size = model.shape, jnp.clip(size, 1, model.shape.height)
    block = np.arange(shape.rows)[None, None, None]
    inside = np.arange(shape.height)[:, None, None, None]
    index = starts[None, :, :, None] + block * size + inside
    mask = (inside < size) & (block < counts[None, :, :, None])
    cells = (shape.height, starts.size * shape.rows)
    index = jnp.minimum(index, shape.samples - 1).reshape(cells)
    weight = jnp.asarray(mask).reshape(cells).astype(float)
    time, driving, driven, error = (channel[index] for channel in samples)
    sums = harmonic_sums(model.orders, shape.height, driving, driven, weight)
    own = [weight * time**power for power in range(model.drift + 1)]
    own = [jnp.sum(values, axis=0)[None] for values in own]
    y = jnp.sum(weight * error, axis=0)[None]
    columns = jnp.concatenate([sums[: model.free], *own, sums[model.free :], y]) / size
    return columns.T.reshape(*starts.shape, shape.rows, model.width)
