"""Controller that closes the gap before the shaft stops, with a predicted stopping angle."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from ...base.arrays import Number, float64
from ...kinematics.flank_table import Bounds
from .controller import Controller, Measurement


class PredictiveState(eqx.Module):
    """State: whether the shaft has moved since the run began."""

    moved: Bool[Array, ""]


class PredictiveController(Controller):
    """Controller that closes before the shaft stops, by the smallest of three gaps on its path.

    With speed ω and deceleration a the shaft stops after the time ω/a at the angle φ₁ + ω²/2a.
    While ω/a is shorter than the horizon, and while the shaft stands, the commanded displacement is

        s = min{ j(φ₁), j(φ₁ + ω·lead), j(φ₁ + ω²/2a) } / (tan β_L/R₂ + tan β_R/R₂) − margin

    and otherwise s = 0. It is computed anew in every period and never exceeds the displacement
    that closes the present gap j(φ₁). The gap is therefore not closed too far if the stop comes
    late or early or is cancelled. It opens again when the shaft no longer brakes.

    **Arguments**
    - `bounds`: flanks of the backlash map that the controller uses.
    - `horizon`: longest time before the predicted stop at which the gap closes, s.
    - `least_speed`: speed below which the shaft counts as standing, rad/s.
    - `margin`: displacement by which the gap stays open, mm. - `lead`: delay of the actuator, s.
    """

    bounds: Bounds
    horizon: Float[Number, ""] = eqx.field(converter=float64)
    least_speed: Float[Number, ""] = eqx.field(converter=float64)
    margin: Float[Number, ""] = eqx.field(converter=float64)
    lead: Float[Number, ""] = eqx.field(converter=float64)

    def start(self) -> PredictiveState:
        """Return the state before any motion, in which the gap stays open."""
        return PredictiveState(jnp.zeros((), bool))

    def step(
        self, state: PredictiveState, seen: Measurement
    ) -> tuple[PredictiveState, Float[Array, ""]]:
        """Return the state after one controller period and the commanded displacement, mm."""
        speed = jnp.abs(seen.speed)
        stands = speed < self.least_speed
        deceleration = -jnp.sign(seen.speed) * seen.acceleration
        stops = (deceleration > 0) & (speed < self.horizon * deceleration)
        moved = state.moved | ~stands
        braking = 0.5 * seen.speed * speed / jnp.where(stops, deceleration, 1.0)
        stop_angle = jnp.where(stops, braking, jnp.zeros(()))
        steps = (jnp.zeros(()), seen.speed * self.lead, stop_angle)
        gaps = [self.bounds.gap(seen.driving + step) for step in steps]
        least = jnp.minimum(jnp.minimum(gaps[0], gaps[1]), gaps[2])
        shift = jnp.maximum(self.bounds.closed_at(least) - self.margin, 0.0)
        return PredictiveState(moved), jnp.where(moved & (stands | stops), shift, 0.0)
