"""Encoder readings of the controller: eccentric mounting, noise and quantisation."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from ...base.arrays import Number
from ...base.numerics.sincos import sincos
from ...base.numerics.straight_through import straight_through
from ...base.units import ARCSEC, DEG, REV
from ..fields import Part, Quantity, number


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
