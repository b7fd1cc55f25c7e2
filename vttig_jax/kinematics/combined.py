"""The exact relation of the eccentricities plus the harmonics of everything else."""

from jaxtyping import Array, Float

from ..pair.gears import Flank
from .exact import ExactModel
from .implicit_model import ImplicitModel
from .orders import OrderModel


class CombinedModel(ImplicitModel):
    """TE_f = exact TE_f + orders TE_f, both at the angles the gears really have."""

    ratio: Float[Array, ""]
    exact: ExactModel
    orders: OrderModel

    @property
    def highest_order(self) -> float:
        """Fastest harmonic of both parts, in cycles per driving turn."""
        return max(self.exact.highest_order, self.orders.highest_order)

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
