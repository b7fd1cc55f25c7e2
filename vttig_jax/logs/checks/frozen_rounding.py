"""Constant part of the rounding error of the readings in a run, which averaging does not remove.

Readings with the step s have rounding errors of the total variance s²/12. If a shaft turns by a
whole number of steps per sample, or by a simple fraction of a step, the errors repeat, and a part
of them is constant in the run. A run at nearly constant speed shows this part: the scatter of the
readings about a straight line averages out, and the rest of s²/12 is the variance of the constant.
If the true angles of the samples have only R equidistant places within a step, the scatter is
(1 − 1/R²) s²/12. If the motion or the noise deviates from the line by a step or more, the errors
vary and no constant part remains.

The constants of two runs are independent, unless the shaft moves by whole steps per sample from one
run to the other, ramps included, as in a computed trajectory. Then the angles of both runs have the
same place within a step, and the same error, which only shifts the zero of the angle.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int, Real

from ...base.numerics.counting import pieces
from ..channel.channel import Channel
from ..channel.steps import are_multiples, common_step
from ..encoder_log import EncoderLog
from ..motion.segments import Segment

_LEAST_SHARE = 0.01
"""Constants with a smaller share of s²/12 are not distinguishable from the scatter; the limit is
that of R = 10 places (chosen)."""

_FEWEST = 8  # least number of samples of a run to estimate its scatter; chosen value
_OF_ROUNDING = 1 / 6  # variance of the difference of two rounded readings, in squared steps
_PART = 0.5  # assumed offset of the two clocks as a fraction of a sample interval; chosen value
_FEWEST_OF_RAMP = 4  # least number of equal changes of the advance per sample in a ramp (chosen)
_LEAST_JUMP = 4  # steps; a smaller change of the advance may come from rounding; chosen value
_PIECE = 65_536  # samples whose differences are formed at once; chosen value
_LEAST_STEPS = 1.5  # least steps per sample; slower motion does not show the encoder step (chosen)


@dataclass(frozen=True, eq=False)
class FrozenRounding:
    """Constant rounding errors of the runs of a log, rad driven angle.

    **Arguments**
    - `stds`: for each run, standard deviation of the error that is independent of other runs.
    - `shared`: for each run, standard deviation of the error that all runs have in common; one row
      for each shaft that moves from run to run by whole steps per sample.
    """

    stds: Float[np.ndarray, " runs"]
    shared: Float[np.ndarray, "shafts runs"]


def frozen_rounding(log: EncoderLog, segments: Sequence[Segment]) -> FrozenRounding:
    """Return the standard deviations of the constant rounding errors of the runs.

    They are 0 for a log that gives the transmission error in place of the driven channel (TE-curve
    log), because its angles are positions and not rounded readings.

    **Arguments**
    - `segments`: runs at nearly constant speed.
    """
    own, shared = np.zeros(len(segments)), np.zeros((0, len(segments)))
    if log.driven is None or len(segments) == 0:
        return FrozenRounding(own, shared)
    channels = (log.driving, log.driven)
    two_clocks = any(channel.step for channel in channels)
    share_of = frozen_share_between_clocks if two_clocks else frozen_share
    for place, gain in enumerate((float(log.ratio), 1.0)):
        channel = channels[place]
        step = _step(channel, channels[1 - place])
        if step == 0:
            continue
        runs = [channel.reading[one.start : one.stop] for one in segments]
        shares = np.array([share_of(run, step) for run in runs])
        stds = gain * abs(channel.radians_per_unit) * step * np.sqrt(shares / 12)
        span = slice(min(one.start for one in segments), max(one.stop for one in segments))
        if not two_clocks and moves_by_whole_steps(channel.reading[span], step):
            shared = np.vstack([shared, stds])
        else:
            own = np.hypot(own, stds)
    return FrozenRounding(own, shared)


def moves_by_whole_steps(readings: Real[np.ndarray, " n"], step: float = 1.0) -> bool:
    """Return whether all readings have the same place within a step, whatever the place is.

    This is assumed if every change of speed is one jump from sample to sample, or a ramp in which
    the advance per sample grows by the same whole number of steps each time. A ramp may have one
    other value at each of its ends. A motor or a hand does not move so exactly. Motion at constant
    speed gives False, because it does not show how exactly the speed would change.

    **Arguments**
    - `readings`: readings in any unit. - `step`: step of the readings in this unit.

    **Example**
    ```python
    >>> import numpy as np
    >>> from vttig_jax.logs.checks.frozen_rounding import moves_by_whole_steps
    >>> advance = np.repeat([45, -45, 30, -30], 100)
    >>> moves_by_whole_steps(np.cumsum(advance)), moves_by_whole_steps(np.cumsum(advance[:100]))
    (True, False)

    ```
    """
    long, still, little = _parts_of_equal_growth(readings, step)
    if np.all(still):
        return False
    # The parts between two steady parts are one change of speed. A steady part adds to no count.
    changes = np.union1d([0], np.flatnonzero(long & still))
    ramps, others, small = (
        np.add.reduceat(part, changes, dtype=np.int32)
        for part in (long & ~still, ~long, ~long & little)
    )
    return not np.any(small[ramps == 0]) and bool(np.all(others <= ramps + 1))


def _parts_of_equal_growth(
    readings: Real[np.ndarray, " n"], step: float
) -> Bool[np.ndarray, "3 parts"]:
    """Divide a motion into parts in which the advance per sample grows equally each time.

    **Returns** for every part whether it is as long as a ramp, whether the growth is zero, and
    whether it is smaller than a jump. The readings are treated piece by piece, because a part may
    be as short as a sample and the differences would need several times the memory of the log.
    """
    count, found = len(readings) - 2, []
    starts, values = np.zeros(0, np.int64), np.zeros(0)  # of the part that is not complete yet
    for first in range(0, count, _PIECE):
        piece = readings[first : first + _PIECE + 2]
        growth = np.diff(piece / step if step != 1 else piece, 2)
        if growth.dtype.kind == "f":
            np.rint(growth, out=growth)
        begins = np.flatnonzero(np.concatenate([[True], growth[1:] != growth[:-1]]))
        if len(values) and growth[0] == values[-1]:
            begins = begins[1:]
        starts = np.append(starts, first + begins)
        values = np.append(values, growth[begins])
        found.append(_seen(np.diff(starts), values[:-1]))
        starts, values = starts[-1:], values[-1:]
    return np.concatenate([*found, _seen(count - starts, values)], axis=1)


def _seen(
    lengths: Int[np.ndarray, " n"], growth: Real[np.ndarray, " n"]
) -> Bool[np.ndarray, "3 n"]:
    return np.stack([lengths >= _FEWEST_OF_RAMP, growth == 0, np.abs(growth) < _LEAST_JUMP])


def _step(channel: Channel, other: Channel) -> float:
    """Return the step of the readings of `channel` in their unit, or 0 if it is unknown.

    Readings with equal advance per sample do not show their step. Then the step of the `other`
    channel is used if the readings are multiples of it, as encoders of one rig are often alike.
    """
    if channel.step or channel.reading.dtype.kind in "iu":
        return channel.step or 1.0
    own = common_step(channel.reading)
    if own > 0:
        return own
    whole = other.reading.dtype.kind in "iu"
    alike = other.step or (1.0 if whole else common_step(other.reading))
    alike *= abs(other.radians_per_unit / channel.radians_per_unit)
    return alike if are_multiples(channel.reading, alike) else 0.0


def frozen_share_between_clocks(readings: Real[np.ndarray, " n"], step: float = 1.0) -> float:
    """Return the share of the variance of a second rounding that is constant in a run.

    A program that interpolates whole counts to its own clock adds a part of the advance per sample
    and rounds a second time. At constant speed the advance is nearly equal in all samples, so that
    this rounding error is constant at any speed. It averages out if the advance changes by a step.
    The readings do not show whether a program did this. `readings` are interpolated readings with
    the step `step`.
    """
    if len(readings) < _FEWEST:
        return 0.0
    change = max(float(np.var(np.diff(readings) / step)) - _OF_ROUNDING, 0.0)
    share = 1 - 12 * _PART**2 * change
    return share if share > _LEAST_SHARE else 0.0


def frozen_share(readings: Real[np.ndarray, " n"], step: float = 1.0) -> float:
    """Return the share of the rounding variance s²/12 that is constant in a run.

    `readings` are rounded to the step s = `step`. For motion of about one step per sample the share
    is 0, because the found step may be only the travel per sample.

    **Example**
    ```python
    >>> import numpy as np
    >>> from vttig_jax.logs.checks.frozen_rounding import frozen_share
    >>> steps = [np.rint(each * np.arange(400) + 0.1) for each in (45.0, 45.5, 45.1234)]
    >>> [round(frozen_share(one), 2) for one in steps]
    [1.0, 0.25, 0.0]

    ```
    """
    count, first = len(readings), readings[0]
    if count < _FEWEST or abs(readings[-1] - first) < _LEAST_STEPS * (count - 1) * step:
        return 0.0
    middle = float(np.mean(readings - first)) / step

    def centred(part: slice) -> Float[np.ndarray, " m"]:
        return (readings[part] - first) / step - middle

    def place(part: slice) -> Float[np.ndarray, " m"]:
        return np.arange(part.start, part.stop) * (2 / (count - 1)) - 1

    parts = list(pieces(count))
    squares = sum(float(place(part) @ place(part)) for part in parts)
    slope = sum(float(place(part) @ centred(part)) for part in parts) / squares
    scatter = sum(float(np.sum((centred(part) - slope * place(part)) ** 2)) for part in parts)
    share = 1 - 12 * scatter / (count - 2)
    return share if share > max(_LEAST_SHARE, 8 / count) else 0.0
