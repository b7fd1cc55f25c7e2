"""Encoder readings of the controller, and the speed and acceleration that it estimates from them.

A reading has eccentric mounting, noise and quantisation.
"""

from abc import abstractmethod
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from ...base.arrays import Number
from ...base.numerics.sincos import sincos
from ...base.numerics.straight_through import straight_through
from ...base.units import ARCSEC, DEG, REV
from ..fields import Part, Quantity, number, positive
from ..motion.motion import MotionPoint


class Encoder(Part):
    """Encoder with the reading floor((φ + E sin(φ + ε) + noise)/count + 1/2) count.

    The angle is rounded to the nearest count. The reading of a shaft that rests at a whole number
    of counts, for example at zero, is therefore not disturbed by small noise. The fields give the
    count, E, ε and the standard deviation of the noise.

    **Arguments** (besides the numbers of the table)
    - `eccentric`: whether to include E; without it no sine is computed.
    - `straight`: whether derivatives are computed as if the reading were not rounded.
    """

    counts_per_rev: Quantity | None = number(
        None,
        "counts per revolution, by default those of the pair file; 0: not quantised",
        "counts",
        int,
        ge=0,
        le=2**40,
        examples=[90000],
    )
    amplitude_arcsec: Quantity = number(
        0.0, "amplitude of the error once per revolution", "arcsec", ge=0, le=648_000
    )
    phase_deg: Quantity = number(0.0, "phase of that error", "deg", ge=-1e6, le=1e6)
    noise_arcsec: Quantity = number(
        0.0, "standard deviation of white noise", "arcsec", ge=0, le=648_000
    )
    eccentric: bool = eqx.field(static=True, default=True)
    straight: bool = eqx.field(static=True, default=False)

    @property
    def count(self) -> Float[Array, ""]:
        """Angle of one count, rad; 0 for a reading that is not quantised."""
        counts = jnp.asarray(0.0 if self.counts_per_rev is None else self.counts_per_rev)
        return jnp.where(counts > 0, REV / jnp.where(counts > 0, counts, 1.0), 0.0)

    @property
    def variance(self) -> Float[Number, ""]:
        """Variance of one reading minus the true angle, count²/12 + E²/2 + noise², rad²."""
        noise, amplitude = self.noise_arcsec * ARCSEC, self.amplitude_arcsec * ARCSEC
        return self.count**2 / 12 + amplitude**2 / 2 + noise**2

    def read(self, angle: Float[Array, ""], noise_draw: Float[Array, ""]) -> Float[Array, ""]:
        """Return the reading (rad) at the true angle `angle` (rad).

        `noise_draw` is a draw of the standard normal distribution; the noise multiplies it.
        """
        reading = angle + self.noise_arcsec * ARCSEC * noise_draw
        if self.eccentric:
            reading += self.amplitude_arcsec * ARCSEC * sincos(angle + self.phase_deg * DEG)[0]
        count = self.count
        per_rad = 1.0 / jnp.where(count > 0, count, 1.0)
        counted = jnp.floor(reading * per_rad + 0.5) * count
        if self.straight:
            counted = straight_through(counted, reading)
        return jnp.where(count > 0, counted, reading)


def noise_draws(key: PRNGKeyArray, period: Array) -> Float[Array, "2"]:
    """Return one standard normal draw for each encoder, in the controller period number `period`.

    The draws depend on the key and the period alone.
    """
    return jax.random.normal(jax.random.fold_in(key, period), (2,))


class Observer(Part):
    """Estimator of angle, speed and acceleration that takes one reading per controller period."""

    bandwidth_hz: eqx.AbstractVar[Float[Number, ""]]

    @abstractmethod
    def step(
        self, before: MotionPoint, reading: Float[Array, ""], period: Float[Array, ""]
    ) -> MotionPoint:
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
        self, before: MotionPoint, reading: Float[Array, ""], period: Float[Array, ""]
    ) -> MotionPoint:
        """Return the estimate after the next reading (rad), one `period` (s) after the last.

        The last estimate is extrapolated at constant acceleration and corrected by the innovation.
        """
        pole = jnp.exp(-REV * self.bandwidth_hz * period)
        angle = before.angle + period * (before.speed + 0.5 * period * before.acceleration)
        speed = before.speed + period * before.acceleration
        innovation = reading - angle
        decay = 1 - pole
        return MotionPoint(
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
        self, before: MotionPoint, reading: Float[Array, ""], period: Float[Array, ""]
    ) -> MotionPoint:
        """Return the estimate after the next reading (rad), one `period` (s) after the last.

        The angle is the reading itself; the speed and the acceleration are filtered differences.
        """
        weight = 1 - jnp.exp(-REV * self.bandwidth_hz * period)
        speed = before.speed + weight * ((reading - before.angle) / period - before.speed)
        change = (speed - before.speed) / period
        return MotionPoint(
            reading, speed, before.acceleration + weight * (change - before.acceleration)
        )
