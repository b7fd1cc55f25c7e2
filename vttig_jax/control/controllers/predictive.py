"""Controller that closes the gap before the shaft stops, with a predicted stopping angle."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from ...base.arrays import Number, float64
from ...kinematics.flank_table import Bounds
from .controller import Controller, Measurement


class PredictiveState(eqx.Module):
    """State: whether the shaft has moved since the run began."""

    moved: Bool[Array, ""]


class Retreat(eqx.Module):
    """How far the actuator can open the gap again while teeth pass.

    A tooth pitch of the map is looked at, or less if the actuator needs less time for its swing.

    **Arguments**
    - `speed`, `acceleration`: limits of the actuator, mm/s and mm/s². - `pitch`: tooth pitch, rad.
    - `swing`: largest change of the closing displacement within a pitch, mm.
    - `points`: number of points at which the gap is looked at.
    """

    speed: Float[Number, ""] = eqx.field(converter=float64)
    acceleration: Float[Number, ""] = eqx.field(converter=float64)
    pitch: Float[Number, ""] = eqx.field(converter=float64)
    swing: Float[Number, ""] = eqx.field(converter=float64)
    points: int = eqx.field(static=True)

    def pause(self, speed: Float[Array, ""]) -> Float[Array, ""]:
        """Return the time between two points, s, for a driving speed (rad/s)."""
        v, a, swing = map(jnp.asarray, (self.speed, self.acceleration, self.swing))
        move = jnp.where(swing < v**2 / a, 2 * jnp.sqrt(swing / a), v / a + swing / v)
        return jnp.minimum(self.pitch / speed, 2 * move) / self.points

    def distance(self, time: Float[Array, ""]) -> Float[Array, ""]:
        """Return by how far the actuator can move and be back after a time (s), mm.

        Both ways go from standstill to standstill, each in half of the time.
        """
        v, a, half = jnp.asarray(self.speed), jnp.asarray(self.acceleration), 0.5 * time
        return jnp.where(half < 2 * v / a, 0.25 * a * half**2, v * (half - v / a))


class PredictiveController(Controller):
    """Controller that closes before the shaft stops, by the smallest gap on its path.

    With speed ω and deceleration a the shaft stops after the time ω/a at the angle φ₁ + ω²/2a.
    While ω/a is shorter than the horizon, and while the shaft stands, the commanded displacement is

        s = min{ j(φ₁), j(φ₁ + ω·lead), j(φ₁ + ω²/2a), j(φ₁ + x_k) + d(w_k) } − margin

    with j as the displacement that closes this gap, j/(tan β_L/R₂ + tan β_R/R₂); otherwise s = 0.
    In the fourth term x_k = ω (lead + w_k), up to the stop, are points of the next tooth pitch, and
    d(w) is the distance that the actuator can rise and return in the time w: gaps between teeth
    that pass faster than the actuator can follow stay open, and those that it can follow close. The
    displacement is computed anew in every period and never exceeds the one that closes the
    present gap j(φ₁). The gap is therefore not closed too far if the stop comes late or early or is
    cancelled. It opens again when the shaft no longer brakes.

    **Arguments**
    - `bounds`: flanks of the backlash map that the controller uses.
    - `horizon`: longest time before the predicted stop at which the gap closes, s.
    - `least_speed`: speed below which the shaft counts as standing, rad/s.
    - `margin`: displacement by which the gap stays open, mm. - `lead`: delay of the actuator, s.
    - `retreat`: how the actuator follows teeth that pass; None for a map without such short waves.
    """

    bounds: Bounds
    horizon: Float[Number, ""] = eqx.field(converter=float64)
    least_speed: Float[Number, ""] = eqx.field(converter=float64)
    margin: Float[Number, ""] = eqx.field(converter=float64)
    lead: Float[Number, ""] = eqx.field(converter=float64)
    retreat: Retreat | None = None

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
        shift = self.shift(seen, jnp.where(stops, braking, jnp.zeros(())))
        return PredictiveState(moved), jnp.where(moved & (stands | stops), shift, 0.0)

    def shift(self, seen: Measurement, stop: Float[Array, ""]) -> Float[Array, ""]:
        """Return the displacement s, mm, for a shaft that stops after a further angle (rad)."""
        retreat, far = self.retreat, jnp.abs(stop)
        steps = (jnp.zeros(()), seen.speed * self.lead, stop)
        gaps = [self.bounds.gap(seen.driving + step) for step in steps]
        least = self.bounds.closed_at(jnp.minimum(jnp.minimum(gaps[0], gaps[1]), gaps[2]))
        if retreat is not None:
            pause = retreat.pause(jnp.maximum(jnp.abs(seen.speed), self.least_speed))

            def lower(number: Int[Array, ""], least: Float[Array, ""]) -> Float[Array, ""]:
                step = jnp.clip(seen.speed * (self.lead + number * pause), -far, far)
                closed = self.bounds.closed_at(self.bounds.gap(seen.driving + step))
                return jnp.minimum(least, closed + retreat.distance(number * pause))

            # A loop is compiled to less than two thirds of the time of its unrolled steps.
            least = jax.lax.fori_loop(1, retreat.points + 1, lower, least)
        return jnp.maximum(least - self.margin, 0.0)
