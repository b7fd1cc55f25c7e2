"""Drives of the driving shaft: the base class, a prescribed motion, and the feedforward lead."""

from abc import abstractmethod
from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from ..hermite import cubic
from ..motion.motion import MotionPoint
from ..plants.flank_bounds import Bounds
from ..plants.plant import ContactEvent, Plant, Shafts, Slide


class Tracking(eqx.Module):
    """Tracking `error` of the driving shaft, rad, and whether its torque was `limited`."""

    error: Float[Array, ""]
    limited: Bool[Array, ""]


class ShaftDrive(eqx.Module):
    """Drive that moves both shafts one step, given the target of the driving shaft."""

    @abstractmethod
    def start(self, target: MotionPoint) -> Any:
        """Return the state at rest: any pytree of arrays."""

    def tracking(self, state: Any, shafts: Shafts) -> "Tracking | None":
        """Return the tracking error; None for a drive that has none by definition."""
        return None

    @abstractmethod
    def expected(
        self, shafts: Shafts, target: MotionPoint, step: Float[Array, ""]
    ) -> Float[Array, ""]:
        """Predict the driving angle (rad) at the end of a step (s)."""

    @abstractmethod
    def step(
        self,
        state: Any,
        plant: Plant,
        shafts: Shafts,
        target: MotionPoint,
        slide: Slide,
        bounds: Bounds,
        step: Float[Array, ""],
    ) -> tuple[Any, Shafts, ContactEvent]:
        """Return the drive's state and both shafts after a step (s), and its contact event."""


class Prescribed(ShaftDrive):
    """Drive with unlimited torque: the driving shaft is always at its target."""

    def start(self, target: MotionPoint) -> tuple[()]:
        """Return the empty state."""
        return ()

    def expected(
        self, shafts: Shafts, target: MotionPoint, step: Float[Array, ""]
    ) -> Float[Array, ""]:
        """Return the target angle, rad."""
        return target.angle

    def step(
        self,
        state: Any,
        plant: Plant,
        shafts: Shafts,
        target: MotionPoint,
        slide: Slide,
        bounds: Bounds,
        step: Float[Array, ""],
    ) -> tuple[Any, Shafts, ContactEvent]:
        """See `ShaftDrive.step`."""
        return state, *plant.step(shafts, target, slide, bounds, step)


class Lead(eqx.Module):
    """Feedforward lead of the driving shaft on its motion, rad, and the rate of the lead, rad/s."""

    angle: Float[Array, ""]
    speed: Float[Array, ""]


def no_lead() -> Lead:
    """Return the zero lead."""
    return Lead(jnp.zeros(()), jnp.zeros(()))


def next_lead(lead: Lead, advance: Float[Array, ""], period: Float[Array, ""]) -> Lead:
    """Return the next lead: the commanded `advance` (rad) and its mean rate over the period (s)."""
    return Lead(advance, (advance - lead.angle) / period)


def led(
    point: MotionPoint,
    before: Lead,
    after: Lead,
    share: Float[Array, ""] | float,
    period: Float[Array, ""],
) -> MotionPoint:
    """Add the lead, a cubic from `before` to `after`, to `point` at a share of the period (s)."""
    share = jnp.asarray(share)
    lead = cubic(before.angle, after.angle, before.speed, after.speed, period)
    rate = 1.0 / period
    return MotionPoint(
        point.angle + lead.at(share),
        point.speed + lead.slope(share) * rate,
        point.acceleration + lead.bend(share) * rate**2,
    )
