"""Differentiable closing controllers: thresholds become a C² smoothstep for gradient-based tuning.

A comparison such as "the deceleration exceeds the threshold" jumps from 0 to 1, so its derivative
is zero wherever it exists. Here the comparison rises smoothly from 0 to 1 for x from −w to w:

    step(x) = p³ (10 − 15 p + 6 p²),   p = (x/w + 1)/2 clipped to 0 … 1

x is the compared quantity minus its threshold, divided by the threshold. The step is exactly 0 for
x ≤ −w, exactly 1 for x ≥ w and twice differentiable. A logistic function is unsuitable: it is never
exactly 0, and its small values would close the gap when they add up over a thousand periods. For
w → 0 both controllers become the original ones.
"""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from ...base.arrays import Number, float64
from .acceleration import AccelerationController
from .controller import Controller, Measurement
from .predictive import PredictiveController

_LONGEST_STOP = 4.0
"""Stopping time, in multiples of the horizon, up to which the stopping angle is exact.

A chosen value."""
_TINY = 1e-9
"""Fraction of `least_speed` that is added to the speed to avoid 0/0 at rest; a chosen value."""


def smooth_step(excess: Float[Array, ""], width: Float[Array, ""]) -> Float[Array, ""]:
    """Return the smoothed comparison `excess` > 0 as a number 0 … 1 (step(x) of this module).

    `excess` (x) and `width` (w) have no dimension.
    """
    share = jnp.clip(0.5 * (excess / width + 1.0), 0.0, 1.0)
    return share**3 * (10 + share * (6 * share - 15))


class SmoothLatch(eqx.Module):
    """State: `closing`, from 0 (gap open) to 1 (gap closed), and the stored `shift`, mm."""

    closing: Float[Array, ""]
    shift: Float[Array, ""]


class SmoothAccelerationController(Controller):
    """`AccelerationController` with smoothed comparisons and a latch w between 0 and 1.

    c and g are the smoothed comparisons for "decelerates" and "accelerates", 0 … 1, and s₀ is the
    displacement that closes the gap at the present angle. In every period the latch w (`closing`)
    and the stored displacement s (`shift`) become

        w ← (1 − g(1 − c)) w + c (1 − w),   s ← (1 − g(1 − c)) s + c (1 − w) s₀

    **Arguments**
    - `hard`: the original controller.
    - `width`: width of a smoothed comparison, as a fraction of its threshold (`threshold` or
      `least_speed` of the original controller).
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
        target = hard.bounds.closed_at(hard.bounds.gap(seen.driving)) - hard.margin
        closing = kept * state.closing + added
        shift = kept * state.shift + added * jnp.maximum(target, 0.0)
        return SmoothLatch(closing, shift), shift


class SmoothPredictiveState(eqx.Module):
    """State: `moved`, the smoothed comparison for "the shaft has moved since the start", 0 … 1."""

    moved: Float[Array, ""]


class SmoothPredictiveController(Controller):
    """`PredictiveController` with smoothed comparisons.

    It commands the displacement of the original controller times a factor 0 … 1, the smoothed
    comparison for "the shaft has moved, and it stands or is about to stop".

    **Arguments**
    - `hard`: the original controller.
    - `width`: width of the comparisons. It is relative to `least_speed`, but for the comparison of
      the speed with deceleration times horizon, it is relative to speed plus `least_speed`.
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
        closes = moved * (1 - (1 - stands) * (1 - stops))
        return SmoothPredictiveState(moved), closes * hard.shift(seen, stop_angle)


def smoothed(controller: Controller, width: Float[Array, ""] | float) -> Controller:
    """Return the smooth version of a built-in closing controller.

    `width` is the relative width of its comparisons.

    **Raises** `ValueError` unless `controller` is an `AccelerationController` or a
    `PredictiveController`.
    """
    if isinstance(controller, AccelerationController):
        return SmoothAccelerationController(controller, width)
    if isinstance(controller, PredictiveController):
        return SmoothPredictiveController(controller, width)
    raise ValueError(
        "Argument `controller` must be the acceleration or the predictive controller, because only"
        f" these can be smoothed (`smooth_width`), but is a {type(controller).__name__}."
    )
