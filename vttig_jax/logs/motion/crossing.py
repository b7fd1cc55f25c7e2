"""Gap by the travel that the teeth need to cross it after a reversal.

At one speed a gap and a delay of the driven channel leave the same step between the flanks. They
differ after a reversal: the driven shaft stands still until the driving shaft has turned by the gap
divided by the ratio, while the step of a delay follows the speed. Let s be the travel of the
driving shaft since the reversal, i the ratio and g the gap. The transmission error then contains

    g · min(i s / g, 1) on the way to flank B,  g · (1 − min(i s / g, 1)) on the way to flank A.

g has the least sum of squares beside a delay. It is a gap if the likelihood is enough larger than
that of a delay alone.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from ...base.numerics.well_conditioned import orthonormal_basis
from ...base.units import REV
from ..encoder_log import EncoderLog
from .flank_step import EVIDENCE, LEAST, columns_of
from .segments import AFTER_REVERSAL, MotionPhase, Segments

_MOST = 2000  # largest number of samples that are compared (chosen)
_TRIALS = 60  # number of trial values of the gap, at equal ratios (chosen)
_SHARES = 0.5, 0.9
"""Longest crossing, as a share of the median travel between two reversals; the second share is for
strokes of less than `_SHORT_STROKE`, rad, in which no gap is seen below the first (all chosen)."""

_SHORT_STROKE = 2 * REV


def crossed_gap(log: EncoderLog, by_motion: Segments) -> float:
    """Return the gap in rad of the driven shaft by its crossings, or 0 without evidence for one.

    It is also 0 if no crossing is longer than `AFTER_REVERSAL`, which is always masked.

    Before the first reversal the place of the teeth is unknown, so that the first part of this
    travel is left out.

    **Arguments**
    - `by_motion`: segments with flanks by the direction of motion.
    """
    moving = [phase for phase in by_motion.motion if phase.kind != "dwell"]
    turns = _reversals(moving)
    if not turns:
        return 0.0
    angle = log.driving_angle
    rows, leg, sense = _rows(moving, turns)
    origin = angle[[moving[0].start, *(moving[k].start for k in turns)]]
    samples = _Samples(rows, sense, np.abs(angle[rows] - origin[leg]), leg > 0)
    stroke = float(np.median(np.abs(np.diff([*origin, angle[moving[-1].stop - 1]]))))
    shares = _SHARES if stroke < _SHORT_STROKE else _SHARES[:1]
    gap = 0.0
    for share in shares:
        gap = _seen(log, samples, share * stroke)
        if 0 < gap < share * stroke * float(log.ratio):
            break  # a longer crossing would be seen at the limit
    return gap


class _Samples(NamedTuple):
    """Samples in motion: their numbers, direction ±1, travel in rad since the start of their leg.

    `turned` is False before the first reversal.
    """

    rows: Int[np.ndarray, " m"]
    sense: Int[np.ndarray, " m"]
    travel: Float[np.ndarray, " m"]
    turned: Bool[np.ndarray, " m"]


def _seen(log: EncoderLog, samples: _Samples, longest: float) -> float:
    """Return the gap whose crossing takes up to the travel `longest`, rad; 0 without evidence."""
    ratio = float(log.ratio)
    rows, sense, travel, turned = samples
    known = ~log.spikes[rows] & (turned | (travel > longest))
    rows, travel, sense = rows[known], travel[known], sense[known]
    if len(rows) < LEAST or longest <= AFTER_REVERSAL or len(np.unique(sense)) < 2:
        return 0.0
    basis = orthonormal_basis(columns_of(log, rows, log.driving_speed.value[rows]), 1e-9)

    def squares(values: Float[np.ndarray, " m"]) -> float:
        rest = values - basis @ (basis.T @ values)
        return float(rest @ rest)

    error = log.transmission_error[rows] - np.mean(log.transmission_error[rows])
    trials = ratio * np.geomspace(AFTER_REVERSAL, longest, _TRIALS)
    found = []
    for gap in trials:
        left = np.minimum(ratio * travel, gap)
        found.append(squares(error - np.where(sense > 0, gap - left, left)))
    best = int(np.argmin(found))
    evidence = len(rows) * np.log(max(squares(error), 1e-300) / max(found[best], 1e-300))
    return float(trials[best]) if best > 0 and evidence >= EVIDENCE else 0.0


def _reversals(moving: list[MotionPhase]) -> list[int]:
    """Return the indices of the phases `moving` whose direction differs from the one before."""
    return [k for k in range(1, len(moving)) if moving[k].kind != moving[k - 1].kind]


def _rows(
    moving: list[MotionPhase], turns: list[int]
) -> tuple[Int[np.ndarray, " m"], Int[np.ndarray, " m"], Int[np.ndarray, " m"]]:
    """Return evenly spaced samples in motion, their leg, and their direction of motion, ±1.

    A leg is the motion between two reversals, counted from 0.
    """
    start, stop = np.array([(phase.start, phase.stop) for phase in moving]).T
    before = np.concatenate([[0], np.cumsum(stop - start)])
    place = np.arange(0, before[-1], max(1, -(-int(before[-1]) // _MOST)))
    phase = np.searchsorted(before, place, side="right") - 1
    leg = np.searchsorted(turns, phase, side="right")
    sense = np.array([1 if one.kind == "forward" else -1 for one in moving])
    return start[phase] + place - before[phase], leg, sense[phase]
