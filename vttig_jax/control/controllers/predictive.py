"""Controller that closes the gap before the shaft stops, with a predicted stopping angle."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from ...base.units import REV
from ...kinematics.flank_table import FlankTable
from ..fields import Quantity, positive
from .acceleration import LEAST_RPM, MARGIN_MM
from .controller import Controller, Measurement
from .smooth import exceeds

_LONGEST_STOP = 4.0
"""Stopping time, in multiples of the horizon, up to which the stopping angle is exact.

Without smoothing no longer time counts. A chosen value."""
_TINY = 1e-9
"""Fraction of the least speed that is added to the speed to avoid 0/0 at rest; a chosen value."""


class Predictive(Controller):
    """Controller that closes before the shaft stops, by the smallest gap on its path.

    With speed ω and deceleration a the shaft stops after the time ω/a at the angle φ₁ + ω²/2a.
    While ω/a is shorter than the horizon, and while the shaft stands, the commanded displacement is

        s = min{ j(φ₁), j(φ₁ + ω·delay), j(φ₁ + ω²/2a), j(φ₁ + x_k) + d(w_k) } − margin

    with j as the displacement that closes this gap, j/(tan β_L/R₂ + tan β_R/R₂); otherwise s = 0.
    In the fourth term x_k = ω (delay + w_k), up to the stop, are points of the next tooth pitch,
    and d(w) is the distance that the actuator can rise and return in the time w (`Retreat`): gaps
    between teeth that pass faster than the actuator can follow stay open, and those that it can
    follow close. The displacement is computed anew in every period and never exceeds the one that
    closes the present gap j(φ₁). The gap is therefore not closed too far if the stop comes late or
    early or is cancelled. It opens again when the shaft no longer brakes.

    Below `least_rpm` the shaft counts as standing. The comparisons "it has moved, and it stands or
    is about to stop" are factors 0 or 1, which `width` smooths; see `exceeds`. The width of the
    comparison of ω with a·horizon is relative to ω plus the least speed.
    """

    least_rpm: Quantity = LEAST_RPM()
    horizon_s: Quantity = positive(0.3, "predictive: closes if the shaft will stop within it", "s")
    margin_mm: Quantity = MARGIN_MM()
    width: Quantity | None = None

    def start(self) -> Float[Array, ""]:
        """Return the state before any motion, in which the gap stays open: 0, it has not moved."""
        return jnp.zeros(())

    def step(
        self, state: Float[Array, ""], seen: Measurement
    ) -> tuple[Float[Array, ""], Float[Array, ""]]:
        """Return the state after one controller period and the commanded displacement, mm."""
        speed, least_speed = jnp.abs(seen.speed), self.least_rpm * REV / 60.0
        stands = exceeds(least_speed, speed, least_speed, self.width)
        moved = jnp.maximum(state, 1 - stands)
        deceleration = -jnp.sign(seen.speed) * seen.acceleration
        stops = exceeds(self.horizon_s * deceleration, speed, speed + least_speed, self.width)
        least = (speed + _TINY * least_speed) / (_LONGEST_STOP * self.horizon_s)
        stop_angle = stops * 0.5 * seen.speed * speed / jnp.maximum(deceleration, least)
        steps = (jnp.zeros(()), seen.speed * seen.delay, stop_angle)
        gaps = [seen.map.gap(seen.driving + step) for step in steps]
        smallest = jnp.minimum(jnp.minimum(gaps[0], gaps[1]), gaps[2])
        passing = self._passing(seen, jnp.abs(stop_angle), seen.map.closed_at(smallest))
        shift = jnp.maximum(passing - self.margin_mm, 0.0)
        return moved, moved * (1 - (1 - stands) * (1 - stops)) * shift

    def _passing(
        self, seen: Measurement, far: Float[Array, ""], least: Float[Array, ""]
    ) -> Float[Array, ""]:
        """Return `least`, or less (mm) where teeth pass up to an angle `far` (rad)."""
        retreat, table = seen.retreat, seen.map
        if retreat is None or not isinstance(table, FlankTable):
            return least
        pause = retreat.pause(jnp.maximum(jnp.abs(seen.speed), self.least_rpm * REV / 60.0))

        def lower(number: Int[Array, ""], least: Float[Array, ""]) -> Float[Array, ""]:
            step = jnp.clip(seen.speed * (seen.delay + number * pause), -far, far)
            gap = table.gap_among(retreat.gaps, seen.driving + step)
            closed = table.closed_at(gap)
            return jnp.minimum(least, closed + retreat.distance(number * pause))

        # A loop is compiled to less than two thirds of the time of its unrolled steps.
        return jax.lax.fori_loop(1, retreat.points + 1, lower, least)
