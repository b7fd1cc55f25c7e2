"""How far a flank recedes along the axis: the tangential modification of one flank."""

from typing import Protocol, runtime_checkable

import equinox as eqx
from jaxtyping import Float

from ..base.arrays import Number, Numbers, float64

Scalar = Float[Number, ""]


@runtime_checkable
class Recession(Protocol):
    """Any smooth function of z: by how much a flank recedes at the reference circle.

    The tangential modification of the paper is x_t(z) = −(δ_left(z) + δ_right(z))/m. Written over
    arrays, so that it can be jitted and differentiated.
    """

    def __call__(self, z: Float[Numbers, "*shape"]) -> Float[Number, "*shape"]:
        """δ(z) in mm, positive where the tooth is thinner than in the middle of the face."""
        ...


class Taper(eqx.Module):
    """Linear and crowned: δ(z) = z tan β + c (2 z/b)².

    **Arguments**
    - `slope`: tan β, positive where the flank thins the tooth towards +z.
    - `crowning_mm`: c, by which the flank recedes at either end of the face.
    - `face_width_mm`: b; matters only beside a crowning.
    """

    slope: Scalar = eqx.field(converter=float64)
    crowning_mm: Scalar = eqx.field(converter=float64, default=0.0)
    face_width_mm: Scalar = eqx.field(converter=float64, default=1.0)

    def __call__(self, z: Float[Numbers, "*shape"]) -> Float[Number, "*shape"]:
        """δ(z) in mm."""
        return z * self.slope + self.crowning_mm * (2 * z / self.face_width_mm) ** 2
