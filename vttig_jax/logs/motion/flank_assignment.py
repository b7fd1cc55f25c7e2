"""Assignment of a flank to every segment by torque or motion, and the ramps between speeds.

The sign of the transmitted torque defines the loaded flank. However, the torque of a motor also
accelerates its rotor and overcomes friction, and in a drive without backlash it says nothing about
flanks. Therefore torque and direction of motion are both tested in a linear model with a step
between the flanks; the torque is used if it fits better.
"""

from bisect import bisect_right
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from ...base.units import DEG, REV
from ..encoder_log import EncoderLog
from .crossing import crossed_gap
from .flank_step import seen_gap
from .overrun import overrunning_segments
from .segments import AFTER_REVERSAL, Segment, Segments, find_segments
from .standstill import is_table, still_segments

_BETTER = 0.5
"""The torque is used if the residual sum of squares with its flanks is below this fraction of that
with the flanks of the motion (chosen)."""

_GAPS = (2.0, 1.5, 1.2)
"""Travel after a reversal that is masked, as a multiple of the mean gap (chosen). It exceeds 1
because the gap varies along the teeth. The smaller numbers are for strokes that are too short for
the larger ones."""

_LEAST_GAPS = 1.1
"""Travel that is masked in strokes that are too short for all of `_GAPS`, as a multiple of the gap
(chosen). It exceeds 1 because the crossing is found among trial values."""

_WIDER = 1.05
"""The travel that is masked is widened only by more than this factor (chosen)."""

_DISAGREEING = 0.01
_MOST_SAMPLES = 20_000
"""Torque and motion are compared if their flanks differ at least at this fraction of samples. The
comparison uses at most about `_MOST_SAMPLES` samples (both chosen)."""


def assigned_segments(log: EncoderLog, *, still: bool | None = None) -> Segments:
    """Return segments whose flanks come from the direction column, the torque or the motion.

    The direction column has priority; the torque must fit better than the motion. A note names the
    choice. `still`: whether the log is a table of readings at standstill; by default the log says.
    """
    if is_table(log) if still is None else still:
        return still_segments(log)
    by_torque = find_segments(log)
    if log.direction is not None:
        return by_torque
    if log.torque is None:
        return _by_motion(log, by_torque)
    by_motion = find_segments(replace(log, torque=None))
    if not by_motion.segments or _torque_fits_better(log, by_torque, by_motion):
        return by_torque
    note = (
        "flanks assigned by the motion: the sign of the torque column does not tell them better,"
        " so the column is only a regressor"
    )
    return replace(by_motion, notes=(*by_motion.notes, note))


def _by_motion(log: EncoderLog, found: Segments) -> Segments:
    """Return segments with flanks by the direction of motion, or those of an overrunning load.

    `found` holds segments by the motion. The start of each run is masked until the driving shaft
    has crossed the gap that the log shows.
    """
    crossed = crossed_gap(log, found)
    plain, found = found, _beyond(log, found, max(crossed, seen_gap(log, found)))
    if crossed > 0.0 and found is plain and float(log.ratio) * plain.crossing < crossed:
        return _shorter_than_the_gap(log, crossed)
    if crossed > 0.0 and found is not plain:
        # The crossings show that the step is no delay, so that behind them it is the gap.
        gap = seen_gap(log, found, delayed=False)
        found = _beyond(log, plain, gap) if gap > 0.0 else found
        found = _beyond(log, found, seen_gap(log, found, delayed=False))
    if found.crossing > AFTER_REVERSAL:
        note = (
            f"the first {found.crossing / DEG:.2g}° of the driving shaft after a reversal are left"
            " out, because the teeth cross the gap there"
        )
        found = replace(found, notes=(*found.notes, note))
    return overrunning_segments(log, found, found.crossing) or found


def _shorter_than_the_gap(log: EncoderLog, crossed: float) -> Segments:
    """Return the few segments behind the crossings of strokes that are hardly longer than these."""
    crossing = crossed / float(log.ratio)
    found = find_segments(log, _LEAST_GAPS * crossing)
    unclear = (
        f"the teeth need {crossing / DEG:.2g}° of the driving shaft to cross the gap after a"
        " reversal, and on a flank all strokes are too short to show it behind the crossing; log"
        " longer strokes"
    )
    return replace(found, notes=(*found.notes, unclear), unclear=unclear)


