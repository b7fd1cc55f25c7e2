"""Driving angles that the logs of a fit cover, and the size of the fitted error over them."""

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from itertools import pairwise

import numpy as np
from jaxtyping import Float

from ..base.units import ARCSEC, DEG, REV
from ..kinematics.flank_error import FlankError, errors_at, flank_error
from ..kinematics.flank_model import FlankModel
from ..kinematics.hunting_coverage import HuntingCoverage, hunting_coverage
from ..kinematics.te_curve import TECurve
from ..pair.gear_pair import Drive, GearPair
from ..pair.schema import Flank
from .given import FittedModel, StoredModel
from .orders import Order, exceeds_noise, is_fractional
from .records import LogRecord, LogStart

_LARGEST_TE_DEG = 0.5
"""Largest transmission error assumed in a start angle of a log, ° of the driven shaft (chosen)."""


def log_coverage(
    curves: Sequence[TECurve], logs: Sequence[LogRecord], pair: GearPair | Drive
) -> HuntingCoverage:
    """Return the driving angles of the hunting period that logs cover; `Fit.coverage` calls it.

    The curves of the first log have the zero of the map. A further log with a zero of its own has
    start angles a₁ and a₂ that are known up to whole turns of their shafts. It lies in the turn k
    of the driving shaft for which i (a₁ + 2πk) is closest to a₂ modulo 2π. Where the start angles
    are too uncertain to separate neighbouring turns, the curves of this log are not placed.

    **Example**
    ```python
    >>> import vttig_jax
    >>> from vttig_jax.rig import paper_rig
    >>> vttig_jax.enable_x64()
    >>> rig = paper_rig()
    >>> print(vttig_jax.fit(rig.log(), rig.pair).coverage)
    all 16 driving turns of the hunting period on both flanks

    ```
    """
    places = [_place(log.start, pair) for log in logs] or [0.0]
    # The time of every log starts again.
    again = [later.time[0] < earlier.time[-1] for earlier, later in pairwise(curves)]
    if curves and sum(again) + 1 == len(places):
        numbers = np.cumsum([0, *again]).tolist()
        return hunting_coverage(curves, pair, [places[number] for number in numbers])
    # It is unknown which curve belongs to which log, but logs with a common zero need no place.
    common = 0.0 if all(place == 0.0 for place in places) else None
    return hunting_coverage(curves, pair, [common] * len(curves))


def _place(start: LogStart, pair: GearPair | Drive) -> float | None:
    """Return the driving angle of the zero of a log in the hunting period, rad, or None."""
    if start.driving_deg is None or start.driven_deg is None:
        return None
    spreads = start.driving_std_deg or 0.0, start.driven_std_deg or 0.0
    if not any(spreads):  # not fitted: the zero of the first log
        return start.driving_deg * DEG
    ratio = float(pair.ratio)
    uncertain = 3 * math.hypot(ratio * spreads[0], spreads[1]) + _LARGEST_TE_DEG
    if not all(spreads) or not uncertain < 180.0 / pair.hunting_turns:
        return None
    places = start.driving_deg * DEG + np.arange(pair.hunting_turns) * REV
    distance = np.mod(ratio * places - start.driven_deg * DEG + REV / 2, REV) - REV / 2
    return float(places[np.argmin(np.abs(distance))])


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


def _error(
    model: FlankModel, flank: Flank, orders: Sequence[Order], driving: Float[np.ndarray, " n"]
) -> Float[np.ndarray, " n"]:
    """Return TE of `flank`, rad, with its fractional orders, at driving angles in rad."""
    error = errors_at(model, flank, driving)
    shafts = {"driving": driving, "driven": float(model.ratio) * driving + error}
    for one in orders:
        if is_fractional(one):
            phase = one.order * shafts[one.shaft] + one.phase_deg * DEG
            error = error + one.amplitude_arcsec * ARCSEC * np.sin(phase)
    return error
