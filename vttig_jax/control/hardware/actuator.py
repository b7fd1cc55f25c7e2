"""The linear actuator that slides gear 2, and the axial force that the loaded flank puts on it."""

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jax.typing import ArrayLike
from jaxtyping import Array, Bool, Float

from ...base.arrays import Number, Numbers, float64
from ..plants.plant import FREE, Drag, Slide

_STILL = 1e-6
"""rad/s below which the driven shaft stands."""


class Push(NamedTuple):
    """Forces along the axis, N.

    - `against`: with which the teeth resist being closed further.
    - `back`: with which they push gear 2 back; below zero friction holds it with as much.
    """

    against: Float[Array, ""]
    back: Float[Array, ""]


class Thrust(eqx.Module):
    """Axial force of the one flank that carries, from the torque that the motion asks of it.

        F = T/R₂ (tan β ± μ),  T = J₂ i φ̈₁ + drag(i φ̇₁)

    with + for closing and − for being pushed back. At standstill friction of the driven shaft takes
    the side that resists: closing has to turn that shaft. In flight there is no force. What a gap
    that is closed on both flanks adds is unknown to a motion that takes whatever torque it needs:
    see `pushed_back`.

    **Arguments**
    - `drag`: inertia and friction of the driven shaft. - `taper`: tan β of both flanks.
    - `friction`: μ of the flanks. - `radius_m`: R₂, m. - `ratio`: i.
    """

    drag: Drag
    taper: Float[Numbers, "2"] = eqx.field(converter=float64)
    friction: Float[Number, ""] = eqx.field(converter=float64)
    radius_m: Float[Number, ""] = eqx.field(converter=float64)
    ratio: Float[Number, ""] = eqx.field(converter=float64)

    def at(
        self, side: Float[Array, ""], speed: Float[Array, ""], acceleration: Float[Array, ""]
    ) -> Push:
        """At a driving speed in rad/s and acceleration in rad/s², on the flank `side`."""
        drag, turning = self.drag, self.ratio * speed
        faded = drag.stribeck / (1 + (turning / drag.stribeck_speed) ** 2)
        moves = jnp.abs(turning) > _STILL
        torque = drag.inertia * self.ratio * acceleration + drag.load + drag.viscous * turning
        torque += jnp.where(moves, jnp.sign(turning) * (drag.coulomb + faded), 0.0)
        hold = jnp.where(moves, 0.0, jnp.asarray(drag.coulomb) + drag.stribeck)
        taper = jnp.where(side > 0, self.taper[1], self.taper[0])
        against, back = (
            jnp.where(side == FREE, 0.0, jnp.maximum(-side * torque + more, 0.0)) / self.radius_m
            for more in (hold, -hold)
        )
        return Push(against * (taper + self.friction), back * (taper - self.friction))


class Carriage(NamedTuple):
    """Where the actuator is.

    - `wanted`, `rate`: where it would be with nothing in its way, mm and mm/s.
    - `reached`: where it is; the closed gap may hold it back, mm.
    - `queue`: commands on their way, the oldest first, mm.
    - `stalled`: the teeth are stronger than it, where its force has a limit.
    """

    wanted: Float[Array, ""]
    rate: Float[Array, ""]
    reached: Float[Array, ""]
    queue: Float[Array, " periods"]
    stalled: Bool[Array, ""] | None = None


