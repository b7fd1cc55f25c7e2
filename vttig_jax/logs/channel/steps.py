"""Quantisation step of the readings of a channel, and the digits with which the log stores them."""

import numpy as np
from jaxtyping import Bool, Float, Real

from ...base.units import ARCSEC, DEG

_ROUNDING = 1e-10
"""Readings that differ by at most this fraction of the largest reading are equal (chosen)."""

_STEP_TOLERANCE = 0.01
"""Largest deviation from a multiple of the step, as a fraction of the step (chosen tolerance)."""

_LEAST_CHANGES = 1e-3
"""Least share of the samples at which the difference of successive readings must change; otherwise
the speed is exactly constant and shows no encoder step (chosen)."""

_MOST_DIVISIONS = 20
"""Largest number of divisions in Euclid's algorithm; each at least halves the step (chosen)."""

_SAMPLE = 4000  # largest number of readings in the test of the digits (chosen)
_COARSER = 5.0
"""If the step of large readings exceeds that of small readings by this factor, the printed digits
limit the large ones (chosen); one digit fewer is a factor of ten."""

_FEWEST = 4
"""Fewest different readings whose digits count: a shaft that stops at 100.0000 shows no digits, and
one reading in ten ends in a zero by chance (chosen)."""

_LEAST_ARCSEC = 0.1
"""Smallest step in arcsec that is worth a note; no encoder is more accurate (chosen)."""


def step_of(values: Real[np.ndarray, " n"]) -> float:
    """Return the step s for which all values differ by multiples of s, or 0 without such a step.

    Integers have the step 1. Candidates for floats are the greatest common divisor of the
    differences and 1 … 1e-9.
    """
    if np.issubdtype(values.dtype, np.integer):
        return 1.0
    for step in (common_step(values), *(10.0**-k for k in range(10))):
        if are_multiples(values, step):
            return step
    return 0.0


def are_multiples(values: Real[np.ndarray, " n"], step: float) -> bool:
    """Return whether all values differ by multiples of `step`.

    A step that is not larger than the rounding errors of the values gives False.
    """
    if step <= _ROUNDING * np.abs(values).max():
        return False
    multiples = (values - values[0]) / step
    return bool(np.abs(multiples - np.rint(multiples)).max() < _STEP_TOLERANCE)


def common_step(values: Real[np.ndarray, " n"]) -> float:
    """Return the greatest common divisor of the differences of readings, or 0 if there is none.

    Readings that differ only by rounding count as one reading. A shaft of exactly constant speed
    moves by equal steps, which say nothing about its encoder.
    """
    steps = np.diff(values)
    if len(steps) < 2 or np.mean(_differ(steps[1:], steps[:-1], values)) < _LEAST_CHANGES:
        return 0.0
    ordered = np.unique(values)
    gaps = np.unique(np.diff(ordered))
    gaps = gaps[gaps > _ROUNDING * np.abs(values).max()]
    if len(gaps) == 0:
        return 0.0
    step = gaps[0]
    for _ in range(_MOST_DIVISIONS):
        left = np.abs(gaps - step * np.rint(gaps / step))
        left = left[left > _STEP_TOLERANCE * step]
        if len(left) == 0:
            return float(np.ptp(values) / np.rint(np.diff(ordered) / step).sum())
        step = left.min()
    return 0.0


def _differ(
    first: Real[np.ndarray, " n"], second: Real[np.ndarray, " n"], values: Real[np.ndarray, " m"]
) -> Bool[np.ndarray, " n"]:
    return np.abs(first - second) > _ROUNDING * np.abs(values).max()


def digits_note(role: str, values: Real[np.ndarray, " n"], radians: float) -> list[str]:
    """Return a note if the stored digits are too coarse for small angles, else an empty list.

    Floating-point numbers of 32 bits have 24 binary digits, and a program that prints six digits
    writes 5345.67. Both are coarse where the angle is large.

    **Arguments**
    - `role`: "driving" or "driven". `values`: readings.
    - `radians`: angle of one unit of the readings, rad.
    """
    if np.issubdtype(values.dtype, np.integer):
        return []
    values = values[:: -(-len(values) // _SAMPLE)].astype(np.float64)
    top = float(np.abs(values).max())
    found = _step_of_32_bits(values), _step_of_digits(values)
    step, reason = max(zip(found, ("numbers of 32 bits", "the printed digits"), strict=True))
    seen = step * radians / ARCSEC
    if seen < _LEAST_ARCSEC:
        return []
    return [
        f"{role}: this log cannot show less than {seen:.3g}″, the step of {reason} at"
        f" {top * radians / DEG:.5g}°; log from a zero nearby, or with more digits"
    ]


def _step_of_32_bits(values: Float[np.ndarray, " n"]) -> float:
    """Return the distance between neighbouring 32-bit floats at the largest value, or 0.

    It is 0 if the values have more digits than 32-bit floats, or a step at least as coarse.
    """
    if not np.array_equal(values.astype(np.float32).astype(np.float64), values):
        return 0.0
    step = float(np.spacing(np.float32(np.abs(values).max())))
    return step if step_of(values) < step else 0.0


def _step_of_digits(values: Float[np.ndarray, " n"]) -> float:
    """Return the step of the values with the most digits before the point, or 0.

    It is 0 unless the smaller values have a much finer step, so that printed digits are the cause.
    """
    size = np.abs(values)
    if size.max() == 0:
        return 0.0
    large = size >= 10.0 ** np.floor(np.log10(size.max()))
    if min(len(np.unique(values[large])), np.count_nonzero(~large)) < _FEWEST:
        return 0.0
    step, finer = _last_place(values[large]), _last_place(values[~large])
    return step if finer > 0 and step > _COARSER * finer else 0.0


def _last_place(values: Float[np.ndarray, " n"]) -> float:
    """Return the largest of 1, 0.1 … 1e-9 of which all values are multiples, or 0.

    The differences of the values would not do: a counter that moves by equal steps has larger ones.
    """
    rounding = _ROUNDING * np.abs(values).max()
    places = (k for k in range(10) if np.abs(np.round(values, k) - values).max() <= rounding)
    found = 10.0 ** -next(places, 10)
    return found if found > max(rounding, 1e-10) else 0.0
