"""Both closing controllers with their yes and no blurred, for whoever needs their slopes.

A judgement such as "the deceleration exceeds the threshold" steps from no to yes, so that its slope
is zero wherever there is one. Here it rises over a stated width instead:

    yes(x) = p³ (10 − 15 p + 6 p²),   p = (x/w + 1)/2 cut to 0 … 1

0 for x ≤ −w, 1 for x ≥ w, twice differentiable, with x made dimensionless by what it is compared
with. Unlike a logistic it is exactly 0 outside its width: a judgement repeated in a thousand
periods would close the gap by its tail alone. As w → 0 both become the controllers they stand for.
"""

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from ...base.arrays import Number, float64
from .acceleration import AccelerationController
from .controller import Controller, Measurement
from .predictive import PredictiveController

_FASTEST = 4.0
"""Horizons within which a shaft may stop and still count for the stopping angle."""
_TINY = 1e-9
"""Share of the least speed that keeps a shaft at rest from dividing by zero."""


def smooth_step(excess: Float[Array, ""], width: Float[Array, ""]) -> Float[Array, ""]:
    """How far a dimensionless excess counts as positive, 0 … 1; see the module."""
    share = jnp.clip(0.5 * (excess / width + 1.0), 0.0, 1.0)
    return share**3 * (10 + share * (6 * share - 15))


class Leaky(NamedTuple):
    """How far the gap counts as judged closed, 0 … 1, and the shift stored by it, mm."""

    closing: Float[Array, ""]
    shift: Float[Array, ""]


class SmoothAccelerationController(Controller):
    """`AccelerationController` with blurred judgements and a latch that fills and drains.

    In every period the share c of a deceleration, of what was not closed yet, stores the shift of
    this angle, and the share g of an acceleration lets go of all that is stored:

        w ← (1 − g(1 − c)) w + c (1 − w),   s ← (1 − g(1 − c)) s + c (1 − w) asked

    **Arguments**
    - `hard`: the controller. - `width`: of the judgements, relative to threshold and least speed.
    """

    hard: AccelerationController
    width: Float[Number, ""] = eqx.field(converter=float64)

    def start(self) -> Leaky:
        """Open."""
        return Leaky(jnp.zeros(()), jnp.zeros(()))

    def step(self, state: Leaky, seen: Measurement) -> tuple[Leaky, Float[Array, ""]]:
        """Judge one period."""
        hard, width = self.hard, jnp.asarray(self.width)
        moving = smooth_step(jnp.abs(seen.speed) / hard.least_speed - 1, width)
        along = jnp.sign(seen.speed) * seen.acceleration / hard.threshold
        slows, gains = (
            moving * smooth_step(-along - 1, width),
            moving * smooth_step(along - 1, width),
        )
        kept, new = 1 - gains * (1 - slows), slows * (1 - state.closing)
        asked = hard.bounds.gap(seen.driving) / hard.bounds.closing_sum - hard.margin
        closing = kept * state.closing + new
        shift = kept * state.shift + new * jnp.maximum(asked, 0.0)
        return Leaky(closing, shift), shift


class Moved(NamedTuple):
    """How far the shaft counts as having moved since the run began, 0 … 1."""

    moved: Float[Array, ""]


class SmoothPredictiveController(Controller):
    """`PredictiveController` with blurred judgements.

    It closes by the share of "stands or stops", both blurred, of what the hard one asks for.

    **Arguments**
    - `hard`: the controller. - `width`: of the judgements, relative to the least speed, and to the
      speed where it is held against the deceleration times the horizon.
    """

    hard: PredictiveController
    width: Float[Number, ""] = eqx.field(converter=float64)

    def start(self) -> Moved:
        """Not moved yet."""
        return Moved(jnp.zeros(()))

    def step(self, state: Moved, seen: Measurement) -> tuple[Moved, Float[Array, ""]]:
        """Look ahead from one period."""
        hard, width = self.hard, jnp.asarray(self.width)
        speed = jnp.abs(seen.speed)
        fast = speed / jnp.asarray(hard.least_speed) - 1
        stands, moved = (
            1 - smooth_step(fast, width),
            jnp.maximum(state.moved, smooth_step(fast, width)),
        )
        slowing = -jnp.sign(seen.speed) * seen.acceleration
        reach = jnp.asarray(hard.horizon) * slowing
        stops = smooth_step((reach - speed) / (speed + jnp.asarray(hard.least_speed)), width)
        least = (speed + _TINY * hard.least_speed) / (_FASTEST * hard.horizon)
        way = stops * 0.5 * seen.speed * speed / jnp.maximum(slowing, least)
        ahead = (jnp.zeros(()), seen.speed * hard.lead, way)
        gaps = [hard.bounds.gap(seen.driving + one) for one in ahead]
        lowest = jnp.minimum(jnp.minimum(gaps[0], gaps[1]), gaps[2])
        shift = jnp.maximum(lowest / hard.bounds.closing_sum - hard.margin, 0.0)
        closes = moved * (1 - (1 - stands) * (1 - stops))
        return Moved(moved), closes * shift


def smoothed(controller: Controller, width: Float[Array, ""] | float) -> Controller:
    """A closing controller of ours with judgements of this width.

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