class Actuator(eqx.Module):
    """Trapezoidal positioning with a transport delay.

    It speeds up and brakes with one acceleration and stops on the command, rounded to its
    resolution. Where the gap is closed it stalls, and is pushed back as the gap shrinks: `wanted`
    goes on, `reached` does not. Where the teeth cannot push it back the drive blocks instead.

    With a limited force it stops, as fast as it brakes, where the flank that carries resists more
    than that, and is driven back, at its speed and to its end stop at most, where that flank pushes
    with more.

    **Arguments**
    - `speed`, `acceleration`: mm/s, mm/s². - `resolution`: mm; 0 for none. - `stroke`: mm.
    - `yields`: whether the drive can push it back; see `pushed_back`.
    - `delay`: in whole periods of the controller.
    - `periods`: length of the queue, at least `delay` and 1.
    - `force_limit`: N; None for none. - `thrust`: forces of the teeth, where there is a limit.
    """

    speed: Float[Number, ""] = eqx.field(converter=float64)
    acceleration: Float[Number, ""] = eqx.field(converter=float64)
    stroke: Float[Number, ""] = eqx.field(converter=float64)
    resolution: Float[Number, ""] = eqx.field(converter=float64)
    delay: Float[Number, ""] = eqx.field(converter=float64)
    yields: Bool[Numbers, ""]
    periods: int = eqx.field(static=True)
    force_limit: Float[Number, ""] | None = None
    thrust: Thrust | None = None

    def at_rest(self) -> Carriage:
        """Fully open, no command given."""
        zero = jnp.zeros(())
        stalled = None if self.force_limit is None else jnp.zeros((), bool)
        return Carriage(zero, zero, zero, jnp.zeros(self.periods), stalled)

    def commanded(
        self, carriage: Carriage, command: Float[Array, ""]
    ) -> tuple[Carriage, Float[Array, ""]]:
        """Take a command in mm and give the one that arrives now, within stroke and resolution."""
        queue = jnp.append(carriage.queue, command)
        # The queue ends with the newest.
        ripe = jnp.arange(self.periods + 1) == self.periods - jnp.asarray(self.delay)
        arrived = jnp.clip(jnp.sum(jnp.where(ripe, queue, 0.0)), 0.0, self.stroke)
        fine = jnp.asarray(self.resolution)
        rounded = jnp.floor(arrived / jnp.where(fine > 0, fine, 1.0)) * fine
        return carriage._replace(queue=queue[1:]), jnp.where(fine > 0, rounded, arrived)

    def step(
        self,
        carriage: Carriage,
        target: Float[Array, ""],
        closed: Float[Array, ""],
        step: Float[Array, ""],
        push: Push | None = None,
    ) -> tuple[Carriage, Slide, Bool[Array, ""]]:
        """Slide for a step of s towards a target in mm, up to where the gap is `closed` after it.

        `push`: what the teeth do, where the force is limited.

        **Returns** the carriage, its way, and whether the drive is blocked: the gap has shrunk
        below what the carriage holds, and it does not yield.
        """
        ahead = target - carriage.wanted
        # The speed from which it stops on the target, braking fully from the next step on: m more
        # steps bring it from v to zero over step (v + (v − b) + … + (v − m b)).
        brake, rate = self.acceleration * step, 1.0 / step
        more = jnp.floor(0.5 * (jnp.sqrt(1 + jnp.abs(ahead) * (8 * rate / brake)) - 1))
        stops = jnp.abs(ahead) * rate / (more + 1) + 0.5 * brake * more
        fastest = jnp.minimum(self.speed, stops)
        wish, stalled = jnp.sign(ahead) * fastest, None
        if self.force_limit is not None and push is not None:
            least = jnp.asarray(self.force_limit)
            driven = push.back > least
            stopped = ((ahead > 0) & (push.against > least)) | ((ahead < 0) & (-push.back > least))
            wish = jnp.where(driven, -self.speed, jnp.where(stopped, 0.0, wish))
            stalled = stopped | (driven & (carriage.wanted > 0))
        change = wish - carriage.rate
        speed = carriage.rate + jnp.clip(change, -brake, brake)
        wanted = carriage.wanted + step * speed
        if stalled is not None:
            wanted = jnp.maximum(wanted, 0.0)
            speed = jnp.where(wanted > 0, speed, jnp.maximum(speed, 0.0))
        reached = jnp.minimum(wanted, jnp.maximum(closed, 0.0))
        blocked = ~jnp.asarray(self.yields) & (reached < jnp.minimum(carriage.reached, wanted))
        moved = (reached - carriage.reached) * rate
        slide = Slide(carriage.reached, reached, moved, moved)
        return Carriage(wanted, speed, reached, carriage.queue, stalled), slide, blocked


def pushed_back(
    taper: Float[ArrayLike, "*shape 2"], friction: Float[ArrayLike, "*shape"]
) -> Bool[Array, "*shape"]:
    """Can the teeth, wedged between both flanks, push the actuator back?

    A flank pressed with F leaves F (tan β − μ) along the axis: with μ ≥ tan β the wedge locks
    itself. A shaft that follows its motion whatever it takes overcomes any actuator otherwise.

    **Arguments**
    - `taper`: tan β of both flanks. - `friction`: coefficient μ of the flanks.
    """
    return jnp.max(jnp.abs(jnp.asarray(taper)), axis=-1) > jnp.asarray(friction)
