"""Recognition of the time column and of the unit of its stamps."""

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Real

from ..readers.column_names import ANGLES, TIME_UNITS
from ..readers.times.epochs import epoch_unit
from . import question
from .candidates import Candidate
from .question import Guess

SETTER = "--column time=NAME"

DAYS = ((36_526, 73_051), (730_486, 767_011))
"""Ranges of day numbers from 2000 to 2100, as Excel (since 1900) and MATLAB (since the year 0)
count days."""

_ONE_CLOCK = 0.1
"""Stamps of two columns belong to one clock if their difference changes by at most this fraction of
the median step (chosen)."""

SHORT_S = 1e-4
"""Time stamps with a smaller median step than this may be days instead of seconds (chosen)."""


def refuse_two_clocks(
    time: int | None, shafts: Mapping[str, Candidate], columns: Sequence[Candidate], source: str
) -> None:
    """Refuse a table in which each shaft follows a column of stamps of its own.

    `time` is the index of the time column, `shafts` is role → column, and `columns` are all columns
    of the table. Stamps that differ by a constant are one clock.

    **Raises** `LogError` naming the four columns.
    """
    own = [(columns[one.index - 1], one) for one in shafts.values() if one.index > 0]
    own = [(stamps, one) for stamps, one in own if _says_time(stamps) and stamps.rises]
    if len(own) < 2 or time not in [stamps.index for stamps, _ in own]:
        return
    first, second = (stamps.values for stamps, _ in own)
    assert first is not None and second is not None  # columns that rise have values
    if len(first) != len(second):
        return
    apart = np.ptp(first.astype(np.float64) - second)
    if apart > _ONE_CLOCK * float(np.median(np.diff(first))):
        raise question.two_clocks([(stamps.name, one.name) for stamps, one in own], source)


def time_column(candidates: Sequence[Candidate], source: str) -> tuple[Candidate, Guess]:
    """Return the time column among the columns without another role, and the guess.

    It is the only column of dates, or with a name for time or a unit of time. Without such a column
    it is the only one whose values always grow, are evenly spaced and are not row numbers. Columns
    of the same stamps count as one.

    **Raises** `LogError` if no column or several columns can be the time.
    """
    named = [one for one in candidates if one.dated or _says_time(one)]
    if len(named) > 1 and not _are_the_same(named):
        raise question.several("time", named, source)
    if len(named) > 1:
        why = f"the same stamps as `{named[1].name}`"
        return named[0], Guess("time", f"column `{named[0].name}`", why, SETTER)
    if named:
        why = "the only one of dates or times" if named[0].dated else "by its name"
        return named[0], Guess("time", f"column `{named[0].name}`", why, SETTER)
    rising = [one for one in candidates if _can_be_time(one)]
    if len(rising) != 1 or not rising[0].is_even:
        raise question.no_time(candidates, source)
    why = "the only one that grows evenly"
    return rising[0], Guess("time", f"column `{rising[0].name}`", why, SETTER)


def time_unit(one: Candidate, stated: str | None, source: str) -> tuple[str | None, Guess | None]:
    """Return the unit of time stamps if neither name nor option states it, and the guess.

    Both are None if name or option (`stated`) state the unit, or if the stamps are dates.

    **Raises** `LogError` for whole numbers that are no seconds since 1970 or 1601, and for numbers
    that may be days.
    """
    if one.dated:
        return None, None
    if one.values is None or stated is not None or one.reading.unit is not None:
        return None, None
    if not len(one.values):
        return None, None
    epoch = epoch_unit(one.values)
    if epoch is not None:
        why = f"from the size of its stamps, {epoch.since}"
        return epoch.unit, Guess("time", f"in {epoch.unit}", why, "--unit time=UNIT")
    if np.all(one.values == np.rint(one.values)):
        raise question.no_time_unit(one, source)
    if _may_be_days(one.values):
        raise question.days_or_seconds(one, source)
    return "s", Guess("time", "in seconds", "as its name states no unit", "--unit time=UNIT")


def _may_be_days(values: Real[np.ndarray, " n"]) -> bool:
    """Return whether the stamps may be days: day numbers of 2000 to 2100 with very small steps."""
    steps = np.diff(values)
    short = len(steps) > 0 and float(np.median(np.abs(steps))) < SHORT_S
    return short and any(first <= values[0] <= last for first, last in DAYS)


def _says_time(one: Candidate) -> bool:
    """Return whether the name means time, or contains only a unit of time, and the stamps grow."""
    reading = one.reading
    if reading.role == "time":
        return _grows(one)
    return reading.unit in TIME_UNITS and reading.role is None and not reading.other and one.rises


def _are_the_same(candidates: Sequence[Candidate]) -> bool:
    """Return whether all columns hold the same numbers in the same unit."""
    first, *others = candidates
    return first.values is not None and all(
        one.reading.unit == first.reading.unit
        and one.values is not None
        and np.array_equal(one.values, first.values)
        for one in others
    )


def _grows(one: Candidate) -> bool:
    """Whether the stamps never fall and do not stand still."""
    values = one.values
    if values is None or len(values) < 2 or not np.isfinite(values).all():
        return False
    return bool(np.all(np.diff(values) >= 0) and values[-1] > values[0])


def _can_be_time(one: Candidate) -> bool:
    reading = one.reading
    free = reading.role is None and not reading.other and reading.unit not in ANGLES
    return free and one.rises and not one.is_row_number
