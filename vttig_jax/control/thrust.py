"""What the flank that carries does to the actuator: the force along the axis."""

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..base.arrays import Number, Numbers, float64
from .plant import FREE, Drag

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
