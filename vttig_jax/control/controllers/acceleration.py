"""Controller of the paper (Fig. 7): it closes the gap on deceleration, opens it on acceleration."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from ...base.arrays import Number, float64
from ...kinematics.flank_table import Bounds
from .controller import Controller, Measurement


class Latch(eqx.Module):
    """State: whether the gap is commanded closed (`closing`), and the displacement `shift`, mm.

    The displacement is computed once, when `closing` becomes true, and kept until it is false.
    """

    closing: Bool[Array, ""]
    shift: Float[Array, ""]


class AccelerationController(Controller):
    """Controller that closes the gap by the backlash at the angle where it detects a deceleration.

        s = j(φ₁)/(tan β_L/R₂ + tan β_R/R₂) − margin                                   (16)

    Let a be the estimated acceleration of the driving shaft in its direction of motion. The gap
    closes when a < −threshold, s is kept, and the gap opens again when a > threshold. Below
    `least_speed` the direction of motion is not known, and the controller keeps its state.

    **Arguments**
    - `bounds`: flanks of the backlash map that the controller uses.
    - `threshold`: acceleration, rad/s². - `least_speed`: driving speed, rad/s.
    - `margin`: displacement by which the gap stays open, mm.
    """

    bounds: Bounds
    threshold: Float[Number, ""] = eqx.field(converter=float64)
    least_speed: Float[Number, ""] = eqx.field(converter=float64)
    margin: Float[Number, ""] = eqx.field(converter=float64)

    def start(self) -> Latch:
        """Return the state of an open gap."""
        return Latch(jnp.zeros((), bool), jnp.zeros(()))

    def step(self, state: Latch, seen: Measurement) -> tuple[Latch, Float[Array, ""]]:
        """Return the state after one controller period and the commanded displacement, mm."""
        moving = jnp.abs(seen.speed) > self.least_speed
        forward = jnp.sign(seen.speed) * seen.acceleration
        decelerates = moving & (forward < -self.threshold)
        closing = decelerates | (state.closing & ~(moving & (forward > self.threshold)))
        target = self.bounds.closed_at(self.bounds.gap(seen.driving)) - self.margin
        shift = jnp.where(closing & ~state.closing, jnp.maximum(target, 0.0), state.shift)
        return Latch(closing, shift), jnp.where(closing, shift, 0.0)
