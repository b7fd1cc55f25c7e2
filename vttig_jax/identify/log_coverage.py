"""Part of the hunting period that the logs of a fit cover."""

import math
from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from ..base.units import DEG, REV
from ..kinematics.hunting_coverage import HuntingCoverage, hunting_coverage
from ..kinematics.te_curve import TECurve
from ..pair.gear_pair import Drive, GearPair
from .report.per_log import LogRecord, LogStart

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
    numbers = _log_numbers(curves)
    if numbers and numbers[-1] + 1 == len(places):
        return hunting_coverage(curves, pair, [places[number] for number in numbers])
    # It is unknown which curve belongs to which log, but logs with a common zero need no place.
    common = 0.0 if all(place == 0.0 for place in places) else None
    return hunting_coverage(curves, pair, [common] * len(curves))


def _log_numbers(curves: Sequence[TECurve]) -> list[int]:
    """Return the number of the log of each curve, from 0: the time of every log starts again."""
    again = [later.time[0] < earlier.time[-1] for earlier, later in pairwise(curves)]
    return np.cumsum([0, *again]).tolist() if curves else []


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
