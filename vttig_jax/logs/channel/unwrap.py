"""Wrapping counters and single-turn angles made continuous; exact for integers.

A reading r of a counter with modulus M stands for r + kM. Between two samples the shaft turns less
than M/2, so the step is the one of least size: k falls by ⌊(Δr + ⌊M/2⌋)/M⌋.
"""

import numpy as np
from jaxtyping import Float, Int, Real

SMALLEST_COUNTER = 2**8

LARGEST_COUNTER = 2**53
"""Wider readings hold a wild one; no counter wraps there."""

EXPLAINED = 0.15
"""Share of the unrest at its jumps that a modulus may leave."""


def wrap_steps(reading: Real[np.ndarray, " n"], modulus: int | float) -> Int[np.ndarray, " steps"]:
    """Wraps between neighbouring samples: +1 where the counter passed its top, −1 its bottom."""
    step = np.diff(reading)
    if np.issubdtype(reading.dtype, np.integer):
        modulus = int(modulus)
        return -((step + modulus // 2) // modulus)
    return -np.rint(step / modulus).astype(np.int64)


def unwrap(reading: Real[np.ndarray, " n"], modulus: int | float) -> Real[np.ndarray, " n"]:
    """Return `reading` + kM, continuous, starting at the first reading; int64 stays exact.

    **Arguments**
    - `reading`: counts (int64) or angles (float64) in one unit, shape (n,).
    - `modulus`: M in that unit. Right while the shaft turns less than M/2 between samples.
    """
    turns = np.concatenate([[0], np.cumsum(wrap_steps(reading, modulus))])
    if np.issubdtype(reading.dtype, np.integer):
        return reading + int(modulus) * turns
    return reading + float(modulus) * turns


def find_modulus(
    reading: Real[np.ndarray, " n"], per_turn: int | float | None
) -> int | float | None:
    """The modulus at which a channel wraps, from the size of its jumps; None where it does not.

    Integer counts may wrap at a power of two or at `per_turn` (counts per revolution), angles only
    at `per_turn` (one revolution in their unit). Of the candidates that exceed the range of the
    readings, the one wins that leaves the steadiest steps where it wraps, if hardly any unrest is
    left there.
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
    best, unrest = None, EXPLAINED
    for candidate in candidates:
        wraps = wrap_steps(reading, candidate)
        at = np.flatnonzero(wraps)
        if len(at) == 0:
            continue
        left = _unrest(step + candidate * wraps, at) / _unrest(step, at)
        if left < unrest:
            best, unrest = candidate, left
    return best


def stray_jump(
    reading: Real[np.ndarray, " n"], time: Float[np.ndarray, " n"], quantum: int | float
) -> int | None:
    """Row of the first step no motion explains, or None.

    A step is stray when it is 8 times those two samples before and after it (both of a bad sample's
    steps stand alone then), and 4 times every step that is not of that kind. Steps are taken per
    median sampling interval, so that a pause of the log is no jump. A shaft that stands between
    single steps, and so moves by nothing else, is left alone.
    """
    step = np.abs(steps_per_interval(reading, time))
    if len(step) < 5:
        return None
    padded = np.pad(step, 2, mode="edge")
    lonely = step > 8 * np.maximum(padded[:-4], padded[4:]) + 8 * quantum
    if not lonely.any():
        return None
    rest = step[~lonely]
    if lonely.sum() >= 3 and rest.sum() < 0.1 * step[lonely].sum():
        return None
    stray = lonely & (step > 4 * rest.max(initial=0) + 8 * quantum)
    return int(np.argmax(stray)) + 1 if stray.any() else None


def steps_per_interval(
    reading: Real[np.ndarray, " n"], time: Float[np.ndarray, " n"]
) -> Float[np.ndarray, " steps"]:
    """Steps of a channel per median interval; shorter intervals count as one."""
    interval = np.diff(time)
    usual = np.median(interval)
    weight = np.maximum(interval / usual, 1.0) if usual > 0 else 1.0
    return np.diff(reading) / weight


def _unrest(step: Real[np.ndarray, " steps"], at: Int[np.ndarray, " wraps"]) -> float:
    """Change of step before and after the steps `at`; 1 is added so that none divides by 0."""
    change = np.abs(np.diff(step.astype(np.float64)))
    before, after = at[at > 0] - 1, at[at < len(change)]
    return 1.0 + float(change[before].sum() + change[after].sum())
