"""Encoder readings of the controller: eccentric mounting, noise and quantisation."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from ...base.arrays import Number, float64
from ...base.numerics.sincos import sincos
from ...base.numerics.straight_through import straight_through


class Sensor(eqx.Module):
    """Encoder with the reading floor((φ + E sin(φ + ε) + noise)/count + 1/2) count.

    The angle is rounded to the nearest count. The reading of a shaft that rests at a whole number
    of counts, for example at zero, is therefore not disturbed by small noise.

    **Arguments**
    - `count`: angle of one count, rad; 0 for a reading that is not quantised.
    - `amplitude`, `phase`: E and ε, rad. - `noise`: standard deviation, rad.
    - `eccentric`: whether to include E; without it no sine is computed.
    - `straight`: whether derivatives are computed as if the reading were not rounded.
    """

    count: Float[Number, ""] = eqx.field(converter=float64)
    amplitude: Float[Number, ""] = eqx.field(converter=float64)
    phase: Float[Number, ""] = eqx.field(converter=float64)
    noise: Float[Number, ""] = eqx.field(converter=float64)
    eccentric: bool = eqx.field(static=True, default=True)
    straight: bool = eqx.field(static=True, default=False)

    def read(self, angle: Float[Array, ""], noise_draw: Float[Array, ""]) -> Float[Array, ""]:
        """Return the reading (rad) at the true angle `angle` (rad).

        `noise_draw` is a draw of the standard normal distribution; `noise` multiplies it.
        """
        reading = angle + self.noise * noise_draw
        if self.eccentric:
            reading += self.amplitude * sincos(angle + self.phase)[0]
        count = jnp.asarray(self.count)
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
