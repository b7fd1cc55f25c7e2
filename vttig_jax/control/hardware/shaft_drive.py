"""Drives of the driving shaft: the base class, a prescribed motion, and the feedforward lead."""

from abc import abstractmethod
from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from ...kinematics.flank_table import Bounds
from ..hermite import cubic
from ..motion.motion import MotionPoint
from ..plants.plant import ContactEvent, Plant, Shafts, Slide


class Tracking(eqx.Module):
    """Tracking `error` of the driving shaft, rad, and whether the motor torque was `limited`."""

    error: Float[Array, ""]
    limited: Bool[Array, ""]


class ShaftDrive(eqx.Module):
    """Base class of drives, which compute the motion of both shafts in one plant step.

    The target is the point of the motion that the driving shaft should reach at the end.
    """

    @abstractmethod
    def start(self, target: MotionPoint) -> Any:
        """Return the initial state of the drive, at rest at `target`: any pytree of arrays."""

    def tracking(self, state: Any, shafts: Shafts) -> "Tracking | None":
        """Return the tracking error; None for a drive that follows its target exactly."""
        return None

    @abstractmethod
    def expected(
        self, shafts: Shafts, target: MotionPoint, step: Float[Array, ""]
    ) -> Float[Array, ""]:
        """Return the predicted driving angle (rad) at the end of a time step (s)."""

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
        """Return drive state and both shafts after a time step (s), and the contact event in it.

        - `state`, `shafts`: at the start. - `target`: goal of the driving shaft at the end.
        - `slide`: axial displacement during the step.
        """


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
    """Angle by which the driving shaft leads its prescribed motion, rad, and its rate, rad/s."""

    angle: Float[Array, ""]
    speed: Float[Array, ""]


def no_lead() -> Lead:
    """Return a lead of zero with the rate zero."""
    return Lead(jnp.zeros(()), jnp.zeros(()))


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
