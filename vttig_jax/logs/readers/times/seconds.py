"""Conversion of the stamps of a time column to seconds without loss of digits."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Real

from ....base.errors import LogError
from ..column_names import TIME_UNITS
from .stamps import read_stamps

FAR = 2**31
"""If stamps exceed this number, the first stamp is subtracted, because float64 has too few digits
(chosen)."""

_LONGEST = 40  # most characters of a stamp (chosen); nanoseconds since 1970 have 20

FINE_ENOUGH = 0.1
"""Largest step of the printed stamps as a fraction of the sampling interval (chosen)."""


def seconds_of_stamps(fields: Sequence[str], where: str) -> tuple[Float[np.ndarray, " n"], str]:
    """Return the seconds since the first stamp from written dates or times, and a note on it."""
    nanoseconds, note = read_stamps(fields, where)
    return nanoseconds / 1e9, note


def since_first(stamps: np.ndarray) -> Float[np.ndarray, " n"]:
    """Return dates or durations of NumPy in s since the first valid one; a missing one is NaN.

    They are subtracted as whole nanoseconds.
    """
    kind = "datetime64[ns]" if stamps.dtype.kind == "M" else "timedelta64[ns]"
    whole = stamps.ravel().astype(kind)
    known, counted = ~np.isnat(whole), whole.astype(np.int64)
    return np.where(known, (counted - counted[known][:1].sum()) / 1e9, np.nan)


def seconds_of_numbers(values: Real[np.ndarray, " n"], unit: str) -> Float[np.ndarray, " n"]:
    """Return numeric stamps in seconds; stamps beyond `FAR` are counted from the first stamp.

    Integers are subtracted before the conversion to float64, because float64 represents nanoseconds
    since 1970 only with a step of 256 ns.
    """
    if len(values) and max(float(values.max()), -float(values.min())) > FAR:
        values = values - values[0]
    factor = TIME_UNITS[unit]
    return values if factor == 1 and values.dtype.kind == "f" else values * factor


def exact_numbers(fields: Sequence[str]) -> Float[np.ndarray, " n"] | None:
    """Return decimal stamps minus the first stamp, subtracted as integers without loss of digits.

    The result is None unless all fields are plain decimal numbers of at most 40 characters.
    """
    if any(len(field) > _LONGEST for field in fields):
        return None
    parts = [field.replace(",", ".").partition(".") for field in fields]
    if not all(
        whole.lstrip("+-").isdecimal() and (not part or part.isdecimal())
        for whole, _, part in parts
    ):
        return None
    digits = max((len(part) for _, _, part in parts), default=0)
    scaled = [int(whole + part.ljust(digits, "0")) for whole, _, part in parts]
    return np.array([value - scaled[0] for value in scaled], np.float64) / 10.0**digits


def check_days(fields: Sequence[str], seconds: Float[np.ndarray, " n"], where: str) -> None:
    """Raise `LogError` if stamps in days have too few decimals to resolve the sampling interval."""
    if len(seconds) < 3:
        return
    digits = min(len(field.replace(",", ".").partition(".")[2]) for field in fields[:1000])
    step_s = TIME_UNITS["d"] * 10.0**-digits
    usual = float(np.median(np.abs(np.diff(seconds))))
    if step_s > FINE_ENOUGH * usual:
        raise LogError(
            f"days with {digits} decimals hold time to {step_s:.2g} s, too coarse for samples"
            f" {usual:.2g} s apart; export more decimals, or give --sample-rate.",
            where=where,
        )
