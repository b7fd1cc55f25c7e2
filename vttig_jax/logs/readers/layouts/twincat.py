"""Export of TwinCAT Scope View: groups of channels, each with its own column of time.

The row of names begins with `Name`. Every column with the name `Name` is the time in ms of the
group of channels that follows it. There is one group for each sample time, and groups with longer
sample times have fewer rows. Rows such as `SymbolName` and `Unit` describe the channels. The last
row may be `EOF`.
"""

import re
from collections.abc import Mapping, Sequence

import numpy as np

from ....base.errors import LogError
from ..delimited import split
from ..nested import NestedTable
from ..number_format import looks_like_number, to_number
from ..units_row import unit_in

_HEAD = 60
"""Number of first lines that may describe the channels (chosen)."""

DELIMITERS = ("\t", ";", ",", " ", ":")
"""Delimiters that the export of TwinCAT offers."""

END = "EOF"
MS = 1e-3
"""Seconds in a millisecond, which is the unit of the time columns."""


def matches(lines: Sequence[str]) -> bool:
    """Return whether the text has the rows `Name` and `SampleTime[ms]` of an export."""
    head = lines[:_HEAD]
    named = any(re.match(r"Name[\t;, :]", line) for line in head)
    return named and any(line.startswith("SampleTime[ms]") for line in head)


def read(lines: list[str], source: str) -> tuple[NestedTable, tuple[str, ...]]:
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
    notes = [f"TwinCAT Scope: {len(times)} groups of channels with a time of their own"]
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
        arrays.append(_numbers(rows[:length], first, (decimal, source, columns[-1])) * MS)
        for k in range(first + 1, last):
            name = _name(described, k)
            if not name:
                continue
            values = _numbers(rows[:length], k, (decimal, source, name))
            clocks[len(columns)] = stamps
            columns.append(name)
            arrays.append(values)
    return NestedTable(tuple(columns), tuple(arrays), source, clocks=clocks), tuple(notes)


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
    """Return the delimiter, which is the character after `SampleTime[ms]`."""
    line = next(line for line in lines[:_HEAD] if line.startswith("SampleTime[ms]"))
    mark = line[len("SampleTime[ms]") :][:1]
    return mark if mark in DELIMITERS else "\t"


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
    """Return the name of a channel (or its symbol without a name) with its unit in brackets."""
    field = {key: row[k].strip() for key, row in described.items() if k < len(row)}
    name = field.get("Name") or field.get("SymbolName", "")
    unit = re.sub(r"\s*\(.*\)$", "", field.get("Unit", "").strip()) if name else ""
    return f"{name} [{unit}]" if unit_in(unit) else name


def _length(rows: Sequence[tuple[int, list[str]]], column: int) -> int:
    """Return the number of rows of a group, which ends where its time column is empty."""
    for k, (_, row) in enumerate(rows):
        if column >= len(row) or not row[column]:
            return k
    return len(rows)


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
