"""Controller of the paper (Fig. 7), which closes on deceleration and opens on acceleration."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from ...base.arrays import Number, float64
from ..plants.flank_bounds import Bounds
from .controller import Controller, Measurement


class Latch(eqx.Module):
    """State: whether the controller closes the gap, and the stored displacement in mm."""

    closing: Bool[Array, ""]
    shift: Float[Array, ""]


class AccelerationController(Controller):
    """Controller that closes the gap by the backlash at the angle where it detects the braking.

        s = j(φ₁)/(tan β_L/R₂ + tan β_R/R₂) − margin                                   (16)

    The driving shaft decelerates while its estimated acceleration exceeds the threshold against the
    direction of motion. It accelerates while the threshold is exceeded in the direction of motion;
    then the gap opens again. Below `least_speed` the direction is not known, and the state stays.

    **Arguments**
    - `bounds`: flanks of the map that the controller uses. - `threshold`: acceleration, rad/s².
    - `least_speed`: speed, rad/s. - `margin`: displacement that stays open, mm.
    """

    bounds: Bounds
    threshold: Float[Number, ""] = eqx.field(converter=float64)
    least_speed: Float[Number, ""] = eqx.field(converter=float64)
    margin: Float[Number, ""] = eqx.field(converter=float64)

    def start(self) -> Latch:
        """Return the state of an open gap."""
        return Latch(jnp.zeros((), bool), jnp.zeros(()))

    def step(self, state: Latch, seen: Measurement) -> tuple[Latch, Float[Array, ""]]:
        """Return the state after one period and the commanded displacement in mm."""
        moving = jnp.abs(seen.speed) > self.least_speed
        forward = jnp.sign(seen.speed) * seen.acceleration
        decelerates = moving & (forward < -self.threshold)
        closing = decelerates | (state.closing & ~(moving & (forward > self.threshold)))
        target = self.bounds.gap(seen.driving) * (1.0 / self.bounds.closing_sum) - self.margin
        shift = jnp.where(closing & ~state.closing, jnp.maximum(target, 0.0), state.shift)
        return Latch(closing, shift), jnp.where(closing, shift, 0.0)
