"""The law of a positioning motor: a position loop around a speed loop with a torque limit."""

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from ..base.arrays import Number, float64


class Motor(NamedTuple):
    """What the servo keeps.

    - `angle`, `speed`: where it was last told to be, rad and rad/s. - `wound`: ∫ of the error, rad.
    - `limited`: it was at its torque limit.
    """

    angle: Float[Array, ""]
    speed: Float[Array, ""]
    wound: Float[Array, ""]
    limited: Bool[Array, ""]


class Servo(eqx.Module):
    """A cascade that is sampled once in every step of the plant and holds its torque in between.

        e = ω_ref + k_v (φ_ref − φ₁) − ω₁,  T = clip(k_p e + k_i ∫e dt, ±T_max)

    It measures its own shaft without error. Where the limit cuts the torque the integral stands
    still, unless the error unwinds it.

    **Arguments**
    - `speed_gain`: k_p, N m s/rad. - `integral_gain`: k_i, N m/rad. - `position_gain`: k_v, 1/s.
    - `torque_limit`: T_max, N m.
    """

    speed_gain: Float[Number, ""] = eqx.field(converter=float64)
    integral_gain: Float[Number, ""] = eqx.field(converter=float64)
    position_gain: Float[Number, ""] = eqx.field(converter=float64)
    torque_limit: Float[Number, ""] = eqx.field(converter=float64)

    def torque(
        self,
        motor: Motor,
        angle: Float[Array, ""],
        speed: Float[Array, ""],
        step: Float[Array, ""],
    ) -> tuple[Float[Array, ""], Motor]:
        """N m for a step of s of a shaft at an angle and a speed, and what is kept of it."""
        error = motor.speed + self.position_gain * (motor.angle - angle) - speed
        wound = motor.wound + step * error
        asked = self.speed_gain * error + self.integral_gain * wound
        torque = jnp.clip(asked, -self.torque_limit, self.torque_limit)
        limited = torque != asked
        wound = jnp.where(limited & (error * asked >= 0), motor.wound, wound)
        return torque, motor._replace(wound=wound, limited=limited)
