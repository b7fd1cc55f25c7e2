"""Controller that closes the gap before the shaft stops, with a predicted stopping angle."""

from functools import reduce

import jax.numpy as jnp
from jaxtyping import Array, Float

from ...base.units import REV
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

        s = min{ j(φ₁), j(φ₁ + ω·delay), j(φ₁ + ω²/2a), r(φ₁, ω) } − margin

    with j as the displacement that closes this gap, j/(tan β_L/R₂ + tan β_R/R₂); otherwise s = 0.
    r is only there for maps with waves as short as the teeth: the displacement from which the
    actuator can open the gap again before the teeth of the next pitch are there (`Retreat`). Gaps
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
        steps = (stop_angle, jnp.zeros(()), seen.speed * seen.delay)
        if seen.retreat is not None:  # which holds the other two terms
            steps = steps[:1]
        gaps = [seen.map.gap(seen.driving + step) for step in steps]
        closed = seen.map.closed_at(reduce(jnp.minimum, gaps))
        if seen.retreat is not None:
            closed = jnp.minimum(closed, seen.retreat.at(seen.driving, seen.speed))
        shift = jnp.maximum(closed - self.margin_mm, 0.0)
        return moved, moved * (1 - (1 - stands) * (1 - stops)) * shift
