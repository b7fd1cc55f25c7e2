"""Export of TwinCAT Scope View: groups of channels, each with its own column of time.

The row of names begins with `Name`. Every column with the name `Name` is the time of the group of
channels that follows it, in ms or, in some exports, as FILETIME. There is one group for each sample
time, and groups with longer sample times have fewer rows. Rows such as `SymbolName` and `Unit`
describe the channels. The last row may be `EOF`.
"""

import re
from collections.abc import Mapping, Sequence

import numpy as np

from ....base.errors import LogError
from ..column_names import unit_in
from ..delimited import split
from ..number_format import looks_like_number, to_number
from ..table import Table

_HEAD = 60
"""Number of first lines that may describe the channels (chosen)."""

END = "EOF"
MS = 1e-3
"""Seconds in a millisecond, which is the unit of most time columns."""

_TICK = 1e-7
"""Seconds in a unit of FILETIME, which counts since 1601."""

_FILETIME = re.compile(r"1\d{17}")
"""FILETIME of the years 1917 to 2234: 18 digits, which a float does not hold."""

_SAMPLE_TIME = re.compile(r"SampleTime(?:\[ms\])?(?=[\t;, :])")
"""First field of the row with the sample times, before one of the delimiters of the export."""


def matches(lines: Sequence[str]) -> bool:
    """Return whether the text has the rows `Name` and `SampleTime` of an export."""
    head = lines[:_HEAD]
    named = any(re.match(r"Name[\t;, :]", line) for line in head)
    return named and any(_SAMPLE_TIME.match(line) for line in head)


def read(lines: list[str], source: str) -> tuple[Table, tuple[str, ...]]:
    """Return the channels with the time of their group, and notes.

    **Raises** `LogError` for an export without rows of numbers, and for a field that is no number.
    """
    delimiter = _delimiter(lines)
    described, start = _description(lines, delimiter)
    names = described["Name"]
    times = [k for k, name in enumerate(names) if name == "Name"]
    rows = [
        (number, split(line, delimiter, trim=False))
        for number, line in enumerate(lines[start:], start + 1)
        if line.strip() and line.strip() != END
    ]
    if not rows:
        raise LogError("the export has no rows of numbers; export it again.", where=source)
    decimal = (
        ","
        if delimiter != "," and any("," in field for _, row in rows[:9] for field in row)
        else "."
    )
    kind = "group of channels" if len(times) == 1 else "groups of channels, each"
    notes = [f"TwinCAT Scope: {len(times)} {kind} with a time of its own"]
    if len(rows) > 1 and _is_cut(rows[-1][1], described, decimal):
        notes.append(f"the last line ({rows[-1][0]}) is cut off and left out")
        rows.pop()
    columns: list[str] = []
    arrays: list[np.ndarray] = []
    clocks: dict[int, int] = {}
    for group, first in enumerate(times, 1):
        last = times[group] if group < len(times) else len(names)
        length = _length(rows, first)
        stamps = len(columns)
        columns.append(f"time {group} [s]")
        arrays.append(_seconds(rows[:length], first, (decimal, source, columns[-1])))
        for k in range(first + 1, last):
            name = _name(described, k)
            if not name:
                continue
            values = _numbers(rows[:length], k, (decimal, source, name))
            clocks[len(columns)] = stamps
            columns.append(name)
            arrays.append(values)
    return Table(tuple(columns), tuple(arrays), source, clocks=clocks), tuple(notes)


def _is_cut(row: Sequence[str], described: Mapping[str, list[str]], decimal: str) -> bool:
    """Return whether `row` is incomplete: a group has a time in it, but a channel has no value."""
    timed = False
    for k, name in enumerate(described["Name"]):
        read = k < len(row) and to_number(row[k], decimal) is not None
        if name == "Name":
            timed = read
        elif timed and not read and _name(described, k):
            return True
    return False


def _delimiter(lines: Sequence[str]) -> str:
    """Return the delimiter, which is the character after `SampleTime` or `SampleTime[ms]`."""
    found = next(filter(None, map(_SAMPLE_TIME.match, lines[:_HEAD])))
    return found.string[found.end()]


def _description(lines: Sequence[str], delimiter: str) -> tuple[Mapping[str, list[str]], int]:
    """Return the rows that describe the channels, and the index of the first row of numbers.

    The describing rows are a mapping first field → fields.
    """
    described: dict[str, list[str]] = {}
    start = 0
    for k, line in enumerate(lines[:_HEAD]):
        fields = split(line, delimiter, trim=False)
        if fields and fields[0] and not looks_like_number(fields[0]) and "=" not in fields[0]:
            if fields[0] == "Name" or "Name" in described:
                described[fields[0]] = fields  # the last row `Name` has the channels
            start = k + 1
        elif fields and fields[0] and described:
            break
    return described, start


def _name(described: Mapping[str, list[str]], k: int) -> str:
    """Return the name of a channel (or its symbol without a name) with its unit in brackets.

    A channel with a scale factor or an offset has no unit that can be read: exports do not say
    whether their numbers contain the factor.
    """
    field = {key: row[k].strip() for key, row in described.items() if k < len(row)}
    name = field.get("Name") or field.get("SymbolName", "")
    unit = re.sub(r"\s*\(.*\)$", "", field.get("Unit", "").strip()) if name else ""
    factor, offset = (_plain(field.get(key, "")) for key in ("ScaleFactor", "Offset"))
    if unit_in(unit) and (factor not in ("", "1") or offset not in ("", "0")):
        return f"{name} [{unit} with ScaleFactor {factor or 1} and Offset {offset or 0}]"
    return f"{name} [{unit}]" if unit_in(unit) else name


def _plain(field: str) -> str:
    """Return a number as short text, such as "1" for "1,0"; other text unchanged."""
    value = to_number(field, "," if "," in field else ".")
    return field if value is None else f"{value:g}"


def _length(rows: Sequence[tuple[int, list[str]]], column: int) -> int:
    """Return the number of rows of a group, which ends where its time column is empty."""
    for k, (_, row) in enumerate(rows):
        if column >= len(row) or not row[column]:
            return k
    return len(rows)


def _seconds(
    rows: Sequence[tuple[int, list[str]]], column: int, about: tuple[str, str, str]
) -> np.ndarray:
    """Return the time of a group in s; FILETIME counts from the first stamp of the export."""
    stamps = [row[column] for _, row in rows if column < len(row)]
    if stamps and all(map(_FILETIME.fullmatch, stamps)):
        first = int(next(field for field in rows[0][1] if _FILETIME.fullmatch(field)))
        return np.array([int(stamp) - first for stamp in stamps]) * _TICK
    return _numbers(rows, column, about) * MS


def _numbers(
    rows: Sequence[tuple[int, list[str]]], column: int, about: tuple[str, str, str]
) -> np.ndarray:
    """Return the values of a column; `about` is (decimal mark, file name, column name)."""
    decimal, source, name = about
    values = []
    for number, row in rows:
        value = to_number(row[column], decimal) if column < len(row) else None
        if value is None:
            seen = row[column] if column < len(row) else ""
            raise LogError(
                f"`{seen}` is no number; correct it or remove the line.",
                where=f"{source}: line {number}, column `{name}`",
            )
        values.append(value)
    return np.array(values)
