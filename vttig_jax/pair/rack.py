"""Basic rack of both gears: how deep a tooth is, counted in modules."""

from typing import Any

import equinox as eqx
from jaxtyping import Float

from ..base.arrays import Number, float64

Scalar = Float[Number, ""]


def _known(value: Any) -> Any:
    return None if value is None else float64(value)


class Rack(eqx.Module):
    """Depths of the basic rack in multiples of the module they are counted in.

    **Arguments**
    - `addendum`: h_ap, tip of the gear above the profile reference line.
    - `clearance`: c_p, by which the root is deeper than the addendum of the mate.
    - `tip_radius`: radius of the arcs at the tip of the cutter, in the transverse plane; None for
      c_p/(1 − sin αₜ), which touches the tip line and the flank where the mate's addendum ends.
    - `depth_ratio`: the module that counts depths and profile shifts over the transverse module:
      cos β where the drawing gives the normal module, else 1.
    """

    addendum: Scalar = eqx.field(converter=float64, default=1.0)
    clearance: Scalar = eqx.field(converter=float64, default=0.25)
    tip_radius: Scalar | None = eqx.field(converter=_known, default=None)
    depth_ratio: Scalar = eqx.field(converter=float64, default=1.0)
