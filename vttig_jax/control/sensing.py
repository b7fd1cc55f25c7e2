"""What a controller sees: counts of encoders that are mounted off centre and noisy."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from ..base.arrays import Number, float64
from ..base.sincos import sincos


class Sensor(eqx.Module):
    """An encoder, read as floor((φ + E sin(φ + ε) + noise)/count) count.

    **Arguments**
    - `count`: rad; 0 for a reading that is not quantised.
    - `amplitude`, `phase`: E and ε, rad. - `noise`: standard deviation, rad.
    """

    count: Float[Number, ""] = eqx.field(converter=float64)
    amplitude: Float[Number, ""] = eqx.field(converter=float64)
    phase: Float[Number, ""] = eqx.field(converter=float64)
    noise: Float[Number, ""] = eqx.field(converter=float64)

    def read(self, angle: Float[Array, ""], shock: Float[Array, ""]) -> Float[Array, ""]:
        """Reading in rad at a true angle; `shock` is a draw of the standard normal."""
        sine, _ = sincos(angle + self.phase)
        shown = angle + self.amplitude * sine + self.noise * shock
        count = jnp.where(jnp.asarray(self.count) > 0, self.count, 1.0)
        return jnp.where(jnp.asarray(self.count) > 0, jnp.floor(shown / count) * count, shown)


def shocks(key: PRNGKeyArray, period: Array) -> Float[Array, "2"]:
    """Two standard normal numbers of one period of the controller, whatever came before."""
    return jax.random.normal(jax.random.fold_in(key, period), (2,))
