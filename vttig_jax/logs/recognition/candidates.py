"""Columns that may be time or the angle of a shaft, with the properties that decide."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Real

from ...base.errors import LogError
from ..magnitudes import LEAST_RANGE
from ..readers.delimited import TextTable
from ..readers.nested import NestedTable
from .name_words import NameReading

EVEN = 1e-3
"""Time stamps are evenly spaced if each time step deviates from the median step by at most this
fraction of it (chosen)."""

SHOWN = 3
"""Number of values of a column that an error message shows (chosen)."""

JUMP = 5.0
"""A step from row to row is a jump if it exceeds the 90 % quantile of all steps by this factor, as
where an angle wraps. Jumps are not used for a slope (chosen)."""

MOST_LISTED = 8
"""Largest number of columns that an error message lists (chosen)."""


@dataclass(frozen=True, eq=False)
class Candidate:
    """Column of a log that may be the time or the angle of a shaft.

    `index` is its position in the table, from 0. `reading` is the meaning of its name. `values` is
    None if they are not numbers. `dated` is true for a column of dates or times of day.
    """

    index: int
    name: str
    reading: NameReading
    values: Real[np.ndarray, " n"] | None = field(repr=False, default=None)
    dated: bool = False

    @property
    def rises(self) -> bool:
        """Whether every value exceeds the previous value."""
        return self.values is not None and len(self.values) > 1 and bool(np.all(self._steps > 0))

    @property
    def is_even(self) -> bool:
        """Whether the values are evenly spaced, with the tolerance `EVEN`."""
        steps = self._steps
        usual = float(np.median(steps))
        return bool(np.abs(steps - usual).max() <= EVEN * abs(usual))

    @property
    def is_row_number(self) -> bool:
        """Whether the values count the rows in steps of 1, possibly with restarts at 0."""
        if self.values is None or len(self.values) < 2:
            return False
        steps = self._steps
        ones = steps == 1
        starts = self.values[1:] == 0
        return bool(np.all(ones | starts) and np.mean(ones) > 0.9)

    @property
    def turns(self) -> bool:
        """Whether the values can be a shaft angle: numbers that change and are not row numbers."""
        if self.values is None or len(self.values) < 2 or not np.isfinite(self.values).all():
            return False
        return bool(np.ptp(self.values) >= LEAST_RANGE) and not self.is_row_number

    @property
    def is_constant(self) -> bool:
        """Whether all values are one number, so that the column shows no motion."""
        return self.values is not None and len(self.values) > 1 and bool(np.ptp(self.values) == 0)

    @property
    def _steps(self) -> np.ndarray:
        assert self.values is not None
        return np.diff(self.values)

    @property
    def facts(self) -> str:
        """Text with name, first values and range for an error message."""
        if self.dated:
            return f"`{self.name}` with dates or times"
        if self.values is None or not len(self.values):
            return f"`{self.name}` without numbers"
        if self.is_constant:
            return f"`{self.name}` {self.values[0]:.12g} in every row, a constant"
        first = ", ".join(f"{value:.12g}" for value in self.values[:SHOWN])
        return f"`{self.name}` {first}, … ({self.values.min():.6g} … {self.values.max():.6g})"


def read_values(table: TextTable | NestedTable, indices: list[int]) -> Mapping[int, np.ndarray]:
    """Return index → values for those columns of `indices` that contain only numbers."""
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


def first_fault(table: TextTable | NestedTable, index: int) -> LogError:
    """Return the error of a column that `read_values` left out."""
    try:
        table.columns([index])
    except LogError as error:
        return error
    raise AssertionError(f"column {index} holds numbers only")


def listed_facts(candidates: list[Candidate]) -> str:
    """Return a list of columns with first values, ranges and slopes as text for an error message.

    The slope is that of a regression over the first column that can be a shaft angle and does not
    only grow. For a column that only grows, the median step from row to row is listed instead.
    """
    over = next((one for one in candidates if one.turns and not one.rises), None)
    shown = "; ".join(one.facts + _slope_in_words(one, over) for one in candidates[:MOST_LISTED])
    more = len(candidates) - MOST_LISTED
    return shown + (f" and {more} more" if more > 0 else "")


def _slope_in_words(one: Candidate, over: Candidate | None) -> str:
    """Return the slope of a column as text that begins with a comma, or "" without a slope.

    `one` is the column, and `over` the column over which its slope is taken (the abscissa).
    """
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
