"""Periodic lines of a log before anything is fitted: periods nobody needs to know beforehand."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from ...base.numerics.counting import whole_below
from ...base.units import REV
from ..channel.speed import smooth_speed
from ..encoder_log import EncoderLog
from ..motion.segments import Segment
from .search import Line, Stretch, find_lines

HIGHEST = 12.0
"""Cycles per driving revolution up to which `inspect` looks."""

_FASTEST = 0.9
"""Share of the samples that are slower than what decides how fast a line can be."""

_ALIAS, _ROWS_PER_CYCLE = 3.0, 5.0
_LEAST_ROWS = 20
_MOST = 5


def blind_lines(log: EncoderLog, segments: Sequence[Segment]) -> tuple[Line, ...]:
    """Significant lines of the transmission error on the certain flanks, the clearest first.

    An offset of each flank, time and its square, speed and torque stand beside every trial line, so
    that neither drift nor a delay between the channels passes for one.
    """
    if not segments:
        return ()
    angle = log.driving.steady_angle(log.time)
    usable = ~log.spikes
    speed = smooth_speed(log.time, angle, log.driving.resolution)
    steps = np.concatenate([np.abs(np.diff(angle[s.start : s.stop])) for s in segments])
    per_turn = REV / max(float(np.quantile(steps, _FASTEST)), 1e-12)
    highest = min(HIGHEST, per_turn / _ALIAS)
    size = max(1, whole_below(per_turn / (_ROWS_PER_CYCLE * highest)))
    time = (log.time - log.time.mean()) / max(float(np.ptp(log.time)), 1e-300)
    columns = [np.ones(len(log)), time, time**2, _scaled(speed.value)]
    if log.torque is not None:
        columns.append(_scaled(log.torque))
    channels = [angle, log.transmission_error, *columns]
    runs = []
    for segment in segments:
        place = np.arange(segment.start, segment.stop)
        place = place[usable[place]]
        place = place[: len(place) // size * size]
        if len(place) < _LEAST_ROWS * size:
            continue
        means = [channel[place].reshape(-1, size).mean(axis=1) for channel in channels]
        runs.append(Stretch(means[0], means[1], np.stack(means[2:], axis=1), segment.flank))
    return find_lines(runs, highest=highest, most=_MOST) if runs and highest >= 1 else ()


def _scaled(values: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    size = float(np.abs(values).max())
    return values / size if size > 0 else values
