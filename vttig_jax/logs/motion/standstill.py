"""Tables of readings at standstill: one row for each place at which the shafts stood.

A calibration table, a table after ISO 230-2 or readings of a dial gauge have no motion: no speed,
ramps or crossing of the gap, and their time says only the order of the readings. The flank follows
from the direction of approach.
"""

import numpy as np
from jaxtyping import Float, Int

from ...base.units import DEG, REV
from ..channel.standstill import SAME, is_at_standstill, usual_step
from ..encoder_log import EncoderLog
from .segments import MotionPhase, Segment, Segments


def is_table(log: EncoderLog) -> bool:
    """Return whether a log holds readings at standstill."""
    clock = "time" in log.place.columns
    return is_at_standstill(log.driving.reading, log.time, clock=clock)


def still_segments(log: EncoderLog) -> Segments:
    """Return the readings of a table as segments, whose flank is that of the approach.

    The first reading, and one behind a way back to the start, was approached as the next one is.
    Of twice as many readings as usual at a place where the motion turns, half belong to each side;
    a column of directions replaces all this.
    """
    sense = _approach(log.driving.angle)
    if log.direction is not None:
        sense = log.direction.astype(np.int64)
    count = max(map(places, (log.driving.angle, float(log.ratio) * log.driving.angle)))
    ends = np.flatnonzero(np.diff(sense)) + 1
    spans = zip([0, *ends.tolist()], [*ends.tolist(), len(log)], strict=True)
    parts = [(a, b, bool(sense[a] > 0)) for a, b in spans if sense[a]]
    return Segments(
        tuple(Segment(a, b, "A" if up else "B", 0.0) for a, b, up in parts),
        tuple(MotionPhase(a, b, "forward" if up else "backward", 0.0) for a, b, up in parts),
        len(log),
        (
            f"a table of {len(log)} readings at standstill at {count} places of a turn: the flank"
            " is that of the approach, and there is no delay; if the shafts turned while it was"
            " recorded, say --running",
        ),
        crossing=0.0,
        still=True,
    )


def places(angle: Float[np.ndarray, " n"]) -> int:
    """Return the number of different places in a turn."""
    near = np.sort(np.mod(angle, REV))
    apart = np.diff(near, append=near[:1] + REV)
    return int(np.count_nonzero(apart > min(SAME * usual_step(angle), DEG)))


def _approach(angle: Float[np.ndarray, " n"]) -> Int[np.ndarray, " n"]:
    """Return the direction from which every reading was approached, ±1."""
    step, usual = np.diff(angle), usual_step(angle)
    first = np.concatenate([[0], np.flatnonzero(np.abs(step) > SAME * usual) + 1])
    size = np.diff(first, append=len(angle))
    way = np.append(np.sign(np.diff(angle[first])), 0).astype(np.int64)
    far = np.append(np.abs(np.diff(angle[first])), 0.0) > 2 * usual
    sense = np.repeat(way, size)
    for k in range(1, len(first)):
        if not (far[k - 1] and way[k] == -way[k - 1]):
            turns = way[k] == -way[k - 1] and size[k] >= 2 * np.median(size)
            own = size[k] // 2 if turns else size[k]
            sense[first[k] : first[k] + own] = way[k - 1]
    return sense
