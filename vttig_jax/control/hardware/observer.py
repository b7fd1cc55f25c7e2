"""Observers that estimate speed and acceleration of a shaft from its encoder readings."""

from abc import abstractmethod
from functools import partial

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from ...base.arrays import Number
from ...base.units import REV
from ..fields import Part, Quantity, positive


class MotionEstimate(eqx.Module):
    """Estimated angle (rad), speed (rad/s) and acceleration (rad/s²)."""

    angle: Float[Array, ""]
    speed: Float[Array, ""]
    acceleration: Float[Array, ""]


class Observer(Part):
    """Estimator of angle, speed and acceleration that takes one reading per controller period."""

    bandwidth_hz: eqx.AbstractVar[Float[Number, ""]]

    @abstractmethod
    def step(
        self, before: MotionEstimate, reading: Float[Array, ""], period: Float[Array, ""]
    ) -> MotionEstimate:
        """Return the estimate after the next reading (rad), one `period` (s) after the last.

        `before` is the estimate after the last reading.
        """


_BANDWIDTH = partial(positive, 20.0, "bandwidth of the observer", "Hz")


class AlphaBetaGamma(Observer):
    """Tracking filter with a constant-acceleration model and a triple pole θ = exp(−2π f T).

    f is `bandwidth_hz` and T the period. α, β/T and γ/T² times the innovation (reading minus
    predicted angle) correct angle, speed and acceleration, with α = 1 − θ³,
    β = 3/2 (1 − θ)² (1 + θ), γ = (1 − θ)³ (E. Brookner, Tracking and Kalman Filtering Made Easy,
    1998, fading memory). The filter has no lag at constant acceleration; after a step of the
    acceleration the estimated speed overshoots.
    """

    bandwidth_hz: Quantity = _BANDWIDTH()

    def step(
        self, before: MotionEstimate, reading: Float[Array, ""], period: Float[Array, ""]
    ) -> MotionEstimate:
        """Return the estimate after the next reading (rad), one `period` (s) after the last.

        The last estimate is extrapolated at constant acceleration and corrected by the innovation.
        """
        pole = jnp.exp(-REV * self.bandwidth_hz * period)
        angle = before.angle + period * (before.speed + 0.5 * period * before.acceleration)
        speed = before.speed + period * before.acceleration
        innovation = reading - angle
        decay = 1 - pole
        return MotionEstimate(
            angle + (1 - pole**3) * innovation,
            speed + 1.5 * decay**2 * (1 + pole) / period * innovation,
            before.acceleration + decay**3 / period**2 * innovation,
        )


class FilteredDifference(Observer):
    """Observer with first-order low passes of difference quotients; f is `bandwidth_hz`.

    The speed is filtered from the differences of readings, the acceleration from the differences of
    this speed. The speed lags by 1/(2π f), and the acceleration lags by twice this time.
    """

    bandwidth_hz: Quantity = _BANDWIDTH()

    def step(
        self, before: MotionEstimate, reading: Float[Array, ""], period: Float[Array, ""]
    ) -> MotionEstimate:
        """Return the estimate after the next reading (rad), one `period` (s) after the last.

        The angle is the reading itself; the speed and the acceleration are filtered differences.
        """
        weight = 1 - jnp.exp(-REV * self.bandwidth_hz * period)
        speed = before.speed + weight * ((reading - before.angle) / period - before.speed)
        change = (speed - before.speed) / period
        return MotionEstimate(
            reading, speed, before.acceleration + weight * (change - before.acceleration)
        )
