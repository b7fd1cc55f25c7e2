"""The exact relation of the eccentricities plus the harmonics of everything else."""

import jax.numpy as jnp
from jax.typing import ArrayLike
from jaxtyping import Array, Float, Real

from ..pair.gears import Flank
from .exact import ExactModel
from .fixed_point import solve_contact
from .flank_model import FlankModel
from .orders import OrderModel


class CombinedModel(FlankModel):
    """TE_f = exact TE_f + orders TE_f, both at the angles the gears really have."""

    ratio: Float[Array, ""]
    exact: ExactModel
    orders: OrderModel

    @property
    def highest_order(self) -> float:
        """Fastest harmonic of both parts, in cycles per driving turn."""
        return max(self.exact.highest_order, self.orders.highest_order)

    def transmission_error(
        self, driving_angle: Real[ArrayLike, "*shape"], flank: Flank
    ) -> Float[Array, "*shape"]:
        """TE of `flank`, rad; see the class."""
        return solve_contact(self, jnp.asarray(driving_angle, float), flank)

    def at_both_angles(
        self,
        driving_angle: Float[Array, "*shape"],
        driven_angle: Float[Array, "*shape"],
        flank: Flank,
    ) -> Float[Array, "*shape"]:
        """TE of `flank` where both shaft angles are known, rad."""
        return self.exact.at_both_angles(
            driving_angle, driven_angle, flank
        ) + self.orders.at_both_angles(driving_angle, driven_angle, flank)
