"""Columns that may be time or the angle of a shaft, and the questions where several may.

Questions to the user and notes on what was recognised are records; their sentences stand in the
catalogues `QUESTIONS` and `GUESSES`.
"""

import tomllib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Real

from ...base.errors import LogError, UsageError, VttigError
from ...base.units import REV
from ..channel.unwrap import find_modulus, unwrap, whole
from ..readers.column_names import ANGLES, TIME_UNITS, NameReading, bracket_of
from ..slope import APART, DEVIATIONS, TOLERANCE, slope
from ..source import LEAST_RANGE

EVEN = 1e-3
"""Time stamps are evenly spaced if each time step deviates from the median step by at most this
fraction of it (chosen)."""

SHOWN = 3
"""Number of values of a column that an error message shows (chosen)."""

MOST_CYCLES = 100
"""A column that counts cycles of rows ends below this number; above, it may be a slow encoder
(chosen)."""

HEAD = 1000
"""Number of first rows that mostly tell that a column does not count the rows (chosen)."""

MOST_LISTED = 8
"""Largest number of columns that an error message lists (chosen)."""

_COPY = 1e-9
"""Two columns are one reading in two units if they differ by at most this fraction of their largest
value (chosen). The errors of real gears are larger."""

EQUAL = 1e-6
"""Least relative deviation of a ratio from 1 for two shafts that follow each other exactly, as in a
simulation; at a smaller one the columns are one reading in two units (chosen)."""

_STRETCHES = 200
"""Number of stretches of a log over which travel and mean speed are compared (chosen)."""

_LEVELS = 0.25
"""Least distance of a level from the middle, as a share of the range (chosen); a sine is nearer
for a third of its time."""

_SPEED = 0.999
"""Least correlation of the travel of a column over each stretch with the mean of another column
there, if the other one is its speed (chosen)."""


