"""Search for periodic lines of unknown period in a log before a fit."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from ...base.numerics.counting import whole_below
from ...base.units import REV
from ..encoder_log import EncoderLog
from ..motion.segments import Segment
from .rows import highest_resolved
from .search import Line, Stretch, find_lines

HIGHEST = 12.0
"""Highest frequency of the search in cycles per driving revolution (chosen)."""

_FASTEST = 0.9
"""Quantile of the driving angle per sample; the highest frequency is limited so that a cycle has at
least `_ALIAS` steps of this size (chosen)."""

_ALIAS, _ROWS_PER_CYCLE = 3.0, 5.0  # least samples, and averaged rows, per cycle of `highest`
_LEAST_ROWS, _MOST = 20, 5  # least averaged rows of a stretch, largest number of lines (chosen)


def blind_lines(log: EncoderLog, segments: Sequence[Segment]) -> tuple[Line, ...]:
    """Return significant lines of the transmission error in the segments, most significant first.

    The regressors of each flank are an offset, time, its square, speed and torque. Therefore drift
    or a delay between the channels is not detected as a line.
    """
    if not segments:
        return ()
    angle = log.driving.steady_angle(log.time)
    usable = ~log.spikes
    speed = log.smooth_speed(angle)
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
        rows = np.arange(segment.start, segment.stop)
        rows = rows[usable[rows]]
        rows = rows[: len(rows) // size * size]
        if len(rows) < _LEAST_ROWS * size:
            continue
        means = [channel[rows].reshape(-1, size).mean(axis=1) for channel in channels]
        runs.append(Stretch(means[0], means[1], np.stack(means[2:], axis=1), segment.flank))
    highest = min(highest, highest_resolved(runs)) if runs else 0.0
    return find_lines(runs, highest=highest, most=_MOST) if highest >= 1 else ()


def _scaled(values: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    size = float(np.abs(values).max())
    return values / size if size > 0 else values
