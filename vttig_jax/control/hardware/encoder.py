"""What a controller sees: counts of encoders that are mounted off centre and noisy."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from ...base.arrays import Number, float64
from ...base.numerics.sincos import sincos


class Sensor(eqx.Module):
    """An encoder, read as floor((φ + E sin(φ + ε) + noise)/count + 1/2) count.

    Its zero lies in the middle of a count, so that a shaft that stands still at a whole number of
    counts does not flicker.

    **Arguments**
    - `count`: rad; 0 for a reading that is not quantised.
    - `amplitude`, `phase`: E and ε, rad. - `noise`: standard deviation, rad.
    - `eccentric`: whether E counts at all; without it no sine is computed.
    """

    count: Float[Number, ""] = eqx.field(converter=float64)
    amplitude: Float[Number, ""] = eqx.field(converter=float64)
    phase: Float[Number, ""] = eqx.field(converter=float64)
    noise: Float[Number, ""] = eqx.field(converter=float64)
    eccentric: bool = eqx.field(static=True, default=True)

    def read(self, angle: Float[Array, ""], shock: Float[Array, ""]) -> Float[Array, ""]:
        """Reading in rad at a true angle; `shock` is a draw of the standard normal."""
        shown = angle + self.noise * shock
        if self.eccentric:
            shown += self.amplitude * sincos(angle + self.phase)[0]
        count = jnp.asarray(self.count)
        per_rad = 1.0 / jnp.where(count > 0, count, 1.0)
        return jnp.where(count > 0, jnp.floor(shown * per_rad + 0.5) * count, shown)


def shocks(key: PRNGKeyArray, period: Array) -> Float[Array, "2"]:
    """Two standard normal numbers of one period of the controller, whatever came before."""
    return jax.random.normal(jax.random.fold_in(key, period), (2,))
