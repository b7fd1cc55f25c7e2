"""The backlash map of a fit, and both flanks at the angles that the encoders read."""

import equinox as eqx
import jax.numpy as jnp
from jax.typing import ArrayLike
from jaxtyping import Array, Float, Real

from ..base.errors import NoAnswerError
from ..base.runtime import require_x64
from ..base.units import DEG
from ..kinematics.backlash_map import BacklashMap
from ..kinematics.flank_model import FlankModel
from ..kinematics.harmonic import OrderModel
from ..pair.gear_pair import Drive, Flank
from .fit_result import Fit
from .model.mounting import mounted_closed, mounted_exact, mounting_of


def backlash_map(fit: Fit, *, constant_backlash_deg: float | None = None) -> BacklashMap:
    """Backlash at every driving angle over the hunting period, from a fit.

    With both flanks measured the map is order-complete: j = TE_B − TE_A with every fitted order of
    each flank, which needs no split into gear and encoder errors. With one flank the other follows
    from the eccentricities through the exact relation, as in the paper, once the constant backlash
    is given. The closed form (21) + (22) stands beside it as `first_order`. In both, e₂ stands at
    φ₂ + θ₂ with φ₂ = i φ₁ + offset as the driven encoder reads it: far from i φ₁ where the encoders
    are absolute, and off it by the TE of the start where they count from the first sample.

    **Arguments**
    - `fit`: the result of `fit`.
    - `constant_backlash_deg`: replaces the fitted constant backlash; needed with one flank only.

    **Raises** `NoAnswerError` where the gap cannot be known.

    **Example**
    ```python
    >>> import numpy as np, vttig_jax
    >>> from vttig_jax.rig import paper_rig
    >>> vttig_jax.enable_x64()
    >>> rig = paper_rig()
    >>> grid = vttig_jax.backlash_map(vttig_jax.fit(rig.log(), rig.pair))
    >>> round(float(np.degrees(grid.at(np.radians(7560.0)))), 3)
    0.045

    ```
    """
    require_x64("backlash_map")
    both = len(fit.flanks) == 2
    _refuse_unknown_gap(fit, given=not both and constant_backlash_deg is not None)
    if isinstance(fit.pair, Drive):
        if not both:
            raise NoAnswerError(
                "one flank of a drive without gear geometry says nothing about the other; record"
                " both directions.",
                where=fit.source,
            )
        return BacklashMap(_shifted(fit, constant_backlash_deg), None, fit.pair)
    for shaft in () if both else ("driving", "driven"):
        eccentricity = fit.parameters[f"{shaft}_eccentricity_mm"]
        if not eccentricity.determined:
            raise NoAnswerError(
                f"one flank says nothing about the other, because {eccentricity.name} is"
                f" undetermined ({eccentricity.reason}); record both directions.",
                where=fit.source,
            )
    rig = fit.eccentricities(constant_backlash_deg)
    gap_rad = float(rig.constant_backlash_deg) * DEG
    mounting = mounting_of(fit.covariance_names, fit.values, fit.flanks, gap_rad)
    first_order = mounted_closed(fit.pair, rig, mounting)
    if both:
        return BacklashMap(_shifted(fit, constant_backlash_deg), first_order, fit.pair)
    return BacklashMap(mounted_exact(fit.pair, rig, mounting), first_order, fit.pair)


def _refuse_unknown_gap(fit: Fit, *, given: bool) -> None:
    gap = fit.parameters["constant_backlash_deg"]
    if gap.determined or given:
        return
    cure = "record more turns."
    if len(fit.flanks) != 2:
        cure = (
            "record both directions, or give the constant backlash measured in another way"
            " (--constant-backlash-deg)."
        )
    raise NoAnswerError(
        f"the constant backlash is undetermined ({gap.reason}); {cure}", where=fit.source
    )


def _shifted(fit: Fit, constant_backlash_deg: float | None) -> FlankModel:
    """The fitted model with flank B moved from the fitted constant backlash to the one given."""
    if constant_backlash_deg is None:
        return fit.model
    move = constant_backlash_deg - fit.value("constant_backlash_deg")
    offset = fit.model.offset + jnp.array([0.0, move * DEG])
    return eqx.tree_at(lambda model: model.offset, fit.model, offset)


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
