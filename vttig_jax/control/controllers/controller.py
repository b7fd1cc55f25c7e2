"""Controllers, (state, measurement) → (state, command): their interface, and those of the package.

A comparison such as "the deceleration exceeds the threshold" jumps from 0 to 1, so its derivative
is zero wherever it exists. Smoothed, it rises from 0 to 1 for x from −w to w:

    step(x) = p³ (10 − 15 p + 6 p²),   p = (x/w + 1)/2 clipped to 0 … 1

x is the compared quantity minus its threshold, divided by a scale such as the threshold, and w the
relative width. The step is exactly 0 for x ≤ −w, exactly 1 for x ≥ w and twice differentiable. A
logistic function is unsuitable: it is never exactly 0, and its small values would close the gap
when they add up over a thousand periods. For w → 0 the comparison becomes the original one.
"""

from abc import abstractmethod
from dataclasses import replace
from functools import partial, reduce
from typing import Any, ClassVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from ...base.arrays import Number, float64
from ...base.units import REV
from ...kinematics.flank_table import Bounds
from ..fields import Part, Quantity, number, positive
from .retreat import Retreat


class Measurement(eqx.Module):
    """Inputs of a controller in one period.

    - `time`: time of the readings, s. - `driving`, `driven`: encoder readings of both shafts, rad.
    - `speed`, `acceleration`: estimates for the driving shaft, rad/s and rad/s².
    - `reference`, `reference_speed`: angle (rad) and speed (rad/s) of the prescribed motion of the
      driving shaft. Only a controller that is part of the motor control can use them.
    - `map`: flanks that the controller believes: `map.gap(angle)` is the backlash (rad) at a
      driving angle (rad), and `map.closed_at(gap)` the displacement (mm) that closes it.
    - `delay`: time from a reading to the resulting position of the actuator, s.
    - `retreat`: how the actuator follows teeth that pass; None for a map without such short waves.
    """

    time: Float[Array, ""]
    driving: Float[Array, ""]
    driven: Float[Array, ""]
    speed: Float[Array, ""]
    acceleration: Float[Array, ""]
    reference: Float[Array, ""]
    reference_speed: Float[Array, ""]
    map: Bounds
    delay: Float[Number, ""]
    retreat: Retreat | None = None


class Command(eqx.Module):
    """Output of a controller in one period.

    - `shift`: axial displacement of gear 2 towards a closed gap, mm.
    - `advance`: angle by which the driving shaft leads its prescribed motion at the end of the
      period, rad.
    """

    shift: Float[Array, ""] | float
    advance: Float[Array, ""] | float = 0.0


class Controller(Part):
    """Base class of controllers, which command the axial displacement of gear 2 in every period.

    The displacement is in mm, positive towards a closed gap. The argument `seen` of `step` is a
    `Measurement`: readings in rad, speeds in rad/s. To write a controller, derive a class:

    ```python
    >>> import jax.numpy as jnp
    >>> from vttig_jax.control import Controller
    >>> class CloseWhileSlow(Controller):
    ...     shift_mm: float
    ...
    ...     def start(self):
    ...         return ()
    ...
    ...     def step(self, state, seen):
    ...         return state, jnp.where(abs(seen.speed) < 1.0, self.shift_mm, 0.0)

    ```

    A controller that also moves the motor sets `advances = True` and returns a `Command`. Its
    `advance`, rad, is added to the prescribed angle of the driving shaft:

    ```python
    >>> import jax.numpy as jnp
    >>> from vttig_jax.control import Command, Controller
    >>> class Ahead(Controller):
    ...     advances = True
    ...     closes = False
    ...
    ...     def start(self):
    ...         return ()
    ...
    ...     def step(self, state, seen):
    ...         back = seen.reference_speed < 0
    ...         return state, Command(shift=0.0, advance=jnp.where(back, -1e-3, 0.0))

    ```

    - `closes`: whether the controller ever shifts gear 2. If false, the outcome of a run is never
      "missed".
    - `advances`: whether the controller moves the motor.
    """

    closes: ClassVar[bool] = True
    advances: ClassVar[bool] = False

    @abstractmethod
    def start(self) -> Any:
        """Return the state before the first period: any pytree of arrays."""

    @abstractmethod
    def step(self, state: Any, seen: Measurement) -> tuple[Any, Float[Array, ""] | Command]:
        """Return the state after this period, and the displacement in mm or a `Command`."""

    def as_answer(self, answer: Any) -> tuple[Any, Command]:
        """Return what `step` returned as its state and a `Command`.

        **Raises** `ValueError` if it is no pair, or if `advance` is not 0 although the class
        attribute `advances` is false.
        """
        if not (isinstance(answer, tuple) and len(answer) == 2):
            raise ValueError(
                f"Argument `controller` must return its state and a command from `step`, but"
                f" {type(self).__name__} returns {type(answer).__name__}."
            )
        state, output = answer
        if not isinstance(output, Command):
            return state, Command(output)
        moves = not isinstance(output.advance, float) or output.advance != 0.0
        if moves and not self.advances:
            raise ValueError(
                f"Argument `controller` must set `advances = True` to move the motor, but"
                f" {type(self).__name__} does not."
            )
        return state, output


