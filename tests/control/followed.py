"""A plant alone, followed through a motion: no controller, no actuator, no encoders."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from benchmarks.compiler import fast_to_compile
from vttig_jax.control.motion.motion import Motion
from vttig_jax.control.plants.plant import ContactEvent, Plant, Shafts, Slide
from vttig_jax.kinematics.flank_table import Bounds, FirstOrderBounds, Flanks


class Still(NamedTuple):
    """Walls that do not move: TE of flank A and B, rad."""

    lower: float
    upper: float

    def bounds(self) -> Bounds:
        """As harmonics of size zero, of a pair with ratio 1."""
        zero = np.zeros((2, 2))
        return FirstOrderBounds(1.0, np.array([self.lower, self.upper]), zero, zero, np.ones(2))


TOGETHER = 250
"""Steps of one call of the compiled program, so that it serves runs of every length."""

OPEN = Slide(*[jnp.zeros(())] * 4)


def shafts_at(
    motion: Motion, bounds: Bounds, time: float, offset: float, drift: float, side: float
) -> Shafts:
    """Both shafts at a time in s, with x in rad and its rate."""
    point = motion.at(jnp.asarray(time))
    flanks: Flanks = bounds.at(point.angle)
    x, rate, carries = (jnp.asarray(value) for value in (offset, drift, side))
    return Shafts(point.angle, point.speed, x, rate, carries, flanks)


def follow(
    plant: Plant,
    motion: Motion,
    bounds: Bounds,
    start: Shafts,
    begin: float,
    step: float,
    steps: int,
    every: int = 1,
) -> tuple[Shafts, ContactEvent]:
    """Shafts after every so many steps, and the touches of all steps."""
    now, fixed = _strong(start), (jnp.asarray(begin, float), jnp.asarray(step, float))
    parts = []
    for done in range(0, steps, TOGETHER):
        now, part = _followed(plant, motion, bounds, now, *fixed, jnp.asarray(done))
        parts.append(jax.tree.map(np.asarray, part))
    shafts, touches = jax.tree.map(lambda *leaves: np.concatenate(leaves)[:steps], *parts)
    return jax.tree.map(lambda values: values[every - 1 :: every], shafts), touches


def _strong(tree: Shafts) -> Shafts:
    """The same numbers with types that do not depend on how they were made."""
    return jax.tree.map(lambda leaf: jnp.asarray(leaf, jnp.result_type(leaf)), tree)


@eqx.filter_jit(**fast_to_compile())
def _followed(plant, motion, bounds, start, begin, step, done):
    def one(shafts: Shafts, number):
        ended = plant.step(shafts, motion.at(begin + (number + 1) * step), OPEN, bounds, step)
        return ended[0], ended

    return jax.lax.scan(one, start, done + jnp.arange(TOGETHER))
