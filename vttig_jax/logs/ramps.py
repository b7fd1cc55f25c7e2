"""Where a run speeds up and slows down: samples whose flank is likely, but not certain."""

from dataclasses import dataclass

import numpy as np

from .encoder_log import EncoderLog
from .segments import AFTER_REVERSAL, Segment, Segments


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
