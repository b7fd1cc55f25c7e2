"""Controller of the paper (Fig. 7): it closes the gap on deceleration, opens it on acceleration."""

from functools import partial

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from ...base.units import REV
from ..fields import Quantity, number, positive
from .controller import Controller, Measurement
from .smooth import exceeds

LEAST_RPM = partial(
    positive, 3.0, "below it: acceleration keeps its state, predictive closes", "rpm"
)
MARGIN_MM = partial(
    number, 0.01, "part of the closing shift that is not commanded", "mm", ge=-1e3, le=1e3
)


class Latch(eqx.Module):
    """State: `closing`, 1 while the gap is commanded closed and else 0, and the `shift`, mm.

    The displacement is computed once, when `closing` becomes 1, and kept until it is 0.
    """

    closing: Float[Array, ""]
    shift: Float[Array, ""]


class Acceleration(Controller):
    """Controller that closes the gap by the backlash at the angle where it detects a deceleration.

        s = j(φ₁)/(tan β_L/R₂ + tan β_R/R₂) − margin                                   (16)

    Let a be the estimated acceleration of the driving shaft in its direction of motion. The gap
    closes when a < −threshold, s is kept, and the gap opens again when a > threshold. Below
    `least_rpm` the direction of motion is not known, and the controller keeps its state. With the
    comparisons c and g for "decelerates" and "accelerates", 0 or 1, the latch w (`closing`) and the
    stored displacement become in every period

        w ← (1 − g(1 − c)) w + c (1 − w),   s ← (1 − g(1 − c)) s + c (1 − w) s₀

    where s₀ closes the gap at the present angle. `width` smooths the comparisons; see `exceeds`.
    """

    threshold_rad_s2: Quantity = positive(
        1.0, "acceleration: deceleration that counts as a reversal", "rad/s^2"
    )
    least_rpm: Quantity = LEAST_RPM()
    margin_mm: Quantity = MARGIN_MM()
    width: Quantity | None = None

    def start(self) -> Latch:
        """Return the state of an open gap."""
        return Latch(jnp.zeros(()), jnp.zeros(()))

    def step(self, state: Latch, seen: Measurement) -> tuple[Latch, Float[Array, ""]]:
        """Return the state after one controller period and the commanded displacement, mm."""
        least, threshold = self.least_rpm * REV / 60.0, self.threshold_rad_s2
        moving = exceeds(jnp.abs(seen.speed), least, least, self.width)
        forward = jnp.sign(seen.speed) * seen.acceleration
        decelerates = moving * exceeds(-forward, threshold, threshold, self.width)
        accelerates = moving * exceeds(forward, threshold, threshold, self.width)
        kept, added = 1 - accelerates * (1 - decelerates), decelerates * (1 - state.closing)
        target = seen.map.closed_at(seen.map.gap(seen.driving)) - self.margin_mm
        closing = kept * state.closing + added
        shift = kept * state.shift + added * jnp.maximum(target, 0.0)
        return Latch(closing, shift), shift
