"""When two records of a fit say the same: what a reader relies on, and not the last digits.

Processors, and versions of the dependencies, round differently. Two answers are the same where no
number differs by more than a thousandth of its standard error, and every word is equal. How many
steps an iteration took is no answer.
"""

from typing import Any

OF_A_STD = 1e-3
"""Share of a standard error by which a number may differ."""

RELATIVE, ALONE = 1e-6, 1e-6
"""Relative difference of numbers with and without a standard error; in a list, of the largest.

The search for the noise ends a hundredth of its standard error before the largest density."""

COUNTS = ("solver_steps",)
"""Counts of iterations."""


def differences(one: Any, other: Any, place: str = "", std: float = 0.0) -> list[str]:
    """Where two JSON values say something else; `std` is the standard error of a number."""
    if isinstance(one, dict) and isinstance(other, dict) and set(one) == set(other):
        found = []
        for key in one:
            if key not in COUNTS:
                of_noise = place.endswith("noise")  # whose deviation is no standard error
                own = 0.0 if of_noise or _is_error(key) else _largest_error(one)
                if "likelihood_ratio" in f"{place}.{key}":
                    own = 1.0  # the scale of a χ²
                found += differences(one[key], other[key], f"{place}.{key}", own)
        return found
    if isinstance(one, list) and isinstance(other, list) and len(one) == len(other):
        pairs = enumerate(zip(one, other, strict=True))
        largest = max((abs(v) for v in one if type(v) is float), default=0.0)
        std = max(std, ALONE / OF_A_STD * largest)
        return [d for i, (a, b) in pairs for d in differences(a, b, f"{place}[{i}]", std)]
    if type(one) is float and type(other) is float:
        allowed = OF_A_STD * std + (RELATIVE if std else ALONE) * max(abs(one), abs(other)) + 1e-15
        same = abs(one - other) <= allowed
    else:
        same = type(one) is type(other) and one == other
    return [] if same else [f"{place}: {one!r} is not {other!r}"]


def _is_error(key: str) -> bool:
    return "std" in key.split("_")


def _largest_error(record: dict[str, Any]) -> float:
    """The standard error that stands beside the numbers of a record; the largest of several."""
    return max((v for k, v in record.items() if _is_error(k) and type(v) is float), default=0.0)
