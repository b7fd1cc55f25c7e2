"""Text layouts of one sample a line, and the output of LinuxCNC halsampler.

Layouts with one sample of one channel a line: `candump | cantools decode`, EPICS, long tables.

Every channel has time stamps of its own. A frame of cantools may take several lines. A line of
EPICS `camonitor` is a change of a channel: its name, date and time, the value, and status and
severity if they are not normal; `***` says that a channel is disconnected. A row of a long table
has the time, the name of a channel and a number.

Output of LinuxCNC `halsampler` with lost samples: lines `overrun` between the rows of numbers.

The rows have neither header nor time. With the option -t of halsampler, the first field is the
number of the sample. An output without a line `overrun` is read like any table without a header.
"""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from ...base.errors import LogError
from .binary import ClockedColumn, table_of
from .delimited import looks_like_number, split
from .layouts import SPARE, Cell, Found, Row, content, cut_at, numbers
from .table import MOST_COLUMNS, Table
from .text import Lines
from .times import exact_numbers, looks_like_stamp, read_stamps

_CHANGE = re.compile(r"(\S+)\s+(\d{4}-\d\d-\d\d \d\d:\d\d:\d\d(?:\.\d+)?)\s+(\S+)(?:\s+(.*))?")
_STOP = "***"
INVALID = "INVALID"
"""Severity of a value that the channel itself marks as wrong."""

_FRAME = re.compile(
    r"\((?P<stamp>[\d.: -]+)\)\s+\S+\s+[0-9A-Fa-f]+\s+\[\d+\]\s+(?:[0-9A-Fa-f]{2}\s+)*::"
    r"(?P<rest>.*)"
)
_MESSAGE = re.compile(r"\s*(?P<name>[^\s(]+)\((?P<signals>.*)\)\s*")
_SIGNAL = re.compile(r"\s*(?P<name>[^\s:,]+):\s*(?P<value>[^\s,]+)(?:\s+(?P<unit>[^,]+?))?\s*")

_DELIMITERS = ("\t", ";", ",")
SAMPLE = 400
"""Number of rows from which a long table is recognised (chosen)."""

_MOST_CHANNELS = 50
"""Largest number of different channel names in these rows (chosen)."""

WHOLE = 0.9
"""Least share of these rows that have the usual form; others are damaged (chosen)."""

_FEWEST = 4
"""Least mean number of rows per channel (chosen)."""


@dataclass
class Channels:
    """Stamps and values of the channels as text, collected line by line."""

    stamps: dict[str, list[str]] = field(default_factory=dict)
    cells: dict[str, list[Cell]] = field(default_factory=dict)

    def add(self, name: str, stamp: str, value: str, line: int) -> None:
        """Append one sample."""
        self.stamps.setdefault(name, []).append(stamp)
        self.cells.setdefault(name, []).append((line, value))

    def found(self, source: str, notes: Sequence[str], *, held: bool = False) -> Found:
        """Return the numeric channels with their stamps in s since the earliest one, and the notes.

        **Raises** `LogError` for a file without numbers and for stamps that cannot be read.
        """
        kept = {
            name: cells
            for name, cells in self.cells.items()
            if len(cells) > 1 and looks_like_number(cells[-1][1])
        }
        if not kept:
            raise LogError(
                "no channel of this file holds numbers; export the log again.", where=source
            )
        stamps = [stamp for name in kept for stamp in self.stamps[name]]
        dated = looks_like_stamp(stamps[0])
        seconds = read_stamps(stamps, source)[0] / 1e9 if dated else exact_numbers(stamps)
        if seconds is None:
            raise LogError("the time stamps are no numbers; export the log again.", where=source)
        ends = np.cumsum([len(cells) for cells in kept.values()])[:-1]
        columns = (
            ClockedColumn(name, numbers(cells, ".", source, f"channel `{name}`"), own)
            for (name, cells), own in zip(kept.items(), np.split(seconds, ends), strict=True)
        )
        return table_of(columns, source, held=held, start=float(seconds.min())), tuple(notes)


