"""Unwrapping of counters and single-turn angles, exact for integers.

A reading r of a counter with modulus M represents r + kM. If the shaft turns less than M/2 between
two samples, the true step is the smallest possible one, and k decreases by ⌊(Δr + ⌊M/2⌋)/M⌋.
"""

import numpy as np
from jaxtyping import Float, Int, Real

SMALLEST_COUNTER = 2**8
LARGEST_COUNTER = 2**53
"""Smallest and largest modulus in counts that is detected as a power of two (chosen). Readings with
a range beyond the largest one contain a wrong reading."""

MAX_ROUGHNESS = 0.15
"""A modulus is accepted if unwrapping leaves less than this fraction of the roughness at the jumps
(chosen); see `_roughness`."""


def wrap_steps(reading: Real[np.ndarray, " n"], modulus: int | float) -> Int[np.ndarray, " steps"]:
    """Return the wraps between neighbouring samples: +1 upwards, −1 downwards and 0 without a wrap.

    Upwards means past the upper end of the counter to 0. The shape is (n − 1,).
    """
    step = np.diff(reading)
    if np.issubdtype(reading.dtype, np.integer):
        step = step.astype(np.int64, copy=False)
        step += int(modulus) // 2
        step //= int(modulus)
        return np.negative(step, out=step)
    step /= modulus
    return -np.rint(step, out=step).astype(np.int64)


def unwrap(reading: Real[np.ndarray, " n"], modulus: int | float) -> Real[np.ndarray, " n"]:
    """Return the continuous values `reading` + kM (k = 0 at the first sample); int64 stays exact.

    **Arguments**
    - `reading`: counts (int64) or angles (float64) in one unit, shape (n,).
    - `modulus`: M in that unit; the shaft must turn less than M/2 between samples.
    """
    turns = np.concatenate([[0], np.cumsum(wrap_steps(reading, modulus))])
    if np.issubdtype(reading.dtype, np.integer):
        return reading + int(modulus) * turns
    return reading + float(modulus) * turns


def find_modulus(
    reading: Real[np.ndarray, " n"], per_turn: int | float | None
) -> int | float | None:
    """Detect the modulus of a channel from the size of its jumps; return None without wraps.

    Integer counts may wrap at a power of two or at `per_turn` (counts per revolution), angles only
    at `per_turn` (one revolution in their unit). Candidates exceed the range of the readings. The
    best one leaves the smoothest steps at its wraps; it is accepted if they are smooth enough.
    """
    low, high = reading.min(), reading.max()
    span = high - low if isinstance(high, np.floating) else int(high) - int(low)
    step = np.diff(reading)
    candidates = []
    if np.issubdtype(reading.dtype, np.integer):
        power = max(SMALLEST_COUNTER, 1 << int(span).bit_length())
        if power <= LARGEST_COUNTER:
            candidates.append(power)
        if per_turn is not None and per_turn > span:
            candidates.append(int(per_turn))
    elif per_turn is not None and span <= per_turn:
        candidates.append(per_turn)
    best, lowest = None, MAX_ROUGHNESS
    for candidate in candidates:
        wraps = wrap_steps(reading, candidate)
        at = np.flatnonzero(wraps)
        if len(at) == 0:
            continue
        remaining = _roughness(step + candidate * wraps, at) / _roughness(step, at)
        if remaining < lowest:
            best, lowest = candidate, remaining
    return best


def stray_jump(
    reading: Real[np.ndarray, " n"], time: Float[np.ndarray, " n"], quantum: int | float
) -> int | None:
    """Return the row after the first step that motion cannot explain, or None.

    A step is isolated if it exceeds 8 times the steps two samples before and after it; then both
    steps of one bad sample are isolated. It is stray if it also exceeds 4 times every step that is
    not isolated. 8 `quantum` (step of the readings) are added to both limits. Steps refer to the
    median sampling interval, so that a pause of the log is not a jump. A shaft that moves only by
    isolated steps has no stray step.
    """
    step = steps_per_interval(reading, time)
    if len(step) < 5:
        return None
    np.abs(step, out=step)
    limit = np.empty_like(step)  # from the steps two samples before and after
    np.maximum(step[:-4], step[4:], out=limit[2:-2])
    limit[:2], limit[-2:] = np.maximum(step[0], step[2:4]), np.maximum(step[-4:-2], step[-1])
    limit *= 8
    limit += 8 * quantum
    isolated = step > limit
    if not isolated.any():
        return None
    others = step[~isolated]
    if isolated.sum() >= 3 and others.sum() < 0.1 * step[isolated].sum():
        return None
    stray = isolated & (step > 4 * others.max(initial=0) + 8 * quantum)
    return int(np.argmax(stray)) + 1 if stray.any() else None


def steps_per_interval(
    reading: Real[np.ndarray, " n"], time: Float[np.ndarray, " n"]
) -> Float[np.ndarray, " steps"]:
    """Return the steps between successive readings, scaled to the median sampling interval.

    Steps over an interval shorter than the median are not scaled.
    """
    weight = np.diff(time)
    usual = np.median(weight)
    if usual > 0:
        weight /= usual
        np.maximum(weight, 1.0, out=weight)
    else:
        weight[:] = 1.0
    return np.divide(np.diff(reading), weight, out=weight)


def _roughness(step: Real[np.ndarray, " steps"], at: Int[np.ndarray, " wraps"]) -> float:
    """Return the roughness at the wraps: the sum of the changes of the step before and after `at`.

    `at` holds the indices of the steps that wrap. 1 is added to the sum against division by 0.
    """
    change = np.abs(np.diff(step.astype(np.float64)))
    before, after = at[at > 0] - 1, at[at < len(change)]
    return 1.0 + float(change[before].sum() + change[after].sum())
