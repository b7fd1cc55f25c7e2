"""Repeated readings of a turning shaft, caused by stalls of the logger or a lower sampling rate.

All limits below are chosen.
"""

import numpy as np
from jaxtyping import Bool, Float, Int, Real

from ...base.numerics.counting import pieces

SHORTEST = 4
"""Least number of equal successive readings of a stall."""

MARGIN = 8
"""Number of samples on either side of a stall from which its speed is taken."""

JUMP_TOLERANCE = 0.3
"""Relative tolerance between the jump after a stall and the turn of the shaft during it."""

QUANTA = 8.0
"""Least turn of the shaft during a stall, in encoder steps. To detect repeated readings, the shaft
must move at least a third of this number of steps per sample."""

REGULAR = 0.9
"""Readings repeat regularly if at least this fraction of the changes of a moving channel has the
same spacing in samples."""


def stalls(
    readings: Real[np.ndarray, " n"], time: Float[np.ndarray, " n"], quantum: float, usual: int = 1
) -> Bool[np.ndarray, " n"]:
    """Find stalls: equal readings during motion, followed by a jump that corrects the angle.

    **Arguments**
    - `readings`: unwrapped readings, shape (n,). `time`: time in s. `quantum`: step of `readings`.
    - `usual`: number of equal successive readings that is normal; up to 3 are always normal.

    **Returns** true at every repeated reading of a stall, without its first reading.
    """
    stalled = np.zeros(len(readings), bool)
    change = np.flatnonzero(np.diff(readings)) + 1
    start, stop = change[:-1], change[1:]
    inside = (
        (stop - start >= max(SHORTEST, usual + 1))
        & (start >= MARGIN)
        & (stop < len(readings) - MARGIN)
    )
    start, stop = start[inside], stop[inside]
    if len(start) == 0:
        return stalled
    before = _slope(readings, time, start - MARGIN, start)
    after = _slope(readings, time, stop, stop + MARGIN)
    turned = 0.5 * (before + after) * (time[stop] - time[start])
    jump = (readings[stop] - readings[start]).astype(np.float64)
    matching = np.abs(jump - turned) <= JUMP_TOLERANCE * np.abs(turned)
    steady = np.abs(before - after) <= np.minimum(np.abs(before), np.abs(after))
    for a, b in zip(
        *(edge[matching & steady & (np.abs(turned) > QUANTA * quantum)] for edge in (start, stop)),
        strict=True,
    ):
        stalled[a + 1 : b] = True
    return stalled


def _slope(
    readings: Real[np.ndarray, " n"],
    time: Float[np.ndarray, " n"],
    first: Int[np.ndarray, " m"],
    last: Int[np.ndarray, " m"],
) -> Float[np.ndarray, " m"]:
    elapsed = time[last] - time[first]
    rise = (readings[last] - readings[first]).astype(np.float64)
    return np.divide(rise, elapsed, out=np.zeros(len(rise)), where=elapsed > 0)


def repeats(readings: Real[np.ndarray, " n"], quantum: float) -> int:
    """Return how many samples hold the same reading during motion; 1 if every sample is new.

    Only motion of several encoder steps (`quantum`) per sample is used, and the number must be the
    same at nearly all changes of the reading.

    **Example**
    ```python
    >>> import numpy as np
    >>> from vttig_jax.logs.channel.stalls import repeats
    >>> repeats(np.repeat(np.arange(0, 50_000, 90), 2), 1.0)
    2

    ```
    """
    span = 2 * MARGIN
    if len(readings) <= 2 * span:
        return 1
    travel = readings[span:] - readings[:-span]
    np.abs(travel, out=travel)
    fast = travel > max(QUANTA / 3 * quantum * span, 0.1 * float(travel.max()))
    moving = np.zeros(len(readings), bool)
    moving[span // 2 : -span // 2] = fast
    spacing = _spacing(readings, moving)
    if len(spacing) < span:
        return 1
    usual = int(np.median(spacing))
    regular = np.count_nonzero(spacing == usual) >= REGULAR * len(spacing)
    return usual if usual > 1 and regular else 1


def _spacing(
    readings: Real[np.ndarray, " n"], moving: Bool[np.ndarray, " n"]
) -> Int[np.ndarray, " m"]:
    """Return the number of samples from each change of the reading to the next, in motion."""
    found, last = [np.zeros(0, np.int32)], np.zeros(0, np.int64)
    for part in pieces(len(readings) - 1):
        change = np.flatnonzero(np.diff(readings[part.start : part.stop + 1])) + part.start + 1
        change = np.append(last, change)
        both = moving[change[:-1]] & moving[change[1:]]
        found.append(np.diff(change)[both].astype(np.int32))
        last = change[-1:]
    return np.concatenate(found)
