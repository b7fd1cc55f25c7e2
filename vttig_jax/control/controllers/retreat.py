"""What a controller knows of its actuator: how far it can open the gap again while teeth pass."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...base.arrays import Number, Numbers, float64


class Retreat(eqx.Module):
    """How far the actuator can open the gap again while teeth pass.

    A tooth pitch of the map is looked at, or less if the actuator needs less time for its swing.

    **Arguments**
    - `speed`, `acceleration`: limits of the actuator, mm/s and mm/s². - `pitch`: tooth pitch, rad.
    - `swing`: largest change of the closing displacement within a pitch, mm.
    - `gaps`: gap and step · its slope at the nodes of the map, rad.
    - `points`: number of points at which the gap is looked at.
    """

    speed: Float[Number, ""] = eqx.field(converter=float64)
    acceleration: Float[Number, ""] = eqx.field(converter=float64)
    pitch: Float[Number, ""] = eqx.field(converter=float64)
    swing: Float[Number, ""] = eqx.field(converter=float64)
    gaps: Float[Numbers, "rows 2"]
    points: int = eqx.field(static=True)

    def pause(self, speed: Float[Array, ""]) -> Float[Array, ""]:
        """Return the time between two points, s, for a driving speed (rad/s)."""
        v, a, swing = map(jnp.asarray, (self.speed, self.acceleration, self.swing))
        swing = jnp.maximum(swing, np.finfo(float).tiny)  # the root has no derivative at 0
        move = jnp.where(swing < v**2 / a, 2 * jnp.sqrt(swing / a), v / a + swing / v)
        return jnp.minimum(self.pitch / speed, 2 * move) / self.points

    def distance(self, time: Float[Array, ""]) -> Float[Array, ""]:
        """Return by how far the actuator can move and be back after a time (s), mm.

        Both ways go from standstill to standstill, each in half of the time.
        """
        v, a, half = jnp.asarray(self.speed), jnp.asarray(self.acceleration), 0.5 * time
        return jnp.where(half < 2 * v / a, 0.25 * a * half**2, v * (half - v / a))