@dataclass(frozen=True, eq=False)
class Candidate:
    """Column of a log that may be the time or the angle of a shaft.

    `index` is its position in the table, from 0. `reading` is the meaning of its name. `read`
    returns the values of a column by its index, or None if they are not numbers. `dated` is true
    for a column of dates or times of day.
    """

    index: int
    name: str
    reading: NameReading
    read: Callable[[int], Real[np.ndarray, " n"] | None] = field(repr=False)
    dated: bool = False

    @cached_property
    def values(self) -> Real[np.ndarray, " n"] | None:
        """Values of the column; None if they are not numbers."""
        return self.read(self.index)

    @property
    def rows(self) -> int:
        """Number of values, 0 for a column without numbers."""
        return 0 if self.values is None else len(self.values)

    @property
    def travel(self) -> float:
        """Range of the values, 0 for a column without numbers."""
        return float(np.ptp(self.values)) if self.values is not None and self.rows else 0.0

    @property
    def steps(self) -> Real[np.ndarray, " steps"]:
        """Differences of successive values; they are not kept, because a log may be long."""
        return np.diff(self.values if self.values is not None else np.zeros(0))

    @cached_property
    def rises(self) -> bool:
        """Whether every value exceeds the previous value."""
        values = self.values
        return values is not None and self.rows > 1 and bool(np.all(values[1:] > values[:-1]))

    @cached_property
    def is_row_number(self) -> bool:
        """Whether the values count the rows, with restarts at 0 or the first one, and few gaps.

        So are numbers of cycles, each of which holds for several rows.
        """
        if self.values is not None and self.rows >= 4 * (self.travel + 1):
            steps = np.unique(np.diff(self.values))
            if set(steps.tolist()) == {0, 1} and self.values[0] in (0, 1):
                return bool(self.values[-1] < MOST_CYCLES)
        for part in (slice(HEAD), slice(None)):  # most columns are told by their first rows
            values = np.zeros(0) if self.values is None else self.values[part]
            steps = np.diff(values)
            ones, counts = steps == 1, (steps >= 1) & (steps == np.rint(steps))
            if len(values) < 2 or not np.all(counts | np.isin(values[1:], (0, values[0]))):
                return False
        return bool(np.mean(ones) > 0.9)

    @cached_property
    def turns(self) -> bool:
        """Whether the values can be a shaft angle: numbers that change and are not row numbers."""
        if self.values is None or self.rows < 2 or not np.isfinite(self.values).all():
            return False
        return self.travel >= LEAST_RANGE and not self.is_row_number

    @property
    def is_voltage(self) -> bool:
        """Whether the name says volts, and the values are numbers that change."""
        said = {bracket_of(self.name), self.reading.other}
        return not said.isdisjoint(("v", "mv", "volt", "volts")) and self.turns

    @property
    def has_levels(self) -> bool:
        """Whether nearly all values are low or high, such as 0 or 5 V with noise.

        The first readings of a counter of 16 or 32 bits that passes zero are no levels.
        """
        values = np.zeros(1) if self.values is None else self.values
        known = values[np.isfinite(values)]
        if np.isnan(values).any() or not len(known) or self.is_row_number:
            return False
        values = np.clip(values, known.min(), known.max())  # ∞ is beyond the range of a scope
        size = float(np.ptp(values))
        if size < LEAST_RANGE:
            return False
        counter = any(0 <= bits - size < 0.01 * bits for bits in (2.0**16, 2.0**24, 2.0**32))
        off = np.abs(values - values.min() - 0.5 * size) > _LEVELS * size
        return self.rows > SHOWN**2 and float(np.mean(off)) > 0.99 and not counter

    @property
    def span(self) -> float:
        """Range over nearly all of which the readings jump more than once, as over a turn, or 0."""
        size = 0.0 if self.has_levels else self.travel
        return size if np.sum(np.abs(self.steps) > 0.9 * size) > 1 else 0.0

    @property
    def is_sign(self) -> bool:
        """Whether the values are +1 and −1, and perhaps 0."""
        values = np.unique(() if self.values is None else self.values).tolist()
        return {-1, 1} <= {*values} <= {-1, 0, 1}

    @cached_property
    def is_constant(self) -> bool:
        """Whether all values are one number, so that the column shows no motion."""
        return self.rows > 1 and self.travel == 0

    @cached_property
    def says_time(self) -> bool:
        """Whether the name means time, or contains only a unit of time, and the stamps grow."""
        reading, values = self.reading, self.values
        if reading.role == "time":  # repeated stamps are allowed
            if values is None or self.rows < 2 or not np.isfinite(values).all():
                return False
            return bool(np.all(values[1:] >= values[:-1]) and values[-1] > values[0])
        only_unit = reading.unit in TIME_UNITS and reading.role is None and not reading.other
        return only_unit and self.rises

    @cached_property
    def can_be_time(self) -> bool:
        """Whether the values grow without row numbers, and the name allows that they are time."""
        reading = self.reading
        free = reading.role is None and not reading.other and reading.unit not in ANGLES
        return free and self.rises and not self.is_row_number

    @cached_property
    def is_even(self) -> bool:
        """Whether the values are evenly spaced, with the tolerance `EVEN`."""
        steps = self.steps
        usual = float(np.median(steps))
        off = np.abs(steps - usual * np.rint(steps / usual)) > EVEN * abs(usual)
        return not off.any() and bool(np.mean(steps < 1.5 * usual) > 0.9)

    @property
    def facts(self) -> str:
        """Text with name, first values and range for an error message."""
        if self.dated:
            return f"`{self.name}` with dates or times"
        if self.values is None or not self.rows:
            return f"`{self.name}` without numbers"
        if self.is_constant:
            return f"`{self.name}` {self.values[0]:.12g} in every row, a constant"
        first = ", ".join(f"{value:.12g}" for value in self.values[:SHOWN])
        return f"`{self.name}` {first}, … ({self.values.min():.6g} … {self.values.max():.6g})"


def listed_facts(candidates: Sequence[Candidate]) -> str:
    """Return a list of columns with first values and ranges as text for an error message.

    For a column that only grows, the median step from row to row is listed too.
    """
    shown = "; ".join(
        one.facts + (f", {float(np.median(one.steps)):.6g} from row to row" if one.rises else "")
        for one in candidates[:MOST_LISTED]
    )
    more = len(candidates) - MOST_LISTED
    return shown + (f" and {more} more" if more > 0 else "")


def is_copy(one: Candidate, other: Candidate) -> bool:
    """Return whether two columns hold the same reading, in two units or with another zero."""
    if one.values is None or other.values is None or one.rows != other.rows:
        return False
    x, y = (values - values.mean() for values in (one.values, other.values))
    rest = y - float(x @ y / (x @ x)) * x
    return float(np.abs(rest).max()) <= _COPY * float(np.abs(y).max())


