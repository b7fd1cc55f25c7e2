"""Runs of a log with a known flank, and ramps whose flank the fit decides."""

from ..logs.encoder_log import EncoderLog
from ..logs.motion.flank_assignment import find_ramps
from ..logs.motion.segments import Segments
from .rows import Run, Shafts

_LEAST = 16
"""Fewest samples of a ramp: the smoothed speed does not follow shorter ones."""


def shafts_of(log: EncoderLog, segments: Segments) -> Shafts:
    """Return a log as the model sees it.

    The runs are the segments and the ramps on which a shaft speeds up: its load presses on the
    flank of its motion. On ramps that slow down the driven shaft may overrun; they are `ramps`, of
    which the fit keeps those that stay on their flank. Ramps tell the delay from the gap.
    """
    runs = [(s.start, s.stop, _side(s.flank)) for s in segments.segments]
    slowing: list[Run] = []
    for ramp in find_ramps(log, segments):
        part = ramp.segment
        if part.stop - part.start >= _LEAST:
            chosen = runs if ramp.speeding_up else slowing
            chosen.append((part.start, part.stop, _side(part.flank)))
    return Shafts.of(log, runs, slowing)


def _side(flank: str) -> int:
    return 1 if flank == "A" else -1
