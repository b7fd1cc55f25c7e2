"""Base class of the motions of the driving shaft: angle, speed and acceleration at any time."""

from abc import abstractmethod
from typing import TYPE_CHECKING, Any

import equinox as eqx
from jax.typing import ArrayLike
from jaxtyping import Array, Float, Real

from ...base.arrays import Number
from ..fields import Part


class MotionPoint(eqx.Module):
    """Angle, speed and acceleration of the driving shaft at one time or at many.

    - `angle`: φ₁ in rad. - `speed`: dφ₁/dt in rad/s. - `acceleration`: d²φ₁/dt² in rad/s².
    """

    angle: Float[Array, "*shape"]
    speed: Float[Array, "*shape"]
    acceleration: Float[Array, "*shape"]


class Motion(Part):
    """Prescribed motion of the driving shaft; the gears have no effect on it.

    The shaft stands still before the time 0 and from `duration_s` on. JAX traces every number of a
    motion: new values need no compilation, and `vmap` runs a batch of motions.

    - `duration_s`: end of the run, s.
    - `braking_s`: start of the deceleration before the turn, s; in a motion that only slows down,
      start of the slow-down; `duration_s` without deceleration.
    - `turn_s`: time, s, when the shaft starts to move against its initial direction, after the
      standstill if there is one; `duration_s` without a turn.
    """

    if TYPE_CHECKING:  # a field of some motions, a property of others

        def __getattr__(self, name: str) -> Any: ...

    else:
        duration_s: eqx.AbstractVar[Float[Number, ""]]
        braking_s: eqx.AbstractVar[Float[Number, ""]]
        turn_s: eqx.AbstractVar[Float[Number, ""]]

    @property
    def pieces(self) -> "Motion":
        """The motion itself; commands such as `Reversal` make theirs here."""
        return self

    @abstractmethod
    def at(self, time: Real[ArrayLike, "*shape"]) -> MotionPoint:
        """Return angle, speed and acceleration at times in s.

        Where the acceleration is discontinuous, the value after the discontinuity is returned.
        """
