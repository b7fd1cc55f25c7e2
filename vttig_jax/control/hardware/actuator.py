"""Linear actuator that slides gear 2, and the axial force of the loaded flank on it."""

from dataclasses import replace

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Bool, Float

from ...base.arrays import Number, Numbers, float64
from ...base.numerics.straight_through import straight_through
from ..fields import Part, Quantity, not_negative, number, positive
from ..plants.plant import FREE, Drag, Slide

_STANDSTILL = 1e-6
"""Speed of the driven shaft in rad/s below which it counts as standing still; a chosen value."""


class Push(eqx.Module):
    """Axial forces of the teeth on gear 2, N.

    - `closing_resistance`: force that resists further closing.
    - `opening_force`: force that pushes gear 2 towards the open gap; if it is negative, friction
      holds gear 2 with this force.
    """

    closing_resistance: Float[Array, ""]
    opening_force: Float[Array, ""]


class Thrust(eqx.Module):
    """Model of the axial force of the loaded flank, from the torque that the motion requires.

        F = T/R₂ (tan β ± μ),  T = J₂ i φ̈₁ + drag(i φ̇₁)

    The sign is + for closing and − for opening. At standstill a closing movement has to turn the
    driven shaft, so the friction of that shaft adds to the resistance. Without contact the force is
    zero. The additional force in a closed gap, with contact on both flanks, is not included: a
    prescribed motion has unlimited torque, so this force is undetermined (see `can_back_drive`).

    **Arguments**
    - `drag`: inertia and friction of the driven shaft. - `taper`: tan β of both flanks.
    - `friction`: friction coefficient μ of the flanks. - `radius_m`: R₂, m. - `ratio`: i.
    """

    drag: Drag
    taper: Float[Numbers, "2"] = eqx.field(converter=float64)
    friction: Float[Number, ""] = eqx.field(converter=float64)
    radius_m: Float[Number, ""] = eqx.field(converter=float64)
    ratio: Float[Number, ""] = eqx.field(converter=float64)

    def at(
        self, side: Float[Array, ""], speed: Float[Array, ""], acceleration: Float[Array, ""]
    ) -> Push:
        """Return the axial forces if flank `side` is loaded.

        `speed` (rad/s) and `acceleration` (rad/s²) are those of the driving shaft.
        """
        drag, driven_speed = self.drag, self.ratio * speed
        stribeck = drag.stribeck / (1 + (driven_speed / drag.stribeck_speed) ** 2)
        moves = jnp.abs(driven_speed) > _STANDSTILL
        torque = drag.inertia * self.ratio * acceleration + drag.load + drag.viscous * driven_speed
        torque += jnp.where(moves, jnp.sign(driven_speed) * (drag.coulomb + stribeck), 0.0)
        holding = jnp.where(moves, 0.0, jnp.asarray(drag.coulomb) + drag.stribeck)
        taper = jnp.where(side > 0, self.taper[1], self.taper[0])
        closing, opening = (
            jnp.where(side == FREE, 0.0, jnp.maximum(-side * torque + extra, 0.0)) / self.radius_m
            for extra in (holding, -holding)
        )
        return Push(closing * (taper + self.friction), opening * (taper - self.friction))


class Carriage(eqx.Module):
    """State of the actuator.

    - `unobstructed`, `rate`: position (mm) and speed (mm/s) without the obstacle of a closed gap.
    - `reached`: actual position, mm; it is smaller if the closed gap holds the carriage back.
    - `queue`: last commands, mm, the oldest first.
    - `stalled`: whether the axial force of the teeth exceeds the force limit of the actuator; None
      without a limit.
    """

    unobstructed: Float[Array, ""]
    rate: Float[Array, ""]
    reached: Float[Array, ""]
    queue: Float[Array, " periods"]
    stalled: Bool[Array, ""] | None = None


