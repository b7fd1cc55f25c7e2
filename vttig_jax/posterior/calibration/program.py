"""Compiled programs of a scenario: one draws and compresses a few rigs, another fits many."""

import zlib
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, Key, PRNGKeyArray

from ...base.units import ARCSEC, DEG
from ...identify.model.column_layout import ColumnLayout
from ...identify.model.forward_model import PairRelation
from .batched_fit import Fitted, fit_compressed
from .compressed import Compressed, compress
from .rigs import Readings, Rig, Sizes, draw_rig, encoder_readings, missing_amplitude, truth_of
from .scenarios import Scenario, columns_of, driving_angles, relation_of, row_size, terms_of

_SAMPLES_AT_ONCE = 1_500_000
"""Number of samples that one compiled call simulates (chosen): about one second, because Ctrl-C
takes effect only between calls."""

_RIGS_AT_ONCE = 128
"""Number of rigs that one compiled call fits (chosen)."""


class Batch(NamedTuple):
    """Rigs, their true parameters, their compressed logs and their fits, along a leading axis."""

    rigs: Rig
    truth: Float[np.ndarray, "rigs p"]
    logs: Compressed
    fitted: Fitted


@dataclass(frozen=True, eq=False)
class Program:
    """Simulation and fit of the rigs of one scenario, with the quantities that all rigs share."""

    scenario: Scenario

    @cached_property
    def columns(self) -> ColumnLayout:
        """Column layout of the rows."""
        return columns_of(terms_of(self.scenario))

    @cached_property
    def relation(self) -> PairRelation:
        """Forward model, which computes the tied coefficients from the parameters."""
        return relation_of(self.scenario)

    @cached_property
    def size(self) -> int:
        """Samples per row."""
        return row_size(self.scenario)

    @property
    def rows(self) -> int:
        """Rows per flank."""
        return self.scenario.samples // self.size

    @cached_property
    def motion(self) -> Float[np.ndarray, "flanks n"]:
        """True driving angles, rad."""
        return driving_angles(self.scenario)

    @cached_property
    def sizes(self) -> Sizes:
        """Sizes of noise, encoder errors and the omitted order."""
        s = self.scenario
        memory = s.rate_hz * s.correlation_s
        correlation = np.exp(-1 / memory) if memory > 0 else 0.0
        numbers = s.noise_std_deg * DEG, correlation, s.encoder_arcsec * ARCSEC
        return Sizes(*(jnp.asarray(float(x)) for x in (*numbers, missing_amplitude(s))))

    def keys(self, seed: int, rigs: Int[np.ndarray, " n"]) -> Key[Array, " n"]:
        """Return the random keys of the rigs with the numbers `rigs`.

        The keys also depend on the case, so that the rigs of two cases are independent.
        """
        case = zlib.crc32(self.scenario.case.encode())
        base = jax.random.fold_in(jax.random.key(seed), np.uint32(case))
        return jax.vmap(partial(jax.random.fold_in, base))(jnp.asarray(rigs))

    def simulated(self, key: PRNGKeyArray) -> tuple[Rig, Readings]:
        """Return one random rig and its encoder readings."""
        return _compiled_simulation(key, self.scenario, self.sizes, jnp.asarray(self.motion))

    def batches(self, rigs: int, seed: int) -> Iterator[Batch | int]:
        """Draw and fit `rigs` rigs in batches.

        Yield the number of rigs after each draw (for the progress), and then the fitted batch.
        """
        # The number per draw is a power of two, which divides the number of rigs in a batch.
        most = min(_RIGS_AT_ONCE, max(1, _SAMPLES_AT_ONCE // self.motion.size))
        per_call, per_batch = 1 << (most.bit_length() - 1), _RIGS_AT_ONCE
        fit = _fitting(self)
        for start in range(0, rigs, per_batch):
            parts = []
            for low in range(start, min(start + per_batch, rigs), per_call):
                keys = self.keys(seed, np.arange(low, low + per_call))
                parts.append(jax.block_until_ready(_draw_batch(self, keys)))
                yield min(low + per_call, rigs) - low
            yield _fit_batch(parts, fit, per_batch, min(per_batch, rigs - start))


def _fit_batch(parts: list, fit, per_batch: int, wanted: int) -> Batch:
    """Fit the drawn rigs, and return the first `wanted` of them.

    They are padded to `per_batch` rigs, so that `fit` is compiled for one shape only.
    """
    joined = jax.tree.map(lambda *array: np.concatenate([np.asarray(p) for p in array]), *parts)
    count = len(joined[1])
    padded = jax.tree.map(
        lambda array: np.concatenate([array, np.repeat(array[-1:], per_batch - count, axis=0)]),
        joined,
    )
    fitted = jax.tree.map(np.asarray, fit(padded[2]))
    return Batch(*jax.tree.map(lambda array: array[:wanted], (*joined, fitted)))


def _simulated(
    key: PRNGKeyArray, scenario: Scenario, sizes: Sizes, motion: Float[Array, "flanks n"]
) -> tuple[Rig, Readings]:
    rig_key, noise_key = jax.random.split(key)
    rig = draw_rig(rig_key, scenario, sizes)
    return rig, encoder_readings(rig, noise_key, scenario, sizes, motion)


_compiled_simulation = jax.jit(_simulated, static_argnums=1)


def _draw_batch(
    program: Program, keys: Key[Array, " n"]
) -> tuple[Rig, Float[Array, "rigs p"], Compressed]:
    # These fields are constant here, so that a change of them does not cause a new compilation:
    # the computation does not use them, or takes them from `Sizes`.
    shape = replace(
        program.scenario,
        name="",
        words="",
        holds=True,
        noise_std_deg=0.0,
        correlation_s=0.0,
        encoder_arcsec=0.0,
        missing=float(program.scenario.missing > 0),
    )
    motion, names = jnp.asarray(program.motion), program.relation.names
    return _compiled_draw(
        keys,
        motion=motion,
        sizes=program.sizes,
        scenario=shape,
        columns=program.columns,
        size=program.size,
        names=names,
    )


@partial(jax.jit, static_argnums=(3, 4, 5, 6))
def _compiled_draw(keys, motion, sizes, scenario, columns, size, names):
    ratio = float(scenario.pair.ratio)

    def draw(key):
        rig, readings = _simulated(key, scenario, sizes, motion)
        return rig, truth_of(rig, names), compress(readings, columns, size, ratio)

    return jax.lax.map(draw, keys)


@eqx.filter_jit
def _compiled_fit(
    logs: Compressed, relation: PairRelation, free: int, rows: Array, size: Array
) -> Fitted:
    return jax.vmap(lambda log: fit_compressed(log, relation, free, rows, size))(logs)


def _fitting(program: Program):
    free = program.columns.free_width
    rows, size = jnp.asarray(program.rows), jnp.asarray(program.size)
    return lambda logs: _compiled_fit(logs, program.relation, free, rows, size)
