"""Size of the fitted transmission error over the angles that the logs covered."""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from jaxtyping import Float

from ..base.units import ARCSEC, DEG
from ..kinematics.flank_error import FlankError, errors_at, flank_error
from ..kinematics.flank_model import FlankModel
from ..kinematics.hunting_coverage import HuntingCoverage
from ..pair.gear_pair import Flank
from .model.fitted_model import FittedModel, StoredModel
from .report.order_table import Order, exceeds_noise, is_fractional

Angles = Float[np.ndarray, " n"]


def covered_errors(
    model: FlankModel, orders: Sequence[Order], coverage: HuntingCoverage
) -> dict[Flank, FlankError]:
    """Return the size of the transmission error of each covered flank over the covered angles.

    Fractional `orders` are added to `model`, with the phases of the first log. A `StoredModel`
    has the sizes that its fit has stored.
    """
    if isinstance(model, StoredModel):
        return dict(model.errors)
    highest = max([model.highest_order, *(float(one.order) for one in orders)])
    found: dict[Flank, FlankError] = {}
    for flank, spans in coverage.spans.items():
        own = [one for one in orders if one.flank == flank]
        size = flank_error(partial(_error, model, flank, own), spans, highest)
        significant = isinstance(model, FittedModel) or exceeds_noise(own)
        found[flank] = replace(size, significant=significant)
    return found


def _error(model: FlankModel, flank: Flank, orders: Sequence[Order], driving: Angles) -> Angles:
    """Return TE of `flank`, rad, with its fractional orders, at driving angles in rad."""
    error = errors_at(model, flank, driving)
    shafts = {"driving": driving, "driven": float(model.ratio) * driving + error}
    for one in orders:
        if is_fractional(one):
            phase = one.order * shafts[one.shaft] + one.phase_deg * DEG
            error = error + one.amplitude_arcsec * ARCSEC * np.sin(phase)
    return error
