"""Speed and acceleration of a shaft from its encoder alone, as a controller gets them."""

from abc import abstractmethod
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from ...base.arrays import Number, float64
from ...base.units import REV


class MotionEstimate(NamedTuple):
    """Angle in rad, speed in rad/s and acceleration in rad/s² as they seem."""

    angle: Float[Array, ""]
    speed: Float[Array, ""]
    acceleration: Float[Array, ""]


class Observer(eqx.Module):
    """Follows readings, one a period."""

    bandwidth_hz: eqx.AbstractVar[Float[Number, ""]]

    @abstractmethod
    def step(
        self, before: MotionEstimate, reading: Float[Array, ""], period: Float[Array, ""]
    ) -> MotionEstimate:
        """The estimate after one more reading, a period of s after the last."""


class AlphaBetaGamma(Observer):
    """Tracking filter of constant acceleration with its three poles in one place.

    The prediction is corrected by α, β/T and γ/T² times the innovation, with pole
    θ = exp(−2π f T): α = 1 − θ³, β = 3/2 (1 − θ)² (1 + θ), γ = (1 − θ)³ (E. Brookner, Tracking and
    Kalman Filtering Made Easy, 1998, fading memory). A constant acceleration it follows without
    lag; after a step of the acceleration its speed overshoots.
    """

    bandwidth_hz: Float[Number, ""] = eqx.field(converter=float64)

    def step(
        self, before: MotionEstimate, reading: Float[Array, ""], period: Float[Array, ""]
    ) -> MotionEstimate:
        """See `Observer.step`."""
        pole = jnp.exp(-REV * self.bandwidth_hz * period)
        angle = before.angle + period * (before.speed + 0.5 * period * before.acceleration)
        speed = before.speed + period * before.acceleration
        innovation = reading - angle
        left = 1 - pole
        return MotionEstimate(
            angle + (1 - pole**3) * innovation,
            speed + 1.5 * left**2 * (1 + pole) / period * innovation,
            before.acceleration + left**3 / period**2 * innovation,
        )


class FilteredDifference(Observer):
    """Differences of readings, and of speeds, each through a first-order low pass.

    It lags by 1/(2π f) in speed and twice that in acceleration.
    """

    bandwidth_hz: Float[Number, ""] = eqx.field(converter=float64)

    def step(
        self, before: MotionEstimate, reading: Float[Array, ""], period: Float[Array, ""]
    ) -> MotionEstimate:
        """See `Observer.step`."""
        weight = 1 - jnp.exp(-REV * self.bandwidth_hz * period)
        speed = before.speed + weight * ((reading - before.angle) / period - before.speed)
        change = (speed - before.speed) / period
        return MotionEstimate(
            reading, speed, before.acceleration + weight * (change - before.acceleration)
        )
