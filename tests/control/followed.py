"""A plant alone, followed through a motion: no controller, no actuator, no encoders."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from vttig_jax.control.motion.motion import Motion
from vttig_jax.control.plants.flank_bounds import Bounds, Flanks
from vttig_jax.control.plants.plant import ContactEvent, Plant, Shafts, Slide


class Still(NamedTuple):
    """Walls that do not move: TE of flank A and B, rad."""

    lower: float
    upper: float

    def bounds(self) -> Bounds:
        """As harmonics of size zero, of a pair with ratio 1."""
        zero = np.zeros((2, 1))
        return Bounds(1.0, np.array([self.lower, self.upper]), zero, zero, np.ones(2), ((1, 0),))


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
    shafts, touches = _followed(
        plant, motion, bounds, start, jnp.asarray(begin), jnp.asarray(step), steps
    )
    picked = jax.tree.map(lambda values: np.asarray(values)[every - 1 :: every], shafts)
    return picked, jax.tree.map(np.asarray, touches)


@eqx.filter_jit
def _followed(plant, motion, bounds, start, begin, step, steps):
    def one(shafts: Shafts, number):
        ended = plant.step(shafts, motion.at(begin + (number + 1) * step), OPEN, bounds, step)
        return ended[0], ended

    return jax.lax.scan(one, start, jnp.arange(steps))[1]
