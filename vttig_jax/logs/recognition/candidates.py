"""Columns that may be time or the angle of a shaft, with the facts that decide."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Real

from ...base.errors import LogError
from ..readers.delimited import TextTable
from ..readers.nested import NestedTable
from .name_words import NameReading

EVEN = 1e-3
"""Largest deviation of a time step from the median one, as a fraction of it, of evenly spaced
stamps (chosen)."""

SHOWN = 3
"""Number of first values in a refusal (chosen)."""

JUMP = 5.0
"""A step above this many times the 90 % quantile of all steps is a jump, such as that of an angle
that wraps, and is left out of a slope (chosen)."""

MOST_LISTED = 8
"""Largest number of columns in a refusal (chosen)."""


@dataclass(frozen=True, eq=False)
class Candidate:
    """Column with its name and its values, None if they are no numbers.

    `dated` is true for a column of dates or times of day.
    """

    index: int
    name: str
    reading: NameReading
    values: Real[np.ndarray, " n"] | None = field(repr=False, default=None)
    dated: bool = False

    @property
    def rises(self) -> bool:
        """Whether every value exceeds the one before it."""
        return self.values is not None and len(self.values) > 1 and bool(np.all(self._steps > 0))

    @property
    def is_even(self) -> bool:
        """Whether the values are evenly spaced."""
        steps = self._steps
        usual = float(np.median(steps))
        return bool(np.abs(steps - usual).max() <= EVEN * abs(usual))

    @property
    def is_row_number(self) -> bool:
        """Whether the values count the rows, possibly in a counter that starts again."""
        if self.values is None or len(self.values) < 2:
            return False
        steps = self._steps
        ones = steps == 1
        starts = self.values[1:] == 0
        return bool(np.all(ones | starts) and np.mean(ones) > 0.9)

    @property
    def turns(self) -> bool:
        """Whether the values can be those of a shaft: numbers that change and are no row number."""
        if self.values is None or len(self.values) < 2 or not np.isfinite(self.values).all():
            return False
        return bool(np.ptp(self.values) > 0) and not self.is_row_number

    @property
    def _steps(self) -> np.ndarray:
        assert self.values is not None
        return np.diff(self.values)

    @property
    def facts(self) -> str:
        """Name, first values and range for a refusal."""
        if self.dated:
            return f"`{self.name}` with dates or times"
        if self.values is None or not len(self.values):
            return f"`{self.name}` without numbers"
        first = ", ".join(f"{value:.12g}" for value in self.values[:SHOWN])
        return f"`{self.name}` {first}, … ({self.values.min():.6g} … {self.values.max():.6g})"


def read_values(table: TextTable | NestedTable, indices: list[int]) -> Mapping[int, np.ndarray]:
    """Return the values of those columns that hold numbers only."""
    try:
        return dict(zip(indices, table.columns(indices), strict=True))
    except LogError:
        pass
    found = {}
    for index in indices:
        try:
            found[index] = table.columns([index])[0]
        except LogError:
            continue
    return found


def listed_facts(candidates: list[Candidate]) -> str:
    """Return the columns with first values, ranges and slopes, for a refusal.

    The slope of a column is that over the first column that can be a shaft; the one of a column
    that only grows is its usual step from row to row.
    """
    over = next((one for one in candidates if one.turns and not one.rises), None)
    shown = "; ".join(one.facts + _slope_in_words(one, over) for one in candidates[:MOST_LISTED])
    more = len(candidates) - MOST_LISTED
    return shown + (f" and {more} more" if more > 0 else "")


def _slope_in_words(one: Candidate, over: Candidate | None) -> str:
    """Return what the slope of a column is, with a comma before it, or ""."""
    if one.values is not None and one.rises:
        return f", {float(np.median(np.diff(one.values))):.6g} from row to row"
    if over is None or one is over or not one.turns:
        return ""
    assert one.values is not None and over.values is not None  # columns that turn have values
    if len(one.values) != len(over.values):
        return ""
    steps = np.diff([over.values, one.values], axis=1).astype(np.float64)
    size = np.abs(steps)
    steps[:, np.any(size > JUMP * np.quantile(size, 0.9, axis=1, keepdims=True), axis=0)] = 0.0
    path = np.cumsum(steps, axis=1)
    x, y = path - path.mean(axis=1, keepdims=True)
    return f", slope {float(x @ y / (x @ x)):.5g} over `{over.name}`" if x @ x > 0 else ""
