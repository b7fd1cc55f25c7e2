"""Readings at standstill: a channel that was read once or several times at each of its places."""

import numpy as np
from jaxtyping import Float, Real

LONG_S = 0.5
"""Least time between two readings, each of which a shaft approached from standstill (chosen)."""

SAME = 0.02
"""A step below this share of the usual one is a further reading at a place (chosen)."""

_PART = 0.3
"""A larger step below this share is part of a motion (chosen)."""

_UNEVEN = 0.06
"""Least relative deviation of the times between readings, with which steps that are more alike than
speeds tell that no shaft turned (chosen)."""

_RESTS = 0.9
"""Least share of steps behind which a shaft rests for at least one more reading (chosen)."""


def usual_step(values: Real[np.ndarray, " n"]) -> float:
    """Return the size of the steps that make half of the travel of a channel."""
    ordered = np.sort(np.abs(np.diff(values.astype(np.float64))))
    travel = np.cumsum(ordered)
    return float(ordered[np.searchsorted(travel, 0.5 * travel[-1])]) if len(travel) else 0.0


def is_at_standstill(
    values: Real[np.ndarray, " n"], time: Float[np.ndarray, " n"], *, clock: bool
) -> bool:
    """Return whether a channel was read at standstill.

    No step between two readings is then a part of the usual step, as on a ramp or at a reversal,
    and readings have no `clock` but a stated rate of at most two a second. With a clock the
    readings tell it if every place has several, or if unequal times made steps that are alike.
    Small steps that go on in one direction are motion beside the wraps of a large counter.
    """
    signed, usual = np.diff(values.astype(np.float64)), usual_step(values)
    step = np.abs(signed)
    moved = step > SAME * usual
    small = np.where(moved, np.nan, np.sign(signed))[signed != 0]
    goes_on = np.nansum(small[1:] * small[:-1]) > 0  # noise turns back more often than not
    if len(step) < 3 or goes_on or np.any(moved & (step < _PART * usual)):
        return False
    took = np.diff(time)
    slow = bool(np.median(took) >= LONG_S)
    if not clock or (moved[:-1].any() and np.mean(~moved[1:][moved[:-1]]) >= _RESTS):
        return slow or clock
    step, took = step[moved], took[moved]
    uneven, steps, speeds = (
        float(np.std(one)) / max(float(np.mean(one)), 1e-300)
        for one in (took, step, step / np.maximum(took, 1e-300))
    )
    return slow and uneven > _UNEVEN and speeds**2 > 2 * steps**2