def read_changes(lines: Lines, source: str) -> Found | None:
    """Return the channels of EPICS, or None unless all first lines are changes of them."""
    first = content(lines)
    seen = [_CHANGE.fullmatch(line) is not None for line in first]
    if not any(seen) or not all(
        own or _STOP in line for own, line in zip(seen, first, strict=True)
    ):
        return None
    channels = Channels()
    lost = invalid = 0
    notes = ["EPICS camonitor: only changes are logged, between which a channel keeps its value"]
    for number, line in enumerate(lines, 1):
        match = _CHANGE.fullmatch(line.strip())
        if _STOP in line or not line.strip():
            lost += _STOP in line
        elif match is None:
            what = "this line is none of `camonitor` (name, date, time, value); remove it."
            notes += cut_at(list(lines), number, source, what)
        elif INVALID in (match[4] or "") and "UDF" not in match[4]:
            invalid += 1
        else:
            channels.add(match[1], match[2], match[3], number)
    if lost:
        notes.append(f"channels were disconnected {lost} times; values are held across the gaps")
    if invalid:
        notes.append(f"{invalid} values with severity INVALID are left out")
    return channels.found(source, notes, held=True)


def read_frames(text: Lines, source: str) -> Found | None:
    """Return the signals `Message.Signal [unit]`; an incomplete last message is left out.

    The result is None unless one of the first lines is a decoded frame.
    """
    if not any(map(_FRAME.fullmatch, content(text))):
        return None
    channels, lines = Channels(), list(text)
    undecoded = cut = 0
    for number, stamp, rest in _messages(lines):
        message = _MESSAGE.fullmatch(rest)
        if message is None:
            cut += number > len(lines) - SPARE and "(" in rest
            undecoded += 1
            continue
        for signal in filter(None, map(_SIGNAL.fullmatch, message["signals"].split(","))):
            unit = f" [{signal['unit']}]" if signal["unit"] else ""
            name = f"{message['name']}.{signal['name']}{unit}"
            channels.add(name, stamp, signal["value"], number)
    if not channels.cells:
        raise LogError("no frame of this file is decoded; give cantools the DBC.", where=source)
    notes = ["cantools decode: every message has its own time stamps"]
    if cut:
        notes.append("the last message is cut off and left out")
    if undecoded - cut:
        notes.append(f"{undecoded - cut} frames without decoded signals are left out")
    return channels.found(source, notes)


def _messages(lines: Sequence[str]) -> Iterator[tuple[int, str, str]]:
    """Yield line number, stamp, and the text `Message(signals)` joined to one line."""
    number, stamp, parts = 0, "", []
    for k, line in enumerate((*lines, "(0) x 0 [0] ::"), 1):  # a frame after the last one
        frame = _FRAME.fullmatch(line.strip())
        if frame is None:
            parts.append(line.strip())
            continue
        if stamp:
            yield number, stamp, " ".join(parts)
        number, stamp, parts = k, frame["stamp"].strip(), [frame["rest"].strip()]


def _long_columns(lines: Sequence[str]) -> tuple[str, tuple[int, int, int]] | None:
    """Return the delimiter and the column indices of time, name and value, or None."""
    for mark in _DELIMITERS:
        head, *rows = (split(line, mark) for line in lines[: SAMPLE + 1])
        rows = [row for row in rows if row][:-1]
        usual = max(map(len, rows), key=[*map(len, rows)].count, default=0)
        whole = [row for row in rows if len(row) == usual]
        roles = roles_of(head, whole) if len(whole) > WHOLE * len(rows) else None
        if roles is not None:
            return mark, roles
    return None


def read_long(text: Lines, source: str) -> Found | None:
    """Return the channels of a table whose rows are a time, a name of a few, and a number."""
    found = _long_columns(text)
    if found is None:
        return None
    (mark, roles), lines = found, list(text)
    rows: list[Row] = []
    notes: list[str] = []
    for number, line in enumerate(lines[1:], 2):
        fields = split(line, mark)
        if len(fields) > max(roles):
            rows.append((number, fields))
        elif fields:
            what = "this line has too few fields; correct it or remove it."
            notes += cut_at(lines, number, source, what)
    return read_long_rows(rows, roles, source, notes, comma=mark != ",")


def read_long_rows(
    rows: Sequence[Row],
    roles: tuple[int, int, int],
    source: str,
    notes: Sequence[str] = (),
    *,
    comma: bool = False,
) -> Found:
    """Return the channels of a long table from its rows and the columns of time, name and value."""
    time, name, value = roles
    channels = Channels()
    for number, row in rows:
        text = row[value].replace(",", ".") if comma else row[value]
        channels.add(row[name], row[time], text, number)
    return channels.found(source, ["long table: every channel has its own time stamps", *notes])


