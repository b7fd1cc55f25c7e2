"""Linear actuator that slides gear 2, and the axial force of the loaded flank on it."""

from dataclasses import replace

import equinox as eqx
import jax.numpy as jnp
from jax.typing import ArrayLike
from jaxtyping import Array, Bool, Float

from ...base.arrays import Number, Numbers, float64
from ...base.numerics.straight_through import straight_through
from ..plants.plant import FREE, Drag, Slide

_STANDSTILL = 1e-6
"""Speed of the driven shaft in rad/s below which it counts as standing still; a chosen value."""


class Push(eqx.Module):
    """Axial forces of the teeth on gear 2, N.

    - `closing_resistance`: force that resists further closing.
    - `opening_force`: force that pushes gear 2 back; a negative value is friction that holds it.
    """

    closing_resistance: Float[Array, ""]
    opening_force: Float[Array, ""]


class Thrust(eqx.Module):
    """Axial force of the loaded flank, from the torque that the motion requires.

        F = T/R₂ (tan β ± μ),  T = J₂ i φ̈₁ + drag(i φ̇₁)

    The sign is + for closing and − for opening. At standstill, closing has to turn the driven
    shaft, so its friction adds to the resistance. Without contact the force is zero. The extra
    force of a gap that is closed on both flanks is left out: a prescribed motion has unlimited
    torque and does not determine it (see `can_back_drive`).

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
        """Return the forces of flank `side` at a driving speed (rad/s), acceleration (rad/s²)."""
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

    - `unobstructed`, `rate`: position (mm) and speed (mm/s) that ignore the closed gap.
    - `reached`: actual position, mm; the closed gap may hold it back.
    - `queue`: delayed commands, the oldest first, mm.
    - `stalled`: whether the teeth exceed its force limit; None without a limit.
    """

    unobstructed: Float[Array, ""]
    rate: Float[Array, ""]
    reached: Float[Array, ""]
    queue: Float[Array, " periods"]
    stalled: Bool[Array, ""] | None = None


class Actuator(eqx.Module):
    """Trapezoidal positioning with a transport delay.

    It accelerates and brakes at one rate and stops on the command, which is rounded down to its
    resolution. At the closed gap it stalls, and a shrinking gap pushes it back: `unobstructed`
    continues, `reached` does not. If the teeth cannot push it back, the drive blocks.

    With a force limit, it brakes and stops when the loaded flank resists with more than the limit.
    When that flank pushes with more than the limit, it moves back, at most at its own speed and to
    its end stop.

    **Arguments**
    - `speed`, `acceleration`: limits, mm/s and mm/s². - `stroke`: travel, mm.
    - `resolution`: step, mm; 0 for a continuous position.
    - `back_drivable`: whether the drive can push it back; see `can_back_drive`.
    - `delay`: transport delay, whole periods of the controller.
    - `periods`: length of the queue, at least `delay` and 1.
    - `force_limit`: N; None for no limit. - `thrust`: forces of the teeth, needed with a limit.
    - `straight`: whether derivatives pass through the rounding as if there were none.
    """

    speed: Float[Number, ""] = eqx.field(converter=float64)
    acceleration: Float[Number, ""] = eqx.field(converter=float64)
    stroke: Float[Number, ""] = eqx.field(converter=float64)
    resolution: Float[Number, ""] = eqx.field(converter=float64)
    delay: Float[Number, ""] = eqx.field(converter=float64)
    back_drivable: Bool[Numbers, ""]
    periods: int = eqx.field(static=True)
    force_limit: Float[Number, ""] | None = None
    thrust: Thrust | None = None
    straight: bool = eqx.field(static=True, default=False)

    def at_rest(self) -> Carriage:
        """Return the fully open state without commands."""
        zero = jnp.zeros(())
        stalled = None if self.force_limit is None else jnp.zeros((), bool)
        return Carriage(zero, zero, zero, jnp.zeros(self.periods), stalled)

    def commanded(
        self, carriage: Carriage, command: Float[Array, ""]
    ) -> tuple[Carriage, Float[Array, ""]]:
        """Queue a command (mm); return the one due now, limited to the stroke and rounded down."""
        queue, due = _queued(carriage.queue, command, jnp.asarray(self.delay))
        arrived = jnp.clip(due, 0.0, self.stroke)
        resolution = jnp.asarray(self.resolution)
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
        """Slide for a step (s) towards a target (mm), limited by the `closed` position after it.

        `push`: forces of the teeth, for a limited force.

        **Returns** the state, the motion, and whether the drive is blocked: the gap at the end of
        the step is too small for the carriage, and the drive cannot push the carriage back.
        """
        error = target - carriage.unobstructed
        # Highest speed v from which full braking, from the next step on, stops on the target: the
        # m further steps cover step (v + (v − b) + … + (v − m b)), b the speed lost in a step.
        brake, rate = self.acceleration * step, 1.0 / step
        steps = jnp.floor(0.5 * (jnp.sqrt(1 + jnp.abs(error) * (8 * rate / brake)) - 1))
        stopping_speed = jnp.abs(error) * rate / (steps + 1) + 0.5 * brake * steps
        fastest = jnp.minimum(self.speed, stopping_speed)
        goal, stalled = jnp.where(error < 0, -fastest, fastest), None
        if self.force_limit is not None and push is not None:
            limit = jnp.asarray(self.force_limit)
            driven = push.opening_force > limit
            stopped = (error > 0) & (push.closing_resistance > limit)
            stopped |= (error < 0) & (-push.opening_force > limit)
            goal = jnp.where(driven, -self.speed, jnp.where(stopped, 0.0, goal))
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
"""Longest queue whose entries are picked one by one: a chosen value."""


def _queued(
    queue: Float[Array, " periods"], command: Float[Array, ""], delay: Float[Array, ""]
) -> tuple[Float[Array, " periods"], Float[Array, ""]]:
    """Return the queue with a new last command, without the first, and the command due now.

    Entries of a short queue are picked one by one: a sum over them is no loop over lanes.
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

    A flank force F has the axial component F (tan β − μ): the wedge is self-locking if μ ≥ tan β.
    Otherwise a prescribed motion, whose torque is unlimited, overcomes any actuator.

    **Arguments**
    - `taper`: tan β of both flanks. - `friction`: friction coefficient μ of the flanks.
    """
    return jnp.max(jnp.abs(jnp.asarray(taper)), axis=-1) > jnp.asarray(friction)
