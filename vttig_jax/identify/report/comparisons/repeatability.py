"""Repeatability of a log: comparison of its passes, and of first and second halves of passes."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from ....base.errors import NoAnswerError
from ....base.threads import one_blas_thread
from ....base.units import ARCSEC, DEG, REV
from ....kinematics.te_curve import TECurve
from ...compress.block_rows import BlockRun, LogRows
from ...compress.harmonic_summary import FLANKS
from ...model.harmonics import TermPlan
from ...model.identifiability import FULL_TURN
from ...preliminary.alignment import Start
from ..checks import HalfDifference, PassDifference
from .same_rig import Phasors, first_orders

_LEAST_OVERLAP = 10 * DEG  # rad; chosen value


def passes(curves: Sequence[TECurve], log: int = 1) -> list[PassDifference]:
    """Return the differences of the transmission error between consecutive passes of each flank.

    There is one entry (later minus earlier pass, in degrees) for each two consecutive passes whose
    driving angles overlap by at least 10°. `log` is the number of the log.
    """
    found = []
    for flank in FLANKS:
        own = [curve for curve in curves if curve.flank == flank and len(curve) > 1]
        for number, (before, after) in enumerate(pairwise(own), 1):
            (x, y), (u, v) = _ordered(before), _ordered(after)
            inside = (u >= x[0]) & (u <= x[-1])
            if not inside.any() or np.ptp(u[inside]) < _LEAST_OVERLAP:
                continue
            difference = (v[inside] - np.interp(u[inside], x, y)) / DEG
            found.append(
                PassDifference(
                    log=log,
                    flank=flank,
                    passes=(number, number + 1),
                    overlap_deg=float(np.ptp(u[inside])) / DEG,
                    mean_deg=float(difference.mean()),
                    rms_deg=float(np.sqrt(np.mean(difference**2))),
                    scatter_deg=float(difference.std()),
                )
            )
    return found


@one_blas_thread
def halves(rows: LogRows, terms: TermPlan, log: int = 1) -> list[HalfDifference]:
    """Compare the first orders of the first halves of all passes with those of the second halves.

    The list is empty if half a log is too short to determine the first orders. A shaft that makes
    less than a turn in one of the halves on a flank is left out there, because its first order then
    looks like offset and drift, and so is an order that is unknown by more than a turn. `log` is
    the number of the log.
    """
    turns = max((float(np.ptp(run.curve.driving_angle)) / REV for run in rows.runs), default=0.0)
    apart = abs(1 - terms.ratio)
    if turns / 2 < max(1.0, 1 / float(apart) if apart else 1.0):
        return []
    first, second = (_half(rows, late=late) for late in (False, True))
    try:
        one, other = (first_orders(half, terms, Start()) for half in (first, second))
    except NoAnswerError:
        return []
    return [
        _compared(log, key, one, other)
        for key in one
        if key in other
        and all(_determines(half, key, terms) for half in (first, second))
        and max(one[key][1], other[key][1]) < REV
    ]


def _determines(rows: LogRows, key: tuple[str, str], terms: TermPlan) -> bool:
    """Return whether a shaft makes a full turn on a flank; `key` is (shaft, flank)."""
    shaft, flank = key
    angles = [run.curve.driving_angle for run in rows.runs if run.segment.flank == flank]
    turns = float(np.ptp(np.concatenate(angles))) / REV
    return turns * (1.0 if shaft == "driving" else abs(float(terms.ratio))) >= FULL_TURN


def _compared(log: int, key: tuple[str, str], one: Phasors, other: Phasors) -> HalfDifference:
    (first, first_std), (second, second_std) = one[key], other[key]
    return HalfDifference(
        log=log,
        shaft=key[0],
        flank=key[1],
        first_arcsec=float(abs(first)) / ARCSEC,
        second_arcsec=float(abs(second)) / ARCSEC,
        difference_arcsec=float(abs(second - first)) / ARCSEC,
        std_arcsec=float(np.hypot(first_std, second_std)) / ARCSEC,
    )


def _half(rows: LogRows, *, late: bool) -> LogRows:
    """Return the first or the second half of every run."""
    runs = []
    for run in rows.runs:
        middle = len(run.rows) // 2
        part = slice(middle, None) if late else slice(middle)
        given = None if run.given is None else run.given[part]
        runs.append(BlockRun(run.segment, run.rows[part], run.curve.part(part), given))
    return replace(rows, runs=tuple(runs))


def _ordered(curve: TECurve) -> tuple[np.ndarray, np.ndarray]:
    order = np.argsort(curve.driving_angle)
    return curve.driving_angle[order], curve.transmission_error[order]
