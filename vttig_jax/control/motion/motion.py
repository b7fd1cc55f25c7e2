"""What a prescribed motion of the driving shaft is: angle, speed, acceleration at any time."""

from abc import abstractmethod
from typing import NamedTuple

import equinox as eqx
from jax.typing import ArrayLike
from jaxtyping import Array, Float, Real

from ...base.arrays import Number


class MotionPoint(NamedTuple):
    """Where the driving shaft is and how it moves, at one time or at many.

    - `angle`: φ₁ in rad. - `speed`: dφ₁/dt in rad/s. - `acceleration`: d²φ₁/dt² in rad/s².
    """

    angle: Float[Array, "*shape"]
    speed: Float[Array, "*shape"]
    acceleration: Float[Array, "*shape"]


class Motion(eqx.Module):
    """A run of the driving shaft that somebody else decides: it does not feel the gears.

    The shaft stands still before 0 and from `duration_s` on. Every number is traced: new values
    compile nothing, and a batch of motions is one `vmap`.

    - `duration_s`: end of the run.
    - `braking_s`: when the deceleration begins that precedes the turn (of a motion that only slows
      down: the slow-down); `duration_s` where there is none.
    - `turn_s`: when the shaft starts to move backwards, after the standstill if there is one;
      `duration_s` for a motion that never turns back. Backwards means against the sense in which
      the run began.
    """

    duration_s: eqx.AbstractVar[Float[Number, ""]]
    braking_s: eqx.AbstractVar[Float[Number, ""]]
    turn_s: eqx.AbstractVar[Float[Number, ""]]

    @abstractmethod
    def at(self, time: Real[ArrayLike, "*shape"]) -> MotionPoint:
        """Angle, speed and acceleration at times in s.

        Where the acceleration steps, it is already that of what begins.
        """
