"""Deviations of the driving shaft from its motion: tracking of a servo, and feedforward lead."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from ..hermite import cubic
from ..motion.motion import MotionPoint


class Tracking(eqx.Module):
    """Tracking `error` of the driving shaft, rad, and whether the motor torque was `limited`."""

    error: Float[Array, ""]
    limited: Bool[Array, ""]


class Lead(eqx.Module):
    """Angle by which the driving shaft leads its prescribed motion, rad, and its rate, rad/s."""

    angle: Float[Array, ""]
    speed: Float[Array, ""]


def next_lead(lead: Lead, advance: Float[Array, ""], period: Float[Array, ""]) -> Lead:
    """Return the lead at the end of the next period (s).

    Its angle is the commanded `advance` (rad); its rate is the mean rate over the period.
    """
    return Lead(advance, (advance - lead.angle) / period)


def led(
    point: MotionPoint,
    before: Lead,
    after: Lead,
    share: Float[Array, ""] | float,
    period: Float[Array, ""],
) -> MotionPoint:
    """Return the motion `point` plus the lead at the elapsed fraction `share` of a period (s).

    The lead is a cubic from `before` at the start to `after` at the end of the period.
    """
    share = jnp.asarray(share)
    lead = cubic(before.angle, after.angle, before.speed, after.speed, period)
    rate = 1.0 / period
    return MotionPoint(
        point.angle + lead.at(share),
        point.speed + lead.slope(share) * rate,
        point.acceleration + lead.bend(share) * rate**2,
    )
