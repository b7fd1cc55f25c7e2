"""Sinusoidal motion of one period: a forward pass and a return pass."""

from typing import Any

import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Real

from ...base.numerics.sincos import sincos
from ...base.units import DEG, REV
from ..fields import Quantity
from .motion import Motion, MotionPoint
from .profiles import REVERSAL_DEG, SPEED_RPM


class Sine(Motion):
    """Motion φ = A (1 − cos 2πft)/2 = A sin² πft of one period, from rest to rest.

    It goes to `reversal_deg`, A, and back, with the peak speed ω = πfA of `speed_rpm`; a negative A
    gives the mirrored motion. The speed is highest after a quarter of the period, where braking
    begins; the turn is at half the period. At both ends the speed is continuous, and the
    acceleration jumps by 2A(πf)². The motion has no ramps and no standstill.

    **Raises** `ValueError` for numbers out of range. Traced values are not checked.

    **Example**
    ```python
    >>> import math, vttig_jax
    >>> from vttig_jax.control import Sine
    >>> vttig_jax.enable_x64()
    >>> motion = Sine(speed_rpm=60.0, reversal_deg=720.0)
    >>> point = motion.at(motion.braking_s)
    >>> round(math.degrees(point.angle)), round(float(point.speed) / (2 * math.pi) * 60)
    (360, 60)

    ```
    """

    speed_rpm: Quantity = SPEED_RPM()
    reversal_deg: Quantity = REVERSAL_DEG()

    @property
    def duration_s(self) -> Any:
        """One period 1/f, s."""
        return np.pi * abs(self.reversal_deg * DEG) / (self.speed_rpm * (REV / 60.0))

    @property
    def braking_s(self) -> Any:
        """See `Motion`."""
        return 0.25 * self.duration_s

    @property
    def turn_s(self) -> Any:
        """See `Motion`."""
        return 0.5 * self.duration_s

    def at(self, time: Real[ArrayLike, "*shape"]) -> MotionPoint:
        """Return angle, speed and acceleration at times in s."""
        time = jnp.asarray(time, float)
        rate = np.pi / jnp.asarray(self.duration_s)
        size = jnp.asarray(self.reversal_deg * DEG)
        moves = (time >= 0.0) & (time < self.duration_s)
        sine, cosine = sincos(rate * jnp.where(moves, time, 0.0))
        return MotionPoint(
            angle=size * sine * sine,
            speed=2.0 * size * rate * sine * cosine,
            acceleration=jnp.where(
                moves, 2.0 * size * rate * rate * (cosine * cosine - sine * sine), 0.0
            ),
        )
