"""Sinusoidal motion of one period: a forward pass and a return pass."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Float, Real

from ...base.arrays import Number, float64
from ...base.numerics.sincos import sincos
from ...base.units import DEG, REV
from .limits import check_numbers
from .motion import Motion, MotionPoint

Scalar = Float[Number, ""]


class SineMotion(Motion):
    """Motion φ = A (1 − cos 2πft)/2 = A sin² πft of one period, from rest to rest; see `sine`.

    The speed is highest after a quarter of the period, where braking begins; the turn is at half
    the period. At both ends the speed is continuous, and the acceleration jumps by 2A(πf)².

    **Arguments**
    - `peak_to_peak`: A, rad; negative for a motion that starts backwards.
    - `duration_s`: one period 1/f, s. - `braking_s`, `turn_s`: see `Motion`.
    """

    peak_to_peak: Scalar = eqx.field(converter=float64)
    duration_s: Scalar = eqx.field(converter=float64)
    braking_s: Scalar = eqx.field(converter=float64)
    turn_s: Scalar = eqx.field(converter=float64)

    def at(self, time: Real[ArrayLike, "*shape"]) -> MotionPoint:
        """Return angle, speed and acceleration at times in s."""
        time = jnp.asarray(time, float)
        rate = np.pi / jnp.asarray(self.duration_s)
        size = jnp.asarray(self.peak_to_peak)
        moves = (time >= 0.0) & (time < self.duration_s)
        sine, cosine = sincos(rate * jnp.where(moves, time, 0.0))
        return MotionPoint(
            angle=size * sine * sine,
            speed=2.0 * size * rate * sine * cosine,
            acceleration=jnp.where(
                moves, 2.0 * size * rate * rate * (cosine * cosine - sine * sine), 0.0
            ),
        )


def sine(speed_rpm: Real[ArrayLike, ""], reversal_deg: Real[ArrayLike, ""]) -> SineMotion:
    """Return a motion to `reversal_deg` and back as one sine period with peak speed `speed_rpm`.

    With amplitude A and frequency f (see `SineMotion`) the peak speed is ω = πfA, hence f = ω/(πA).
    The motion has no ramps and no standstill.

    **Raises** `ValueError` for a speed that is not positive, a reversal at zero, and numbers that
    are not finite. Traced values are not checked.

    **Example**
    ```python
    >>> import math, vttig_jax
    >>> from vttig_jax.control import sine
    >>> vttig_jax.enable_x64()
    >>> motion = sine(speed_rpm=60.0, reversal_deg=720.0)
    >>> point = motion.at(motion.braking_s)
    >>> round(math.degrees(point.angle)), round(float(point.speed) / (2 * math.pi) * 60)
    (360, 60)

    ```
    """
    check_numbers(speed_rpm=speed_rpm, reversal_deg=reversal_deg)
    size = float64(reversal_deg) * DEG
    speed = float64(speed_rpm) * (REV / 60.0)
    period = np.pi * abs(size) / speed
    return SineMotion(
        peak_to_peak=size, duration_s=period, braking_s=0.25 * period, turn_s=0.5 * period
    )