def _beyond(log: EncoderLog, found: Segments, gap: float) -> Segments:
    """Return `found` with up to `_GAPS` times the gap left out after reversals, if this is more.

    A flank is not given up: if the runs on it are shorter, `found` stays as it is.
    """
    for gaps in _GAPS:
        crossing = gaps * gap / float(log.ratio)
        if crossing <= _WIDER * found.crossing:
            break
        beyond = find_segments(log, crossing)
        if _flanks_of(beyond) == _flanks_of(found):
            return beyond
    return found


def _flanks_of(found: Segments) -> set[str]:
    return {segment.flank for segment in found.segments}


def _torque_fits_better(log: EncoderLog, by_torque: Segments, by_motion: Segments) -> bool:
    """Return whether flanks by the torque explain the transmission error better than by the motion.

    Both models have a step between the flanks. If both assignments nearly agree, return True.
    """
    torque, motion = _flanks(log, by_torque), _flanks(log, by_motion)
    both = np.flatnonzero((torque != 0) & (motion != 0))
    if np.mean(torque[both] != motion[both]) < _DISAGREEING:
        return True
    rows = both[:: max(1, len(both) // _MOST_SAMPLES)]
    torque_misfit, motion_misfit = (_misfit(log, rows, flank[rows]) for flank in (torque, motion))
    return torque_misfit < _BETTER * motion_misfit


def _flanks(log: EncoderLog, segments: Segments) -> Float[np.ndarray, " n"]:
    """Return +1 on flank A, −1 on flank B and 0 elsewhere for every sample."""
    flank = np.zeros(len(log))
    for segment in segments.segments:
        flank[segment.start : segment.stop] = 1.0 if segment.flank == "A" else -1.0
    return flank


def _misfit(log: EncoderLog, rows: np.ndarray, flank: Float[np.ndarray, " m"]) -> float:
    """Return the residual sum of squares of a linear model of the transmission error at `rows`.

    The model has an offset, speed, torque, first orders, and a backlash ≥ 0 between the flanks.
    `flank` is +1 on flank A and −1 on flank B.
    """
    speed = log.driving_speed.value[rows]
    assert log.torque is not None  # checked by the caller
    columns = [np.ones(len(rows)), speed, log.torque[rows]]
    for angle in (log.driving_angle[rows], log.driven_angle[rows]):
        columns += [np.cos(angle), np.sin(angle)] if np.ptp(angle) >= REV else []
    columns.append((flank < 0).astype(np.float64))
    matrix = np.stack(columns, axis=1)
    size = np.linalg.norm(matrix, axis=0)
    size[size == 0] = 1.0
    matrix, error = matrix / size, log.transmission_error[rows]
    error = error - error.mean()
    solution = np.linalg.lstsq(matrix, error)[0]
    if solution[-1] < 0:
        matrix = matrix[:, :-1]
        solution = np.linalg.lstsq(matrix, error)[0]
    return float(np.sum((error - matrix @ solution) ** 2))


@dataclass(frozen=True)
class Ramp:
    """Samples of a run before or after its steady speed, with the flank by the direction of motion.

    While the driving shaft accelerates its load (`speeding_up`), the flank is nearly certain. While
    it slows down, the inertia of the driven side may move the contact to the other flank.
    """

    segment: Segment
    speeding_up: bool


def find_ramps(log: EncoderLog, segments: Segments) -> tuple[Ramp, ...]:
    """Return the ramps before and after the segments of every run, without crossings of the gap.

    If a torque or direction column of the log defines the flank, no ramps are returned.
    """
    if log.torque is not None or log.direction is not None:
        return ()
    ramps = []
    for run in segments.motion:
        inside = [s for s in segments.segments if run.start <= s.start and s.stop <= run.stop]
        if run.kind == "dwell" or not inside:
            continue
        first, last = inside[0], inside[-1]
        begun = bisect_right(segments.starts, run.start) - 1
        origin = log.driving_angle[segments.starts[begun] if begun >= 0 else run.start]
        crossed = np.abs(log.driving_angle[run.start : first.start] - origin) >= segments.crossing
        begin = run.start + int(np.argmax(crossed)) if crossed.any() else first.start
        for start, stop, up in ((begin, first.start, True), (last.stop, run.stop, False)):
            if stop > start:
                ramps.append(Ramp(Segment(start, stop, first.flank, first.speed), up))
    return tuple(ramps)
