"""Who decides where the driving shaft goes: its motion alone, or a motor that feels the gears."""

from abc import abstractmethod
from typing import Any, NamedTuple

import equinox as eqx
from jaxtyping import Array, Bool, Float

from .bounds import Bounds
from .motion import MotionPoint
from .plant import Plant, Shafts, Slide, Touch


class Missed(NamedTuple):
    """A driving shaft that is `astray`, rad, and whether its motor was at its limit."""

    astray: Float[Array, ""]
    limited: Bool[Array, ""]


class Drive(eqx.Module):
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
    ) -> tuple[Any, Shafts, Touch]:
        """Its state and both shafts a step of s later, and the flank met in it."""


class Prescribed(Drive):
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
    ) -> tuple[Any, Shafts, Touch]:
        """See `Drive.step`."""
        return state, *plant.step(shafts, told, slide, bounds, step)
