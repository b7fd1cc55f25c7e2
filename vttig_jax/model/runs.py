"""Runs of a log whose flank is known: the segments, and ramps where all segments have one speed."""

import numpy as np

from ..logs.encoder_log import EncoderLog
from ..logs.motion.flank_assignment import find_ramps
from ..logs.motion.segments import Segments
from .rows import Run

_ONE_SPEED = 0.05
_LEAST = 16


def runs_of(log: EncoderLog, segments: Segments) -> tuple[Run, ...]:
    """Return the runs [start, stop) on flank A (1) or B (−1).

    Where all segments have one speed, only the ramps tell the delay from the gap. While a shaft
    speeds up, its load presses on the flank of its motion.
    """
    found = [(s.start, s.stop, _side(s.flank)) for s in segments.segments]
    speeds = np.abs([s.speed for s in segments.segments])
    if len(speeds):
        found += [
            (ramp.segment.start, ramp.segment.stop, _side(ramp.segment.flank))
            for ramp in find_ramps(log, segments)
            if ramp.speeding_up and ramp.segment.stop - ramp.segment.start >= _LEAST
        ]
    return tuple(sorted(found))


def _side(flank: str) -> int:
    return 1 if flank == "A" else -1
