"""One log as arrays of a fixed length for a compiled fit, and a batch of several logs."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from ...base.arrays import Numbers
from ...logs.encoder_log import EncoderLog
from ...logs.motion.segments import Segment

SIDES = "AB"
"""Flanks in the order of the masks `LogArrays.on_flank`."""


class LogArrays(NamedTuple):
    """Samples of one log, padded to a common length n; a batch has a leading axis.

    **Arguments**
    - `time`: time in s. - `driving`, `driven`: shaft angles in rad. They may be wrapped (modulo one
      turn), as long as a shaft turns by less than half a turn between two samples.
    - `on_flank`: masks of the samples that are certainly on flank A and on flank B.
    - `length`: number of samples of the log; later samples are padding and have no effect.
    - `size`: samples per block row. - `delay_s`: delay of the driven channel, s; it
      counts only in a model that was prepared with a delay.
    - `last_digit`: rounding error of the transmission error, rad.
    """

    time: Float[Numbers, "*logs n"]
    driving: Float[Numbers, "*logs n"]
    driven: Float[Numbers, "*logs n"]
    on_flank: Bool[Numbers, "*logs 2 n"]
    length: Int[Numbers, "*logs"]
    size: Int[Numbers, "*logs"]
    delay_s: Float[Numbers, "*logs"]
    last_digit: Float[Numbers, "*logs"]


def arrays_of(
    log: EncoderLog, segments: Sequence[Segment], size: int, delay_s: float = 0.0
) -> LogArrays:
    """Return the arrays of a log; the masks mark the samples of `segments` on their flanks.

    `size` is the number of samples per block row. Spikes of the driving channel are replaced by
    interpolated readings, as in a single fit.
    """
    on_flank = np.zeros((2, len(log)), bool)
    for one in segments:
        on_flank[SIDES.index(one.flank), one.start : one.stop] = True
    return LogArrays(
        time=np.asarray(log.time, np.float64),
        driving=np.asarray(log.driving.steady_angle(log.time), np.float64),
        driven=np.asarray(log.driven_angle, np.float64),
        on_flank=on_flank,
        length=np.asarray(len(log)),
        size=np.asarray(size),
        delay_s=np.asarray(float(delay_s)),
        last_digit=np.asarray(float(log.rounding)),
    )


def padded(arrays: LogArrays, samples: int) -> LogArrays:
    """Return the arrays of one log padded to `samples` samples by repeating the last sample."""
    more = samples - arrays.time.shape[-1]
    channels = {
        name: np.pad(getattr(arrays, name), (0, more), "edge")
        for name in ("time", "driving", "driven")
    }
    on_flank = np.pad(arrays.on_flank, ((0, 0), (0, more)))
    return arrays._replace(**channels, on_flank=on_flank)


def empty(samples: int) -> LogArrays:
    """Return the arrays of a log of length 0, which fills an unused place of a batch."""
    zero = np.zeros(samples)
    return LogArrays(
        time=zero,
        driving=zero,
        driven=zero,
        on_flank=np.zeros((2, samples), bool),
        length=np.asarray(0),
        size=np.asarray(1),
        delay_s=np.asarray(0.0),
        last_digit=np.asarray(0.0),
    )


def stacked(logs: Sequence[LogArrays], samples: int, count: int | None = None) -> LogArrays:
    """Return a batch of logs: each is padded to `samples` samples, and the batch to `count` logs.

    Empty logs fill the batch. By default `count` is the number of logs.
    """
    full = [padded(one, samples) for one in logs]
    full += [empty(samples)] * ((len(full) if count is None else count) - len(full))
    return LogArrays(*(np.stack(parts) for parts in zip(*full, strict=True)))