def roles_of(head: Sequence[str], rows: Sequence[Sequence[str]]) -> tuple[int, int, int] | None:
    """Return the columns of time, name and value of a long table; None for any other table."""
    if len(rows) < _FEWEST - 1 or not 3 <= len(head) == len(rows[0]) <= 5:
        return None
    if any(map(looks_like_number, head)):
        return None
    names, times, values = [], [], []
    for k, column in enumerate(zip(*rows, strict=True)):
        if np.mean([looks_like_stamp(text) for text in column]) > WHOLE:
            times.append(k)
        elif np.mean([looks_like_number(text) for text in column]) > WHOLE:
            values.append(k)
        elif not any(map(looks_like_number, column)) and _repeats(column):
            names.append(k)
    if not times and len(values) == 2:
        times = [values.pop(0)]
    if len(names) == len(times) == len(values) == 1:
        return times[0], names[0], values[0]
    return None


def _repeats(column: Sequence[str]) -> bool:
    """Return whether a column contains few different names, each often and mixed with others."""
    different = len(set(column))
    changes = sum(a != b for a, b in pairwise(column))
    often = different * _FEWEST <= len(column) or different * 2 <= len(column) < _FEWEST * 4
    return 2 <= different <= _MOST_CHANNELS and often and changes >= different


OVERRUN = "overrun"
LOST = 10
"""Number of samples assumed to be lost in a gap of unknown length (chosen). It is more than five,
so that all later steps treat the gap as a pause."""


def read_halsampler(text: Lines, source: str) -> Found | None:
    """Return rows of numbers with lines `overrun` between them, or None for another text."""
    if not text.have(OVERRUN) or OVERRUN not in (line.strip() for line in text):
        return None
    first = next((line for line in text if line.strip() not in ("", OVERRUN)), "").split()
    if not 0 < len(first) <= MOST_COLUMNS or not all(map(looks_like_number, first)):
        return None
    lines, rows = list(text), list[Row]()
    gaps: list[int] = []
    for number, line in enumerate(lines, 1):
        fields = line.split()
        if fields == [OVERRUN]:
            gaps.append(len(rows))
        elif fields:
            if rows and len(fields) != len(rows[0][1]):
                if not any(rest.strip() for rest in lines[number:]):
                    break  # the last line is cut off
                raise LogError(
                    f"this row has {len(fields)} fields, but the first one has {len(rows[0][1])};"
                    " correct it or remove the line.",
                    where=f"{source}: line {number}",
                )
            rows.append((number, fields))
    names = tuple(f"#{k + 1}" for k in range(len(rows[0][1])))
    arrays = tuple(
        numbers([(number, row[k]) for number, row in rows], ".", source, f"column {name}")
        for k, name in enumerate(names)
    )
    inner = [gap for gap in gaps if 0 < gap < len(rows)]
    counts, counted = _sample_numbers(arrays[0], inner)
    how = "as the sample numbers say" if counted else f"each taken as {LOST} samples"
    note = f"halsampler: {len(inner)} gaps where samples were lost, {how}"
    return Table(names, arrays, source, sample_numbers=counts), (note,)


def _sample_numbers(first: np.ndarray, gaps: list[int]) -> tuple[np.ndarray, bool]:
    """Return the number of each sample, and whether the first column contains these numbers.

    `first` is the first column; `gaps` are the indices of the rows after a gap.
    """
    steps = np.diff(first)
    inside = np.delete(steps, [gap - 1 for gap in gaps])
    wraps = np.unique(inside[inside != 1])
    counted = first.dtype.kind == "i" and np.all(inside[inside != 1] < 0) and len(wraps) <= 1
    if counted and np.mean(inside == 1) > 0.9:
        modulus = 1 - int(wraps[0]) if len(wraps) else 0
        if modulus:
            steps = np.mod(steps, modulus)
        if np.all(steps > 0):
            return np.concatenate([[0], np.cumsum(steps)]), True
    numbers = np.arange(len(first))
    for gap in gaps:
        numbers[gap:] += LOST
    return numbers, False
