"""How far a controller lets the driving shaft run ahead of its motion, between two periods."""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from .cubic import cubic
from .motion import MotionPoint


class Lead(NamedTuple):
    """By how much the shaft is to be ahead, rad, and how fast that grows, rad/s."""

    angle: Float[Array, ""]
    speed: Float[Array, ""]


def no_lead() -> Lead:
    """The motion itself."""
    return Lead(jnp.zeros(()), jnp.zeros(()))


def next_lead(lead: Lead, advance: Float[Array, ""], period: Float[Array, ""]) -> Lead:
    """The lead a period later: what was asked for, growing as fast as it grew in that period."""
    return Lead(advance, (advance - lead.angle) / period)


def led(
    point: MotionPoint,
    before: Lead,
    after: Lead,
    share: Float[Array, ""] | float,
    period: Float[Array, ""],
) -> MotionPoint:
    """A point of the motion with the lead at a share of the period, on the cubic between both."""
    share = jnp.asarray(share)
    way = cubic(before.angle, after.angle, before.speed, after.speed, period)
    rate = 1.0 / period
    return MotionPoint(
        point.angle + way.at(share),
        point.speed + way.slope(share) * rate,
        point.acceleration + way.bend(share) * rate**2,
    )
