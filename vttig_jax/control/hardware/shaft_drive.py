"""The drive of the shaft: a prescribed motion or a motor, and the lead a controller allows."""

from abc import abstractmethod
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from ..hermite import cubic
from ..motion.motion import MotionPoint
from ..plants.flank_bounds import Bounds
from ..plants.plant import ContactEvent, Plant, Shafts, Slide


class Missed(NamedTuple):
    """A driving shaft that is `astray`, rad, and whether its motor was at its limit."""

    astray: Float[Array, ""]
    limited: Bool[Array, ""]


class ShaftDrive(eqx.Module):
    """Takes both shafts one step further, told where the driving one is to be."""

    @abstractmethod
    def start(self, told: MotionPoint) -> Any:
        """State at rest: any pytree of arrays."""

    def missed(self, state: Any, shafts: Shafts) -> "Missed | None":
        """How far the driving shaft is from where it was told to be; None for never at all."""
        return None

    @abstractmethod
    def expected(
        self, shafts: Shafts, told: MotionPoint, step: Float[Array, ""]
    ) -> Float[Array, ""]:
        """Driving angle at the end of a step of s, as well as it is known before it, rad."""

    @abstractmethod
    def step(
        self,
        state: Any,
        plant: Plant,
        shafts: Shafts,
        told: MotionPoint,
        slide: Slide,
        bounds: Bounds,
        step: Float[Array, ""],
    ) -> tuple[Any, Shafts, ContactEvent]:
        """Its state and both shafts a step of s later, and the flank met in it."""


class Prescribed(ShaftDrive):
    """The driving shaft is where it is told to be, whatever torque that takes."""

    def start(self, told: MotionPoint) -> tuple[()]:
        """No state."""
        return ()

    def expected(
        self, shafts: Shafts, told: MotionPoint, step: Float[Array, ""]
    ) -> Float[Array, ""]:
        """Where it is told to be."""
        return told.angle

    def step(
        self,
        state: Any,
        plant: Plant,
        shafts: Shafts,
        told: MotionPoint,
        slide: Slide,
        bounds: Bounds,
        step: Float[Array, ""],
    ) -> tuple[Any, Shafts, ContactEvent]:
        """See `Drive.step`."""
        return state, *plant.step(shafts, told, slide, bounds, step)


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
