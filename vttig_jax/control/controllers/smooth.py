"""Differentiable closing controllers: thresholds become a C² smoothstep for gradient-based tuning.

A comparison such as "the deceleration exceeds the threshold" jumps from 0 to 1, so that its slope
is zero wherever the slope exists. Here the comparison rises over a width w:

    step(x) = p³ (10 − 15 p + 6 p²),   p = (x/w + 1)/2 clipped to 0 … 1

x is the excess over the threshold, divided by the threshold. The step is 0 for x ≤ −w, 1 for x ≥ w
and twice differentiable. The tail of a logistic function would close the gap when it is repeated
in a thousand periods. For w → 0 both controllers become the original ones.
"""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from ...base.arrays import Number, float64
from .acceleration import AccelerationController
from .controller import Controller, Measurement
from .predictive import PredictiveController

_LONGEST_STOP = 4.0
"""Longest stopping time for which the stopping angle is exact, in horizons: a chosen value."""
_TINY = 1e-9
"""Share of `least_speed` that is added to the speed to avoid 0/0 at rest: a chosen value."""


def smooth_step(excess: Float[Array, ""], width: Float[Array, ""]) -> Float[Array, ""]:
    """Return the degree 0 … 1 to which a dimensionless excess is positive; see the module."""
    share = jnp.clip(0.5 * (excess / width + 1.0), 0.0, 1.0)
    return share**3 * (10 + share * (6 * share - 15))


class SmoothLatch(eqx.Module):
    """State: how far the latch is set, 0 … 1, and the stored displacement in mm."""

    closing: Float[Array, ""]
    shift: Float[Array, ""]


class SmoothAccelerationController(Controller):
    """`AccelerationController` with smoothed comparisons and a latch w that fills and drains.

    c and g are the degrees 0 … 1 of deceleration and acceleration, and s₀ is the displacement for
    the gap at the present angle. In every period the latch and the stored displacement become

        w ← (1 − g(1 − c)) w + c (1 − w),   s ← (1 − g(1 − c)) s + c (1 − w) s₀

    **Arguments**
    - `hard`: the original controller.
    - `width`: width of the comparisons, relative to threshold and least speed.
    """

    hard: AccelerationController
    width: Float[Number, ""] = eqx.field(converter=float64)

    def start(self) -> SmoothLatch:
        """Return the state of an open gap."""
        return SmoothLatch(jnp.zeros(()), jnp.zeros(()))

    def step(self, state: SmoothLatch, seen: Measurement) -> tuple[SmoothLatch, Float[Array, ""]]:
        """Return the state after one period and the commanded displacement in mm."""
        hard, width = self.hard, jnp.asarray(self.width)
        moving = smooth_step(jnp.abs(seen.speed) / hard.least_speed - 1, width)
        forward = jnp.sign(seen.speed) * seen.acceleration / hard.threshold
        decelerates = moving * smooth_step(-forward - 1, width)
        accelerates = moving * smooth_step(forward - 1, width)
        kept, added = 1 - accelerates * (1 - decelerates), decelerates * (1 - state.closing)
        target = hard.bounds.gap(seen.driving) / hard.bounds.closing_sum - hard.margin
        closing = kept * state.closing + added
        shift = kept * state.shift + added * jnp.maximum(target, 0.0)
        return SmoothLatch(closing, shift), shift


class SmoothPredictiveState(eqx.Module):
    """State: degree 0 … 1 to which the shaft has moved since the run began."""

    moved: Float[Array, ""]


class SmoothPredictiveController(Controller):
    """`PredictiveController` with smoothed comparisons.

    It commands the original displacement times the degree 0 … 1 to which the shaft stands or stops.

    **Arguments**
    - `hard`: the original controller.
    - `width`: width of the comparisons, relative to the least speed and, where the speed is
      compared with deceleration times horizon, to speed plus least speed.
    """

    hard: PredictiveController
    width: Float[Number, ""] = eqx.field(converter=float64)

    def start(self) -> SmoothPredictiveState:
        """Return the state before any motion."""
        return SmoothPredictiveState(jnp.zeros(()))

    def step(
        self, state: SmoothPredictiveState, seen: Measurement
    ) -> tuple[SmoothPredictiveState, Float[Array, ""]]:
        """Return the state after one period and the commanded displacement in mm."""
        hard, width = self.hard, jnp.asarray(self.width)
        speed = jnp.abs(seen.speed)
        moving = smooth_step(speed / jnp.asarray(hard.least_speed) - 1, width)
        stands, moved = 1 - moving, jnp.maximum(state.moved, moving)
        deceleration = -jnp.sign(seen.speed) * seen.acceleration
        speed_loss = jnp.asarray(hard.horizon) * deceleration
        stops = smooth_step((speed_loss - speed) / (speed + jnp.asarray(hard.least_speed)), width)
        least = (speed + _TINY * hard.least_speed) / (_LONGEST_STOP * hard.horizon)
        stop_angle = stops * 0.5 * seen.speed * speed / jnp.maximum(deceleration, least)
        steps = (jnp.zeros(()), seen.speed * hard.lead, stop_angle)
        gaps = [hard.bounds.gap(seen.driving + step) for step in steps]
        lowest = jnp.minimum(jnp.minimum(gaps[0], gaps[1]), gaps[2])
        shift = jnp.maximum(lowest / hard.bounds.closing_sum - hard.margin, 0.0)
        closes = moved * (1 - (1 - stands) * (1 - stops))
        return SmoothPredictiveState(moved), closes * shift


def smoothed(controller: Controller, width: Float[Array, ""] | float) -> Controller:
    """Return a built-in closing controller with comparisons of this relative width.

    **Raises** `ValueError` for any other controller.
    """
    if isinstance(controller, AccelerationController):
        return SmoothAccelerationController(controller, width)
    if isinstance(controller, PredictiveController):
        return SmoothPredictiveController(controller, width)
    raise ValueError(
        "Argument `controller` must be an AccelerationController or a PredictiveController, but is"
        f" a {type(controller).__name__}."
    )
