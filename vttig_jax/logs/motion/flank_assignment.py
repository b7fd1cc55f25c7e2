"""The flank of every segment from the torque or the motion, and the ramps between speeds.

The loaded flank follows the transmitted torque. But a motor's torque also moves its own rotor and
friction, and where there is no gap it tells nothing. Therefore both assignments are tried on a
linear model with a step between the flanks: the torque decides where its step explains the log
better.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from scipy.optimize import lsq_linear

from ...base.units import REV
from ..channel.speed import smooth_speed
from ..encoder_log import EncoderLog
from .segments import AFTER_REVERSAL, Segment, Segments, find_segments

_BETTER = 0.5
"""Share of the sum of squares that the torque may leave of what the motion leaves."""

_DISAGREEING = 0.01
_MOST_SAMPLES = 20_000


def assigned_segments(log: EncoderLog) -> Segments:
    """Certain segments, by the column that tells their flank; a note says which one."""
    by_torque = find_segments(log)
    if log.torque is None or log.direction is not None:
        return by_torque
    by_motion = find_segments(replace(log, torque=None))
    if not by_motion.segments or _torque_tells(log, by_torque, by_motion):
        return by_torque
    note = (
        "flanks assigned by the motion: the sign of the torque column tells them no better, so it"
        " counts as a regressor only"
    )
    return replace(by_motion, notes=(*by_motion.notes, note))


def _torque_tells(log: EncoderLog, by_torque: Segments, by_motion: Segments) -> bool:
    """Does a step at the sign of the torque explain more than one at the sense of motion?"""
    torque, motion = _flanks(log, by_torque), _flanks(log, by_motion)
    both = np.flatnonzero((torque != 0) & (motion != 0))
    if np.mean(torque[both] != motion[both]) < _DISAGREEING:
        return True
    place = both[:: max(1, len(both) // _MOST_SAMPLES)]
    left = [_left(log, place, flank[place]) for flank in (torque, motion)]
    return left[0] < _BETTER * left[1]


def _flanks(log: EncoderLog, found: Segments) -> Float[np.ndarray, " n"]:
    """+1 on flank A, −1 on flank B, 0 elsewhere."""
    flank = np.zeros(len(log))
    for segment in found.segments:
        flank[segment.start : segment.stop] = 1.0 if segment.flank == "A" else -1.0
    return flank


def _left(log: EncoderLog, place: np.ndarray, flank: Float[np.ndarray, " m"]) -> float:
    """Sum of squares that a gap at this flank leaves; a gap is never negative."""
    speed = smooth_speed(log.time, log.driving_angle, log.driving.resolution).value[place]
    assert log.torque is not None  # held by the caller
    columns = [np.ones(len(place)), speed, log.torque[place]]
    for angle in (log.driving_angle[place], log.driven_angle[place]):
        columns += [np.cos(angle), np.sin(angle)] if np.ptp(angle) >= REV else []
    columns.append((flank < 0).astype(np.float64))
    matrix = np.stack(columns, axis=1)
    size = np.linalg.norm(matrix, axis=0)
    size[size == 0] = 1.0
    lower = np.full(len(columns), -np.inf)
    lower[-1] = 0.0
    error = log.transmission_error[place]
    found = lsq_linear(matrix / size, error - error.mean(), bounds=(lower, np.inf))
    return 2 * float(found.cost)


@dataclass(frozen=True)
class Ramp:
    """Samples of one run beside its steady speed, on the flank of its motion if on any.

    `speeding_up` is True where the driving shaft pushes its load: there the flank is as good as
    certain. While it slows down, the inertia of the driven side may carry it to the other flank.
    """

    segment: Segment
    speeding_up: bool


def find_ramps(log: EncoderLog, found: Segments) -> tuple[Ramp, ...]:
    """Ramps before and behind the certain segments of every run, off any crossing of the gap.

    None where a column of the log, not the motion, tells the flank.
    """
    if log.torque is not None or log.direction is not None:
        return ()
    ramps = []
    for run in found.motion:
        inside = [s for s in found.segments if run.start <= s.start and s.stop <= run.stop]
        if run.kind == "dwell" or not inside:
            continue
        first, last = inside[0], inside[-1]
        angle = log.driving_angle[run.start : first.start]
        crossed = np.abs(angle - angle[0]) >= AFTER_REVERSAL if len(angle) else np.zeros(0, bool)
        begin = run.start + int(np.argmax(crossed)) if crossed.any() else first.start
        for start, stop, up in ((begin, first.start, True), (last.stop, run.stop, False)):
            if stop > start:
                ramps.append(Ramp(Segment(start, stop, first.flank, first.speed), up))
    return tuple(ramps)
