"""Runs of a log with a known flank, and ramps whose flank the fit decides."""

from itertools import pairwise

import numpy as np

from ..logs.encoder_log import EncoderLog
from ..logs.motion.flank_assignment import find_ramps
from ..logs.motion.segments import Segments
from .rows import Run, Shafts

_LEAST = 16
"""Fewest samples of a ramp: the smoothed speed does not follow shorter ones."""


def shafts_of(log: EncoderLog, segments: Segments) -> Shafts:
    """Return a log as the model sees it.

    The runs are the segments and the ramps on which a shaft speeds up: its load presses on the
    flank of its motion. On ramps that slow down, and between two speeds, the driven shaft may
    overrun; they are `ramps`, of which the fit keeps those that stay on their flank. Ramps tell the
    delay from the gap.
    """
    if segments.still:
        return _still(log, segments)
    runs = [(s.start, s.stop, _side(s.flank)) for s in segments.segments]
    slowing: list[Run] = []
    blurred = log.driving_speed.window // 2  # there the smoothed speed spans the standstill
    for ramp in find_ramps(log, segments):
        start, stop = ramp.segment.start, ramp.segment.stop
        start, stop = (start + blurred, stop) if ramp.speeding_up else (start, stop - blurred)
        if stop - start >= _LEAST:
            chosen = runs if ramp.speeding_up else slowing
            chosen.append((start, stop, _side(ramp.segment.flank)))
    for first, second in pairwise(segments.segments):
        between = slice(first.stop, second.start)
        same = first.flank == second.flank and first.speed * second.speed > 0
        inside = any(m.start <= first.start and second.stop <= m.stop for m in segments.motion)
        if same and inside and between.stop - between.start > 0:
            slowing.append((between.start, between.stop, _side(first.flank)))
    return Shafts.of(log, runs, slowing)


def _still(log: EncoderLog, segments: Segments) -> Shafts:
    """Return a table of readings at standstill, with all those of a flank in one run.

    They have no speed, and no noise that goes on from one to the next.
    """
    own = {side: [s for s in segments.segments if _side(s.flank) == side] for side in (1, -1)}
    index = [np.arange(s.start, s.stop) for side in (1, -1) for s in own[side]]
    count = sum(s.stop - s.start for s in own[1])
    order = np.concatenate([np.arange(0), *index])
    runs = [(0, count, 1)] * (count > 0) + [(count, len(order), -1)] * (count < len(order))
    driving, error = log.driving_angle[order], log.transmission_error[order]
    ratio, speed = float(log.ratio), np.zeros(len(order))
    # Over one turn a first order has a slope of its own, which is no error of the ratio.
    phase = np.outer(ratio * driving, np.arange(1, 5))
    columns = np.column_stack([driving, np.ones(len(order)), np.cos(phase), np.sin(phase)])
    slope, level = np.linalg.lstsq(columns, error, rcond=1e-6)[0][:2]
    return Shafts(
        log.time[order],
        driving,
        error,
        speed,
        speed,
        ratio,
        log.interval_s,
        tuple(runs),
        (),
        (ratio + float(slope), float(level)),
        log.driving.resolution,
        None if log.torque is None else log.torque[order],
        still=True,
    )


def _side(flank: str) -> int:
    return 1 if flank == "A" else -1