class Actuator(Part):
    """Actuator with trapezoidal positioning and a transport delay.

    The actuator accelerates and brakes at the same rate and stops at the commanded position, which
    is rounded down to its resolution. When the gap is closed, the actuator stalls, and a shrinking
    gap pushes it back: `Carriage.unobstructed` follows the command further, `Carriage.reached` does
    not. If the teeth cannot push the actuator back, the drive blocks.

    With a force limit, the actuator brakes and stops when the loaded flank resists with a larger
    force. When the flank pushes with a larger force, the actuator moves back, at most with its
    largest speed and at most to the position zero.

    **Arguments** (besides the numbers of the table)
    - `delay`: transport delay in whole controller periods.
    - `periods`: length of the queue of commands, at least `delay` and at least 1.
    - `back_drivable`: whether the teeth can push the actuator back; see `can_back_drive`.
    - `thrust`: forces of the teeth, needed for the force limit.
    - `straight`: whether derivatives are computed as if the command were not rounded.
    """

    speed_mm_s: Quantity = positive(20.0, "largest speed", "mm/s")
    acceleration_mm_s2: Quantity = positive(2000.0, "largest acceleration", "mm/s^2")
    resolution_mm: Quantity = number(0.0, "smallest step; 0: continuous", "mm", ge=0, le=1e3)
    delay_s: Quantity = number(
        0.0, "dead time, a whole number of controller periods", "s", ge=0, le=1e3
    )
    stroke_mm: Quantity = number(10.0, "largest shift", "mm", gt=0, le=1e5)
    force_limit_N: Quantity = not_negative(0.0, "largest axial force; 0: no limit", "N")
    delay: Float[Number, ""] = eqx.field(converter=float64, default=0.0)
    periods: int = eqx.field(static=True, default=1)
    back_drivable: Bool[Numbers, ""] = np.True_  # pyright: ignore[reportAssignmentType]
    thrust: Thrust | None = None
    straight: bool = eqx.field(static=True, default=False)

    def at_rest(self) -> Carriage:
        """Return the initial state: position, speed and all queued commands are zero (gap open)."""
        zero = jnp.zeros(())
        stalled = None if self.thrust is None else jnp.zeros((), bool)
        return Carriage(zero, zero, zero, jnp.zeros(self.periods), stalled)

    def commanded(
        self, carriage: Carriage, command: Float[Array, ""]
    ) -> tuple[Carriage, Float[Array, ""]]:
        """Add a command (mm) to the queue and return the state and the target position (mm).

        The target is the command of `delay` periods ago, limited to 0 … stroke and rounded down
        to the resolution.
        """
        queue, due = _queued(carriage.queue, command, jnp.asarray(self.delay))
        arrived = jnp.clip(due, 0.0, self.stroke_mm)
        resolution = jnp.asarray(self.resolution_mm)
        rounded = jnp.floor(arrived / jnp.where(resolution > 0, resolution, 1.0)) * resolution
        if self.straight:
            rounded = straight_through(rounded, arrived)
        arrived = jnp.where(resolution > 0, rounded, arrived)
        return replace(carriage, queue=queue), arrived

    def step(
        self,
        carriage: Carriage,
        target: Float[Array, ""],
        closed: Float[Array, ""],
        step: Float[Array, ""],
        push: Push | None = None,
    ) -> tuple[Carriage, Slide, Bool[Array, ""]]:
        """Move the carriage for one time step (s) towards a target (mm).

        `closed`: position at which the gap is closed at the end of the step, mm. `push`: forces of
        the teeth, needed with a force limit.

        **Returns** the state, the motion, and whether the drive is blocked: the gap at the end of
        the step is too small for the carriage, and the teeth cannot push the carriage back.
        """
        error = target - carriage.unobstructed
        # Highest speed v of this step from which full braking in the next m steps stops exactly at
        # the target: the distance is step · (v + (v − b) + … + (v − m b)), where b (`brake`) is the
        # decrease of the speed per step.
        brake, rate = self.acceleration_mm_s2 * step, 1.0 / step
        steps = jnp.floor(0.5 * (jnp.sqrt(1 + jnp.abs(error) * (8 * rate / brake)) - 1))
        stopping_speed = jnp.abs(error) * rate / (steps + 1) + 0.5 * brake * steps
        fastest = jnp.minimum(self.speed_mm_s, stopping_speed)
        goal, stalled = jnp.where(error < 0, -fastest, fastest), None
        if push is not None:
            limit = jnp.where(self.force_limit_N > 0, jnp.asarray(self.force_limit_N), jnp.inf)
            driven = push.opening_force > limit
            stopped = (error > 0) & (push.closing_resistance > limit)
            stopped |= (error < 0) & (-push.opening_force > limit)
            goal = jnp.where(driven, -self.speed_mm_s, jnp.where(stopped, 0.0, goal))
            stalled = stopped | (driven & (carriage.unobstructed > 0))
        speed = carriage.rate + jnp.clip(goal - carriage.rate, -brake, brake)
        position = carriage.unobstructed + step * speed
        if stalled is not None:
            position = jnp.maximum(position, 0.0)
            speed = jnp.where(position > 0, speed, jnp.maximum(speed, 0.0))
        reached = jnp.minimum(position, jnp.maximum(closed, 0.0))
        pushed = reached < jnp.minimum(carriage.reached, position)
        blocked = ~jnp.asarray(self.back_drivable) & pushed
        moved = (reached - carriage.reached) * rate
        slide = Slide(carriage.reached, reached, moved, moved)
        return Carriage(position, speed, reached, carriage.queue, stalled), slide, blocked


_PICKED = 16
"""Longest queue whose entries are compared with the delay one by one; a chosen value."""


def _queued(
    queue: Float[Array, " periods"], command: Float[Array, ""], delay: Float[Array, ""]
) -> tuple[Float[Array, " periods"], Float[Array, ""]]:
    """Return the queue after one period, and the command that takes effect (mm).

    The new queue ends with `command` and lacks the oldest one. `delay` is in periods.
    A short queue is searched with one selection per entry, which is faster in a batch than a sum.
    """
    periods, longer = len(queue), jnp.append(queue, command)
    if periods > _PICKED:
        is_due = jnp.arange(periods + 1) == periods - delay
        return longer[1:], jnp.sum(jnp.where(is_due, longer, 0.0))
    due = command
    for age in range(1, periods + 1):
        due = jnp.where(delay == age, queue[periods - age], due)
    return longer[1:], due


def can_back_drive(
    taper: Float[ArrayLike, "*shape 2"], friction: Float[ArrayLike, "*shape"]
) -> Bool[Array, "*shape"]:
    """Return whether teeth wedged between both flanks can push the actuator back.

    A flank force F pushes towards the open gap with F (tan β − μ), so the wedge is self-locking if
    μ ≥ tan β on both flanks. Otherwise a prescribed motion, with unlimited torque, pushes back any
    actuator.

    **Arguments**
    - `taper`: tan β of both flanks; the force on a flank with a negative one closes the gap.
    - `friction`: friction coefficient μ of the flanks.
    """
    return jnp.max(jnp.asarray(taper), axis=-1) > jnp.asarray(friction)