def is_speed_of(one: Candidate, other: Candidate) -> bool:
    """Return whether a column is the speed of another column of the same, even rows.

    The mean of a speed over a stretch of the log is proportional to the travel over it.
    """
    if not one.turns or not other.turns or one.rows != other.rows:
        return False
    assert one.values is not None and other.values is not None  # columns that turn have values
    edges = np.unique(np.linspace(0, one.rows - 1, _STRETCHES + 1).astype(np.int64))
    if len(edges) < 4:
        return False
    travel = np.diff(other.values[edges].astype(np.float64))
    sums = np.concatenate([[0.0], np.cumsum(one.values, dtype=np.float64)])
    mean = np.diff(sums[edges]) / np.diff(edges)
    if np.ptp(travel) == 0 or np.ptp(mean) == 0:
        return False
    return abs(float(np.corrcoef(travel, mean)[0, 1])) >= _SPEED


def turns_of(values: np.ndarray, per_turn: float | None) -> Float[np.ndarray, " n"]:
    """Return the readings in revolutions, unwrapped and minus the first one.

    `per_turn` is the number of readings per revolution, negative for an inverted encoder.
    """
    assert per_turn is not None  # columns without a unit are asked for before
    values = whole(values)
    modulus = find_modulus(values, abs(per_turn))
    if modulus is not None:
        values = unwrap(values, modulus)
    return (values - values[0]) / per_turn


def have_slope(
    x: Float[np.ndarray, " n"], y: Float[np.ndarray, " n"], ratio: float, *, surely: bool = True
) -> int:
    """Return the sign of the slope of `y` over `x` if its magnitude is `ratio`, else 0.

    `x` and `y` are angles in revolutions; the tolerances are `TOLERANCE` and `APART`, or, if not
    `surely`, `DEVIATIONS` standard errors of the slope in place of the first.
    """
    x, y = x - x.mean(), y - y.mean()
    value = float(x @ y / (x @ x))
    off = abs(abs(value) - ratio)
    apart = float(np.std(y - value * x)) > APART * float(np.ptp(y))
    if apart or off > (TOLERANCE * ratio if surely else DEVIATIONS * slope(REV * x, REV * y)[1]):
        return 0
    return 1 if value > 0 else -1


_SENTENCES = tomllib.loads(Path(__file__).with_suffix(".toml").read_text("utf-8"))

QUESTIONS = _SENTENCES["questions"]
"""Slug of a question → its sentence, which names the options that decide."""

HINTS = _SENTENCES["hints"]
"""Slug → option that decides, or what a question on the shafts adds."""

GUESSES = _SENTENCES["guesses"]
"""Slug of a note → what was recognised, and the reason."""


class Question(VttigError):
    """Question that the user must answer, raised where no answer is stated.

    - `slug`: stable name of its kind in `QUESTIONS`. - `role`: role in question, or "".
    - `columns`: columns among which the answer is. - `options`: options that decide.
    """

    slug: str
    role: str
    columns: tuple[str, ...]
    options: tuple[str, ...]

    def to_json(self) -> dict[str, Any]:
        """Return the record as an object for `--json`."""
        lists = {"columns": list(self.columns), "options": list(self.options)}
        return {"slug": self.slug, "role": self.role, **lists, "sentence": self.message}


class LogQuestion(Question, LogError):
    """Question about the columns of a log."""


class UsageQuestion(Question, UsageError):
    """Question about options that have two readings or no effect, at no place of a log."""


def ask(
    slug: str,
    where: str,
    *,
    role: str = "",
    columns: Sequence[Candidate] = (),
    options: Sequence[str] = (),
    **words: Any,
) -> Question:
    """Return a question; `words` are those of its sentence."""
    sentence = QUESTIONS[slug].format(
        role=role,
        count=len(columns),
        facts=columns[0].facts if len(columns) == 1 else listed_facts(columns),
        options=" or ".join(options),
        **dict(zip("abcd", (one.name for one in columns), strict=False)),
        **words,
    )
    asked = (LogQuestion if where else UsageQuestion)(sentence, where=where)
    asked.slug, asked.role, asked.options = slug, role, tuple(options)
    asked.columns = tuple(one.name for one in columns)
    return asked


@dataclass(frozen=True)
class Guess:
    """Column or unit of a role that was recognised and not stated by the user.

    `slug` is its kind in `GUESSES`, `taken` the choice with its reason, and `option` changes it.
    """

    slug: str
    role: str
    taken: str
    option: str

    @classmethod
    def of(cls, slug: str, role: str, option: str, **words: str) -> "Guess":
        """Return a guess; `words` are those of its sentence."""
        return cls(slug, role, GUESSES[slug].format(**words), option)

    @property
    def fact(self) -> str:
        """Text on the choice and its reason, for the notes of a log."""
        return f"{self.role}: {self.taken}"

    def __str__(self) -> str:
        return f"{self.fact}; {self.option} changes it"
