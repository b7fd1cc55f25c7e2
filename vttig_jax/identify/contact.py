"""Both flanks of a fit as the encoders see them: where a reading of the driven shaft can stand."""

import equinox as eqx
from jax.typing import ArrayLike
from jaxtyping import Array, Float, Real

from ..base.errors import NoAnswerError
from ..kinematics.backlash_map import BacklashMap
from ..kinematics.flank_model import FlankModel
from ..kinematics.orders import OrderModel
from ..pair.gears import Flank
from .mapping import backlash_map
from .result import Fit


class Contact(FlankModel):
    """One flank as measured; the other a gap away from it.

    **Arguments**
    - `measured`: the fitted orders; `flank`: the flank they were measured on.
    - `gap`: a flank model whose backlash lies between the two.
    """

    ratio: Float[Array, ""]
    measured: OrderModel
    gap: FlankModel
    flank: Flank = eqx.field(static=True)

    @property
    def highest_order(self) -> float:
        """Fastest harmonic of both, in cycles per driving turn."""
        return max(self.measured.highest_order, self.gap.highest_order)

    def transmission_error(
        self, driving_angle: Real[ArrayLike, "*shape"], flank: Flank
    ) -> Float[Array, "*shape"]:
        """TE of `flank`, rad."""
        known = self.measured.transmission_error(driving_angle, self.flank)
        if flank == self.flank:
            return known
        gap = self.gap.backlash(driving_angle)
        return known + gap if flank == "B" else known - gap


def contact_map(
    fit: Fit, *, constant_backlash_deg: float | None = None
) -> tuple[BacklashMap, FlankModel]:
    """The backlash map of a fit, and the transmission errors of both flanks as the encoders see.

    With both flanks measured the model of the map is that of the flanks. With one flank it knows
    the gap, and the flank that was measured says where it lies: between encoders that read any
    angle where the other reads zero, that is far from i φ₁.

    **Arguments**
    - `fit`: the result of `fit`.
    - `constant_backlash_deg`: replaces the fitted constant backlash; needed with one flank only.

    **Raises** `NoAnswerError` where the gap cannot be known, and where the log slips.
    """
    _refuse_slip(fit)
    grid = backlash_map(fit, constant_backlash_deg=constant_backlash_deg)
    if len(fit.flanks) == 2:
        return grid, grid.model
    flank: Flank = "A" if fit.flanks[0] == "A" else "B"
    return grid, Contact(fit.model.ratio, fit.model, grid.model, flank)


def _refuse_slip(fit: Fit) -> None:
    """Refuse a drive whose shafts do not keep to its ratio: it has no hunting period."""
    for found in fit.regressors:
        if found.name == "ratio" and found.significant:
            raise NoAnswerError(
                f"the shafts turn at {found.value:.9g} and not at {fit.pair.ratio}, so that no"
                " angle comes back after a hunting period; correct the ratio of the pair file and"
                " fit again.",
                where=fit.source,
            )
