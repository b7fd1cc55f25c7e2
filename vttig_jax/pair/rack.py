"""Basic rack of both gears, with tooth depths in modules."""

from typing import Any

import equinox as eqx
from jaxtyping import Float

from ..base.arrays import Number, float64, written

Scalar = Float[Number, ""]


def _optional_float64(value: Any) -> Any:
    return None if value is None else float64(value)


class Rack(eqx.Module):
    """Basic rack with depths in multiples of a module, normal or transverse.

    **Arguments**
    - `addendum`: addendum h_ap, the height of the gear tip above the profile reference line.
    - `clearance`: bottom clearance c_p, the depth of the root below the tip of the mating gear.
    - `tip_radius`: radius of the arcs at the tip of the cutter, in the transverse plane. None means
      c_p/(1 − sin αₜ), the arc tangent to the tip line and to the flank at the mating addendum.
    - `depth_ratio`: the module of depths and profile shifts divided by the transverse module:
      cos β if the normal module is given, else 1.
    """

    addendum: Scalar = eqx.field(converter=float64, default=1.0)
    clearance: Scalar = eqx.field(converter=float64, default=0.25)
    tip_radius: Scalar | None = eqx.field(converter=_optional_float64, default=None)
    depth_ratio: Scalar = eqx.field(converter=float64, default=1.0)

    __repr__ = written
