"""Position of a value in a log for messages, and limits of plausible values and times.

Beyond the limits a unit is wrong or a file is damaged. Without them, squares and quotients of such
values exceed the range of floating-point numbers.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float, Int, Real

from ..base.errors import LogError


@dataclass(frozen=True)
class Source:
    """Origin of a log, from which error messages take the position of a value.

    **Arguments**
    - `name`: file name as given by the user, or "arrays".
    - `columns`: role ("driving", …) → name of its column.
    - `line_of`: function from row to line number; without it messages give the number of the
      sample, counted from 0.
    - `kind`: noun for a channel in messages, "column" or "argument".
    - `rows`: number of the row of each sample if rows are left out.
    """

    name: str
    columns: Mapping[str, str] = field(default_factory=dict)
    line_of: Callable[[int], int] | None = None
    kind: str = "column"
    rows: Int[np.ndarray, " n"] | None = field(default=None, repr=False, compare=False)

    def at(self, role: str = "", row: int | None = None) -> str:
        """Return the position as text: "log.csv: line 7, column `driving_counts`"."""
        parts = []
        if row is not None:
            row = row if self.rows is None else int(self.rows[row])
            parts.append(f"line {self.line_of(row)}" if self.line_of else f"sample {row}")
        if role:
            parts.append(f"{self.kind} `{self.columns.get(role, role)}`")
        return ": ".join(filter(None, (self.name, ", ".join(parts))))


LARGEST = 1e30
"""Largest magnitude of a value in the units of the file (chosen: its square is far from
overflow)."""

LEAST_RANGE = 1e-30
"""Range of the readings of a shaft, in the units of the file, below which the shaft stands still
(chosen: its square is far from underflow)."""

SHORTEST_S, LONGEST_S = 1e-6, 1e12
"""Least duration of a log and largest time stamp, both in s. Chosen: in a microsecond no shaft
makes a turn, and thirty thousand years are beyond any clock."""

MOST_TURNS = 1000.0
"""Largest mean number of turns between two samples (chosen: 60 000 rpm and one sample per second).
A larger number comes from a wrong unit, and the memory of a fit grows with the turns."""


SKIP = 'or leave out such rows with --missing skip (`missing = "skip"` in [log])'
"""Cure of a field without a number."""

FEWEST_SAMPLES = 4
PAUSE = 5.0
"""Least number of samples of a log; intervals longer than `PAUSE` median intervals are pauses
(chosen)."""


def check_time(time: Float[np.ndarray, " n"], source: Source) -> list[str]:
    """Return notes on the time stamps; raise `LogError` for too few or decreasing stamps."""

    def refuse(message: str, row: int | None = None) -> None:
        raise LogError(message, where=source.at("time", row))

    if len(time) < FEWEST_SAMPLES:
        refuse(f"the log has only {len(time)} samples; record at least {FEWEST_SAMPLES}.")
    cure = "correct the unit of the time column or the sample rate."
    if (late := np.flatnonzero(np.abs(time) > LONGEST_S)).size:
        refuse(f"{time[late[0]]:g} s is no time stamp of a log; {cure}", int(late[0]))
    if 0 < (duration := float(np.ptp(time))) < SHORTEST_S:
        refuse(f"the log lasts only {duration:.3g} s; {cure}")
    interval = np.diff(time)
    if (back := np.flatnonzero(interval < 0)).size:
        before, after = time[back[0] : back[0] + 2]
        told = f"time runs backwards, from {before:.9g} s to {after:.9g} s"
        refuse(f"{told}; sort the log or cut it there.", int(back[0]) + 1)
    repeated = int(np.count_nonzero(interval == 0))
    if 2 * repeated > len(interval):
        told = f"{repeated} of {len(interval)} time steps are zero"
        refuse(f"{told}; write the time with more digits or give --sample-rate.")
    notes = [f"time: {repeated} stamps repeat the one before"] if repeated else []
    long = interval > PAUSE * np.median(interval)
    if long.any():
        count = int(long.sum())
        pauses = "pause" if count == 1 else "pauses"
        notes.append(f"time: {count} {pauses}, the longest of {interval.max():.4g} s")
    return notes


def refuse_values(role: str, values: Real[np.ndarray, " n"], source: Source) -> None:
    """Raise `LogError` at the first value of a column that is not finite or far too large."""
    finite = np.isfinite(values)
    if not finite.all():
        row = int(np.argmin(finite))
        raise LogError(
            f"{values[row]} is not a number; correct the reading, {SKIP}.",
            where=source.at(role, row),
        )
    if values.dtype.kind == "f" and max(values.max(initial=0), -values.min(initial=0)) > LARGEST:
        row = int(np.argmax(np.abs(values) > LARGEST))
        raise LogError(
            f"{values[row]:g} is too large for a reading; correct it, or the unit of its column.",
            where=source.at(role, row),
        )
