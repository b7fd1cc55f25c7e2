"""Closes by the gap where the shaft will stop, and never beyond the gap there is."""

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from ...base.arrays import Number, float64
from ..plants.flank_bounds import Bounds
from .controller import Controller, Measurement


class Watch(NamedTuple):
    """Whether the shaft has moved since the run began."""

    moved: Bool[Array, ""]


class PredictiveController(Controller):
    """Closes where the shaft is about to stop, by the least gap on the way there.

    With speed ω and acceleration a against it the shaft stops within ω/a, at φ₁ + ω²/2a. Once that
    is less than the horizon away, and while the shaft stands,

        s = min{ j(φ₁), j(φ₁ + ω·lead), j(φ₁ + ω²/2a) } / (tan β_L/R₂ + tan β_R/R₂) − margin

    anew in every period; else s = 0. It never asks for more than the gap at the present angle, so
    that a stop that is late, early or called off closes nothing too far: a slow-down opens again as
    soon as the shaft runs steadily.

    **Arguments**
    - `bounds`: the map the controller believes.
    - `horizon`: s. - `least_speed`: rad/s below which the shaft stands. - `margin`: mm.
    - `lead`: s that the actuator follows behind its command.
    """

    bounds: Bounds
    horizon: Float[Number, ""] = eqx.field(converter=float64)
    least_speed: Float[Number, ""] = eqx.field(converter=float64)
    margin: Float[Number, ""] = eqx.field(converter=float64)
    lead: Float[Number, ""] = eqx.field(converter=float64)

    def start(self) -> Watch:
        """Not moved yet: what stands at the start is left open."""
        return Watch(jnp.zeros((), bool))

    def step(self, state: Watch, seen: Measurement) -> tuple[Watch, Float[Array, ""]]:
        """Look ahead from one period."""
        speed = jnp.abs(seen.speed)
        stands = speed < self.least_speed
        slowing = -jnp.sign(seen.speed) * seen.acceleration
        stops = (slowing > 0) & (speed < self.horizon * slowing)
        moved = state.moved | ~stands
        way = jnp.where(
            stops, 0.5 * seen.speed * speed / jnp.where(stops, slowing, 1.0), jnp.zeros(())
        )
        ahead = (jnp.zeros(()), seen.speed * self.lead, way)
        gaps = [self.bounds.gap(seen.driving + one) for one in ahead]
        least = jnp.minimum(jnp.minimum(gaps[0], gaps[1]), gaps[2])
        shift = jnp.maximum(least * (1.0 / self.bounds.closing_sum) - self.margin, 0.0)
        return Watch(moved), jnp.where(moved & (stands | stops), shift, 0.0)
