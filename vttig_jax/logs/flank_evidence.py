"""Which column tells the flank of a log with a torque channel: the torque, or the motion.

The loaded flank follows the transmitted torque. But a motor's torque also moves its own rotor and
friction, and where there is no gap it tells nothing. So both assignments are tried on a linear
model with a step between the flanks: the torque decides where its step explains the log better.
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Float
from scipy.optimize import lsq_linear

from ..base.units import REV
from .encoder_log import EncoderLog
from .segments import Segments, find_segments
from .speed import smooth_speed

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
