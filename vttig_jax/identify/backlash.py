"""Backlash map of a fit, and flank models in the angles that the encoders read."""

import equinox as eqx
import jax.numpy as jnp
from jax.typing import ArrayLike
from jaxtyping import Array, Float, Real

from ..base.arrays import Numbers
from ..base.errors import NoAnswerError
from ..base.runtime import require_x64
from ..base.units import DEG
from ..kinematics.backlash_map import BacklashMap
from ..kinematics.flank_model import FlankModel, GridOrders
from ..kinematics.harmonic import OrderModel
from ..pair.gear_pair import Eccentricities, GearPair
from ..pair.schema import Flank
from .given import StoredModel
from .orders import mounted_closed, mounted_exact
from .result import Fit, refuse_unknown_gap


def backlash_map(fit: Fit, *, constant_backlash_deg: float | None = None) -> BacklashMap:
    """Return the backlash over the hunting period from a fit.

    If both flanks were measured, the map is order-complete: j = TE_B − TE_A contains every fitted
    order of each flank, and the gear errors need not be separated from the encoder errors. If one
    flank was measured, the other follows from the eccentricities by the exact relation, as in the
    paper; this requires the constant backlash. `first_order` of the map is the closed form
    (21) + (22). In the exact relation and in the closed form, the angle of e₂ is φ₂ + θ₂, where
    φ₂ = i φ₁ + offset is the angle that the driven encoder reads. This φ₂ is far from i φ₁ if the
    encoders are absolute. It differs from i φ₁ by the TE of the start if the encoders count from
    the first sample. `coverage` of the map is the part of the hunting period that the logs covered.

    **Arguments**
    - `fit`: result of `fit`.
    - `constant_backlash_deg`: replaces the fitted constant backlash; required with one flank only.

    **Raises** `NoAnswerError` if the backlash cannot be determined.

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
    if not isinstance(fit, Fit):
        raise ValueError(
            f"Argument `fit` must be a Fit, but is a {type(fit).__name__}; draws of a posterior"
            " have a map with bands, `vttig_jax.band_map(posterior)`."
        )
    if isinstance(fit.given, StoredModel):
        fit.given.refuse(fit.source)
    both = len(fit.flanks) == 2
    given = constant_backlash_deg is not None
    if both or not given:
        refuse_unknown_gap(fit)
    relation = isinstance(fit.pair, GearPair) and fit.given is None
    rig = fit.eccentricities(constant_backlash_deg) if relation else None
    if both:
        return map_of(fit, _shifted(fit, constant_backlash_deg), rig, given=given)
    if rig is None or not isinstance(fit.pair, GearPair):
        what = "drive without gear geometry" if fit.given is None else "given flank model"
        raise NoAnswerError(
            f"one flank of a {what} says nothing about the other; record both directions.",
            where=fit.source,
        )
    for shaft in ("driving", "driven"):
        eccentricity = fit.parameters[f"{shaft}_eccentricity_mm"]
        if not eccentricity.determined:
            raise NoAnswerError(
                f"one flank says nothing about the other, because {eccentricity.name} is"
                f" undetermined ({eccentricity.reason}); record both directions.",
                where=fit.source,
            )
    mounting = fit.mounting(float(rig.constant_backlash_deg) * DEG)
    return map_of(fit, mounted_exact(fit.pair, rig, mounting), rig, given=given)


def map_of(
    fit: Fit, model: FlankModel, rig: Eccentricities | None, *, given: bool = False
) -> BacklashMap:
    """Return the map of a flank model of a fit, with the closed form of a rig beside it.

    It has the angles that the logs covered, states why there is no hunting period, if the fitted
    ratio is not that of the pair, and why its extremes are not known. They are, without the
    interval of an unknown delay, if the constant backlash is `given`.
    """
    first = None
    if rig is not None and isinstance(fit.pair, GearPair):
        mounting = fit.mounting(float(rig.constant_backlash_deg) * DEG)
        first = mounted_closed(fit.pair, rig, mounting)
    shift = None if given else shift_of_delay(fit)
    unknown = None if given else unknown_extremes(fit)
    return BacklashMap(model, first, fit.pair, fit.coverage, no_period(fit), shift, unknown)


def shift_of_delay(fit: Fit) -> tuple[float, float] | None:
    """Return the 95 % interval of the shift of the map, rad, where the logs do not tell the delay.

    The interval of the gap is then that of the assumed delay.
    """
    gap = fit.checks.gap_over_angles_covered
    open_delay = any(one.slug == "delay-open" for one in fit.findings)
    if not open_delay or gap.value is None or gap.low95 is None or gap.high95 is None:
        return None
    return (gap.low95 - gap.value) * DEG, (gap.high95 - gap.value) * DEG


def _shifted(fit: Fit, constant_backlash_deg: float | None) -> FlankModel:
    """Return the fitted model with flank B shifted to the given constant backlash."""
    if constant_backlash_deg is None:
        return fit.flank_model
    # The constant backlash also where the log tells only the gap of some angles.
    fitted = fit.values[fit.covariance_names.index("constant_backlash")]
    offset = fit.model.offset + jnp.array([0.0, constant_backlash_deg * DEG - fitted])
    orders = eqx.tree_at(lambda model: model.offset, fit.model, offset)
    if fit.given is None:
        return orders
    return eqx.tree_at(lambda model: model.orders, fit.given, orders)


class Contact(FlankModel):
    """Flank model of a measured flank; the other flank follows from a known backlash.

    **Arguments**
    - `measured`, `flank`: fitted orders of the measured flank, and that flank.
    - `gap`: flank model from which only the backlash, TE_B − TE_A, is used.
    """

    ratio: Float[Numbers, ""]
    measured: OrderModel
    gap: FlankModel
    flank: Flank = eqx.field(static=True)

    @property
    def grid_orders(self) -> GridOrders:
        """Orders of `measured` and `gap`."""
        return *self.measured.grid_orders, *self.gap.grid_orders

    def transmission_error(
        self, driving_angle: Real[ArrayLike, "*shape"], flank: Flank
    ) -> Float[Array, "*shape"]:
        """Return TE of `flank`, rad."""
        known = self.measured.transmission_error(driving_angle, self.flank)
        if flank == self.flank:
            return known
        gap = self.gap.backlash(driving_angle)
        return known + gap if flank == "B" else known - gap


def contact_map(
    fit: Fit, *, constant_backlash_deg: float | None = None
) -> tuple[BacklashMap, FlankModel]:
    """Return the backlash map of a fit, and a flank model in the angles that the encoders read.

    If both flanks were measured, the flank model is the model of the map. If one flank was
    measured, the map gives the distance between the flanks, and the measured flank gives their
    position. If the encoders do not read zero at the same position, the flanks are far from i φ₁.

    **Arguments**
    - `fit`: result of `fit`.
    - `constant_backlash_deg`: replaces the fitted constant backlash; required with one flank only.

    **Raises** `NoAnswerError` if the backlash cannot be determined, and if the log shows slip.
    """
    if reason := no_period(fit):
        raise NoAnswerError(f"{reason}.", where=fit.source)
    grid = backlash_map(fit, constant_backlash_deg=constant_backlash_deg)
    if len(fit.flanks) == 2:
        return grid, grid.model
    flank: Flank = "A" if fit.flanks[0] == "A" else "B"
    return grid, Contact(fit.model.ratio, fit.model, grid.model, flank)


def no_period(fit: Fit) -> str | None:
    """Return why the fitted drive has no hunting period, or None.

    This is so if the fitted ratio differs from that of the pair.
    """
    for found in fit.regressors:
        if found.name == "ratio" and found.significant:
            return (
                f"the shafts turn at {found.value:.9g} and not at {fit.pair.ratio}, so that no"
                " angle comes back after a hunting period; correct the ratio of the pair file and"
                " fit again"
            )
    return None


def unknown_extremes(fit: Fit) -> str | None:
    """Return why the extremes of the gap over the hunting period are not known, or None."""
    gap = fit.parameters["constant_backlash_deg"]
    if gap.determined or len(fit.flanks) < 2:
        return None
    covered = fit.checks.gap_over_angles_covered.in_words
    return f"not known: {gap.reason}; the mean over the angles covered is {covered}"
