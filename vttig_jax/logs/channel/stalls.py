"""Readings that repeat while the shaft turns: a stall of the logger, or a slower sampling."""

import numpy as np
from jaxtyping import Bool, Float, Int, Real

LEAST = 4
"""Equal readings that make a stall."""

BESIDE = 8
"""Samples on either side over which the motion beside a stall is taken."""

MADE_UP = 0.3
"""Share by which the jump after a stall may miss what the shaft turned meanwhile."""

QUANTA = 8.0
"""Steps of the encoder that the shaft must turn by to tell a stall; a third of it a sample for
repeated readings."""

REPEATED = 0.9
"""Share of the changes of a moving channel that come every n-th sample where n is its rate."""


def stalls(
    readings: Real[np.ndarray, " n"], time: Float[np.ndarray, " n"], quantum: float, usual: int = 1
) -> Bool[np.ndarray, " n"]:
    """Readings held while the shaft went on turning, and made up for by the next.

    **Arguments**
    - `readings`: unwrapped, shape (n,). `time`: s. `quantum`: step of the readings.
    - `usual`: so many equal readings are no stall; at least 3 are none.

    **Returns** true at every held reading but the first of its stall.
    """
    late = np.zeros(len(readings), bool)
    change = np.flatnonzero(np.diff(readings)) + 1
    start, stop = change[:-1], change[1:]
    inside = (
        (stop - start >= max(LEAST, usual + 1))
        & (start >= BESIDE)
        & (stop < len(readings) - BESIDE)
    )
    start, stop = start[inside], stop[inside]
    if len(start) == 0:
        return late
    before = _slope(readings, time, start - BESIDE, start)
    after = _slope(readings, time, stop, stop + BESIDE)
    turned = 0.5 * (before + after) * (time[stop] - time[start])
    jump = (readings[stop] - readings[start]).astype(np.float64)
    made_up = np.abs(jump - turned) <= MADE_UP * np.abs(turned)
    steady = np.abs(before - after) <= np.minimum(np.abs(before), np.abs(after))
    for a, b in zip(
        *(edge[made_up & steady & (np.abs(turned) > QUANTA * quantum)] for edge in (start, stop)),
        strict=True,
    ):
        late[a + 1 : b] = True
    return late


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
    """How many times each reading repeats while the shaft moves: 1 for a channel read every sample.

    Judged only where the shaft turns by several steps of the encoder a sample, in a fixed rhythm.

    **Example**
    ```python
    >>> import numpy as np
    >>> from vttig_jax.logs.channel.stalls import repeats
    >>> repeats(np.repeat(np.arange(0, 50_000, 90), 2), 1.0)
    2

    ```
    """
    span = 2 * BESIDE
    if len(readings) <= 2 * span:
        return 1
    travel = np.abs(readings[span:] - readings[:-span]).astype(np.float64)
    fast = travel > max(QUANTA / 3 * quantum * span, 0.1 * float(travel.max()))
    moving = np.zeros(len(readings), bool)
    moving[span // 2 : -span // 2] = fast
    change = np.flatnonzero(np.diff(readings)) + 1
    apart = np.diff(change)[moving[change[:-1]] & moving[change[1:]]]
    if len(apart) < span:
        return 1
    usual = int(np.median(apart))
    regular = np.count_nonzero(apart == usual) >= REPEATED * len(apart)
    return usual if usual > 1 and regular else 1