class NoController(Controller):
    """Controller that leaves the gap as it is."""

    closes: ClassVar[bool] = False

    def start(self) -> tuple[()]:
        """Return an empty state."""
        return ()

    def step(self, state: Any, seen: Measurement) -> tuple[Any, Float[Array, ""]]:
        """Return a displacement of zero."""
        return state, jnp.zeros(())


class LostController(NoController):
    """Controller for a run in which the turn within the hunting period could not be located.

    It would close the gap, but commands a displacement of zero, so the gap remains open.
    """

    closes: ClassVar[bool] = True


def exceeds(value: Any, threshold: Any, scale: Any, width: Any) -> Float[Array, ""]:
    """Return whether a value exceeds a threshold, as a number 0 … 1.

    `width` (w) is relative to `scale`; None for the original comparison, which is 0 or 1.
    """
    if width is None:
        return jnp.where(value > threshold, 1.0, 0.0)
    share = 0.5 * ((value - threshold) / (scale * width) + 1.0)
    return _smooth_step(jnp.clip(share, 0.0, 1.0))


def _smooth_step(share: Float[Array, ""]) -> Float[Array, ""]:
    """Return p³ (10 − 15 p + 6 p²) for a share p of 0 … 1."""
    return share**3 * (10 + share * (6 * share - 15))


def smoothed(controller: Controller, width: Float[Array, ""] | float) -> Controller:
    """Return a closing controller with smoothed comparisons of a relative width.

    **Raises** `ValueError` for a controller without the field `width`.
    """
    if not hasattr(controller, "width"):
        raise ValueError(
            "Argument `controller` must be the acceleration or the predictive controller, because"
            f" only these can be smoothed (`smooth_width`), but is a {type(controller).__name__}."
        )
    return replace(controller, width=float64(width))  # type: ignore[call-arg]


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


_STILL = 1e-6
"""Reference speed below which the shaft counts as at rest, rad/s; a chosen value.

It lies above the rounding errors of recorded motions."""


class LeadJump(eqx.Module):
    """State of the motor's movement across the gap (the "jump").

    - `time`: time of the last period, s. - `sense`: last direction of the motion, 1 or −1.
    - `progress`: p, the completed part of the jump, 0 … 1. - `advance`: last commanded lead, rad.
    """

    time: Float[Array, ""]
    sense: Float[Array, ""]
    progress: Float[Array, ""]
    advance: Float[Array, ""]


class Feedforward(Controller):
    """Controller that turns the driving shaft by the gap ahead of the reference after a reversal.

        φ₁ = φ_ref − S j(φ₁)/i,  S = p³ (10 − 15 p + 6 p²)

    While the reference moves backwards, p rises from 0 to 1 within the jump time; while it moves
    forwards, p falls to 0. With S = 1 and contact on flank B, the driven shaft is at
    φ₂ = i φ_ref + TE_A(φ₁), as if flank A were in contact: this compensates the lost motion, but
    not the transmission error of the flanks. The controller detects the reversal in the reference
    motion, as a motor controller does, and needs no encoder.
    """

    closes: ClassVar[bool] = False
    advances: ClassVar[bool] = True

    jump_s: Quantity = number(
        0.005, "feedforward: time in which the motor crosses the gap", "s", gt=0, le=1e3
    )

    def start(self) -> LeadJump:
        """Return the state on flank A without a lead."""
        zero = jnp.zeros(())
        return LeadJump(zero, jnp.ones(()), zero, zero)

    def step(self, state: LeadJump, seen: Measurement) -> tuple[LeadJump, Command]:
        """Return the state after one controller period and the command with the lead (rad)."""
        moving = jnp.abs(seen.reference_speed) > _STILL
        sense = jnp.where(moving, jnp.sign(seen.reference_speed), state.sense)
        period = seen.time - state.time
        progress = jnp.clip(state.progress - sense * period / self.jump_s, 0.0, 1.0)
        # The shaft reaches the commanded lead one period later.
        gap = seen.map.gap(seen.reference + period * seen.reference_speed + state.advance)
        advance = -_smooth_step(progress) * gap / seen.map.ratio
        return LeadJump(seen.time, sense, progress, advance), Command(jnp.zeros(()), advance)
