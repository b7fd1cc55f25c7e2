"""The paper's controller (Fig. 7): closes on deceleration, opens again on acceleration."""

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from ...base.arrays import Number, float64
from ..plants.flank_bounds import Bounds
from .controller import Controller, Measurement


class Latch(NamedTuple):
    """Whether the gap is to be closed, and by how much: mm."""

    closing: Bool[Array, ""]
    shift: Float[Array, ""]


class AccelerationController(Controller):
    """Closes by the backlash at the angle where the deceleration was judged.

        s = j(φ₁)/(tan β_L/R₂ + tan β_R/R₂) − margin                                   (16)

    The driving shaft decelerates where its estimated acceleration against the sense of its motion
    exceeds the threshold; it accelerates where the same holds in that sense, and the gap is opened
    again. Below the least speed the sense of motion is not known and nothing is judged anew.

    **Arguments**
    - `bounds`: the map the controller believes.
    - `threshold`: rad/s². - `least_speed`: rad/s. - `margin`: mm.
    """

    bounds: Bounds
    threshold: Float[Number, ""] = eqx.field(converter=float64)
    least_speed: Float[Number, ""] = eqx.field(converter=float64)
    margin: Float[Number, ""] = eqx.field(converter=float64)

    def start(self) -> Latch:
        """Open."""
        return Latch(jnp.zeros((), bool), jnp.zeros(()))

    def step(self, state: Latch, seen: Measurement) -> tuple[Latch, Float[Array, ""]]:
        """Judge one period."""
        moving = jnp.abs(seen.speed) > self.least_speed
        along = jnp.sign(seen.speed) * seen.acceleration
        slows, gains = moving & (along < -self.threshold), moving & (along > self.threshold)
        closing = slows | (state.closing & ~gains)
        asked = self.bounds.gap(seen.driving) * (1.0 / self.bounds.closing_sum) - self.margin
        shift = jnp.where(closing & ~state.closing, jnp.maximum(asked, 0.0), state.shift)
        return Latch(closing, shift), jnp.where(closing, shift, 0.0)
