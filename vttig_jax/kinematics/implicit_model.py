"""Flank models that relate both shaft angles: the transmission error is their fixed point."""

from abc import abstractmethod

import jax.numpy as jnp
from jax.typing import ArrayLike
from jaxtyping import Array, Float, Real

from ..pair.gears import Flank
from .fixed_point import fixed_point
from .flank_model import FlankModel, flank_index


class ImplicitModel(FlankModel):
    """A relation TE = f(φ₁, φ₂) in contact, with φ₂ = i φ₁ + TE on its right-hand side."""

    @abstractmethod
    def at_both_angles(
        self,
        driving_angle: Float[Array, "*shape"],
        driven_angle: Float[Array, "*shape"],
        flank: Flank,
    ) -> Float[Array, "*shape"]:
        """TE of `flank` where both shaft angles are known, rad."""

    def transmission_error(
        self, driving_angle: Real[ArrayLike, "*shape"], flank: Flank
    ) -> Float[Array, "*shape"]:
        """TE of `flank`, rad: the solution of TE = f(φ₁, i φ₁ + TE)."""
        angle = jnp.asarray(driving_angle, float)
        return fixed_point(_STEPS[flank_index(flank)], (self, angle))


def _step_on(flank: Flank):
    def step(error, args):
        model, angle = args
        return model.at_both_angles(angle, model.ratio * angle + error, flank)

    return step


_STEPS = (_step_on("A"), _step_on("B"))
