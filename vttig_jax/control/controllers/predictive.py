"""Controller that closes by the gap at the predicted stop, at most by the present gap."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from ...base.arrays import Number, float64
from ..plants.flank_bounds import Bounds
from .controller import Controller, Measurement


class PredictiveState(eqx.Module):
    """State: whether the shaft has moved since the run began."""

    moved: Bool[Array, ""]


class PredictiveController(Controller):
    """Controller that closes before the shaft stops, by the smallest of three gaps on its path.

    With speed ω and deceleration a the shaft stops within ω/a at φ₁ + ω²/2a. While this time is
    shorter than the horizon, and while the shaft stands, the controller commands in every period

        s = min{ j(φ₁), j(φ₁ + ω·lead), j(φ₁ + ω²/2a) } / (tan β_L/R₂ + tan β_R/R₂) − margin

    and otherwise s = 0. s never exceeds the displacement for the present gap, so that a late, early
    or cancelled stop does not close it too far; it opens again once the shaft runs steadily.

    **Arguments**
    - `bounds`: flanks of the map that the controller uses. - `horizon`: time before the stop, s.
    - `least_speed`: speed below which the shaft stands, rad/s.
    - `margin`: displacement that stays open, mm. - `lead`: delay of the actuator, s.
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
        """Return the state after one period and the commanded displacement in mm."""
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
        shift = jnp.maximum(least * (1.0 / self.bounds.closing_sum) - self.margin, 0.0)
        return PredictiveState(moved), jnp.where(moved & (stands | stops), shift, 0.0)
