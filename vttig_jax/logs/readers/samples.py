"""Text layouts of one sample a line: cantools, EPICS, InfluxDB, long tables and halsampler.

In `candump | cantools decode`, EPICS `camonitor` and long tables every channel has time stamps of
its own. A frame of cantools may take several lines. A line of `camonitor` is a change of a channel:
its name, date and time, the value, and status and severity if they are not normal; `***` says that
a channel is disconnected. A row of a long table has the time, the name of a channel and a number;
an annotated CSV of InfluxDB names its channels by their tags.

In the output of LinuxCNC `halsampler` lines `overrun` between the rows of numbers say that samples
are lost. The rows have neither header nor time. With its option -t the first field is the number of
the sample. An output without a line `overrun` is read like any table without a header.
"""

import re
from collections.abc import Iterator, Sequence
from contextlib import suppress
from functools import partial

import numpy as np

from ...base.errors import LogError
from ..source import Source
from .column_names import SHAFT_UNITS, WAYS, fold, name_and_unit
from .delimited import TextTable, is_value, looks_like_number, split
from .table import MOST_COLUMNS, ClockedColumn, Table, table_of
from .text import Lines
from .text_rows import SPARE, WHOLE, Row, content, cut_at, numbers
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

_INFLUX = {"_time", "_value"}
_NO_TAGS = ("", "result", "table", "_start", "_stop", "_time", "_value", "_field")

_FEWEST = 4
"""Least mean number of rows per channel (chosen)."""


class Channels(dict[str, list[tuple[int, str, str]]]):
    """Line, stamp and value of each sample as text, by the name of its channel."""

    def add(self, name: str, stamp: str, value: str, line: int) -> None:
        """Append one sample."""
        self.setdefault(name, []).append((line, stamp, value))

    def table(self, notes: Sequence[str], *, held: bool = False) -> Table:
        """Return the numeric channels with their stamps in s since the earliest one, and the notes.

        **Raises** `LogError` for a file without numbers and for stamps that cannot be read.
        """
        kept = {k: one for k, one in self.items() if len(one) > 1 and looks_like_number(one[-1][2])}
        if not kept:
            raise LogError("no channel of this file holds numbers; export the log again.")
        lines, stamps, _ = zip(*(sample for one in kept.values() for sample in one), strict=True)
        dated, place = looks_like_stamp(stamps[0]), Source("", line_of=lines.__getitem__)
        seconds = read_stamps(stamps, partial(place.at, ""))[0] if dated else exact_numbers(stamps)
        if seconds is None:
            raise LogError("the time stamps are no numbers; export the log again.")
        ends = np.cumsum([len(one) for one in kept.values()])[:-1]
        columns = []
        for (name, one), own in zip(kept.items(), np.split(seconds, ends), strict=True):
            cells = [(line, value) for line, _, value in one]
            values = numbers(cells, ".", f"channel `{name}`")
            columns.append(ClockedColumn(name, values, own))
        return table_of(columns, notes, held=held, start=float(seconds.min()))


def read_changes(lines: Lines) -> Table | None:
    """Return the channels of EPICS, or None unless all first lines are changes of them."""
    first = content(lines)
    seen = [_CHANGE.fullmatch(line) is not None for line in first]
    stops = [_STOP in line for line in first]
    if not any(seen) or not all(np.logical_or(seen, stops)):
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
            notes += cut_at(list(lines), number, what)
        elif INVALID in (match[4] or "") and "UDF" not in match[4]:
            invalid += 1
        else:
            channels.add(match[1], match[2], match[3], number)
    if lost:
        notes.append(f"channels were disconnected {lost} times; values are held across the gaps")
    if invalid:
        notes.append(f"{invalid} values with severity INVALID are left out")
    return channels.table(notes, held=True)


def read_frames(text: Lines) -> Table | None:
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
    if not channels:
        raise LogError("no frame of this file is decoded; give cantools the DBC.")
    notes = ["cantools decode: every message has its own time stamps"]
    if cut:
        notes.append("the last message is cut off and left out")
    if undecoded - cut:
        notes.append(f"{undecoded - cut} frames without decoded signals are left out")
    return channels.table(notes)


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


def _long_columns(lines: Sequence[str]) -> tuple[str, str, tuple[int, int, int]] | None:
    """Return the delimiter, name of the value and column indices of time, name and value, or None.

    Where the first rows have a single channel, rows of the whole text tell whether others follow.
    """
    for mark in _DELIMITERS:
        head, *rows = (split(line, mark) for line in lines[: SAMPLE + 1])
        rows = [row for row in rows if row][:-1]
        usual = max(map(len, rows), key=[*map(len, rows)].count, default=0)
        whole = [row for row in rows if len(row) == usual]
        if len(whole) <= WHOLE * len(rows):
            continue
        roles = roles_of(head, whole)
        if roles is None and len(lines) > SAMPLE and 2 <= sum(map(is_value, whole[0])) < usual:
            thinned = (split(line, mark) for line in lines[1 : -1 : len(lines) // SAMPLE])
            roles = roles_of(head, [row for row in thinned if len(row) == usual])
        if roles is not None:
            return mark, head[roles[2]], roles
    return None


def read_long(text: Lines) -> Table | None:
    """Return the channels of a table whose rows are a time, a name of a few, and a number."""
    if (annotated := _read_influx(text)) is not None:
        return annotated
    found = _long_columns(text)
    if found is None:
        return None
    (mark, header, roles), lines = found, list(text)
    rows: list[Row] = []
    notes: list[str] = []
    for number, line in enumerate(lines[1:], 2):
        fields = split(line, mark)
        if len(fields) > max(roles):
            rows.append((number, fields))
        elif fields:
            what = "this line has too few fields; correct it or remove it."
            notes += cut_at(lines, number, what)
    return read_long_rows(rows, roles, notes, comma=mark != ",", header=header)


def _read_influx(text: Lines) -> Table | None:
    """Return the channels of an annotated CSV of InfluxDB, or None for another text.

    A channel is named by its tags and its field, without those that all channels share; the unit of
    a shared field belongs to each of them.
    """
    head = next((split(line, ",") for line in content(text) if not line.startswith("#")), [])
    if not {*head} >= _INFLUX:
        return None
    channels, lines, notes = Channels(), list(text), list[str]()
    for number, line in enumerate(lines, 1):
        fields = split(line, ",", trim=False)
        if line.startswith("#") or not any(fields):
            continue
        if {*fields} >= _INFLUX:  # another table with other tags
            head = fields
        elif len(fields) < len(head):
            what = "this line has too few fields; correct it or remove it."
            notes += cut_at(lines, number, what)
        else:
            row = dict(zip(head, fields, strict=False))
            own = [field for tag, field in row.items() if tag not in _NO_TAGS]
            name = "\t".join([*own, row.get("_field", "")])
            channels.add(name, row["_time"], row["_value"], number)
    labels = [name.split("\t") for name in channels]
    shared = set.intersection(*map(set, labels)) if len(labels) > 1 else set[str]()
    short = [" ".join(tag for tag in own if tag and tag not in shared) for own in labels]
    names = [_with_unit(name, own[-1]) for name, own in zip(short, labels, strict=True)]
    channels = Channels(zip(names, channels.values(), strict=True))
    return channels.table(["InfluxDB: every channel has its own time stamps", *notes])


def _with_unit(name: str, header: str) -> str:
    """Return a name of a channel, with the unit in the name of its values if it has none itself."""
    (_, unit), (_, own) = (name_and_unit(text, SHAFT_UNITS, "") for text in (header, name))
    return f"{name} [{unit}]" if unit and not own else name


def read_long_rows(
    rows: Sequence[Row],
    roles: tuple[int, int, int],
    notes: Sequence[str] = (),
    *,
    comma: bool = False,
    header: str = "",
) -> Table:
    """Return the channels of a long table from its rows and the columns of time, name and value.

    `header` is the name of the column of values, whose unit a channel without one has.
    """
    time, name, value = roles
    channels = Channels()
    names = {text: _with_unit(text, header) for text in {row[name] for _, row in rows}}
    for number, row in rows:
        text = row[value].replace(",", ".") if comma else row[value]
        channels.add(names[row[name]], row[time], text, number)
    return channels.table(["long table: every channel has its own time stamps", *notes])


def roles_of(head: Sequence[str], rows: Sequence[Sequence[str]]) -> tuple[int, int, int] | None:
    """Return the columns of time, name and value of a long table; None for any other table."""
    if len(rows) < _FEWEST - 1 or not 3 <= len(head) == len(rows[0]):
        return None
    if any(map(looks_like_number, head)):
        return None
    names, times, values = [], [], []
    columns = list(zip(*rows, strict=True))
    for k, column in enumerate(columns):
        if len({*column}) == 1:  # a kind of event, or its duration
            continue
        if np.mean([looks_like_stamp(text) for text in column]) > WHOLE:
            times.append(k)
        elif np.mean([looks_like_number(text) for text in column]) > WHOLE:
            values.append(k)
        elif not any(map(looks_like_number, column)):
            names += [k] * (not WAYS.keys() >= {*map(fold, column)})
    if not times and len(values) == 2:
        times = [values.pop(0)]
    if len(times) != 1 or len(values) != 1:
        return None
    names = [k for k in names if _repeats(columns[k], columns[times[0]])]
    return (times[0], names[0], values[0]) if len(names) == 1 else None


def _repeats(column: Sequence[str], times: Sequence[str]) -> bool:
    """Return whether a column contains few different names, each often.

    They are mixed with others, or come one after the other, and the time falls at each new one.
    """
    different = len(set(column))
    changes = [k for k in range(1, len(column)) if column[k] != column[k - 1]]
    often = different * _FEWEST <= len(column) or different * 2 <= len(column) < _FEWEST * 4
    if not 2 <= different <= _MOST_CHANNELS or not often:
        return False
    if len(changes) >= different:
        return True
    with suppress(LogError):
        dated = looks_like_stamp(times[0])
        seconds = read_stamps(times, lambda _: "")[0] if dated else exact_numbers(times)
        return seconds is not None and all(seconds[k] < seconds[k - 1] for k in changes)
    return False


OVERRUN = "overrun"
LOST = 10
"""Number of samples assumed to be lost in a gap of unknown length (chosen). It is more than five,
so that all later steps treat the gap as a pause."""


def read_halsampler(text: Lines) -> Table | None:
    """Return rows of numbers with lines `overrun` between them, or None for another text."""
    if not text.have(OVERRUN) or OVERRUN not in (line.strip() for line in text):
        return None
    first = next((line for line in text if line.strip() not in ("", OVERRUN)), "").split()
    if not 0 < len(first) <= MOST_COLUMNS or not all(map(looks_like_number, first)):
        return None
    gaps, kept, size = [], list[str](), 0
    for line in text:
        gaps += [size] * (line.strip() == OVERRUN)
        kept.append("" if line.strip() == OVERRUN else line)
        size += bool(kept[-1].strip())
    names = tuple(f"#{k + 1}" for k in range(len(first)))
    table = TextTable(names, Lines("\n".join(kept)), -1, None, decimal=".")
    inner = [gap for gap in gaps if 0 < gap < size]
    (numbered,) = table.own_columns([0], keep_last=True)
    table.sample_numbers, counted = _sample_numbers(numbered, inner)
    how = "as the sample numbers say" if counted else f"each taken as {LOST} samples"
    note = f"halsampler: {len(inner)} gaps where samples were lost, {how}"
    table.notes = (note, *table.notes)
    return table


def _sample_numbers(first: np.ndarray, gaps: list[int]) -> tuple[np.ndarray, bool]:
    """Return the number of each sample, and whether the first column contains these numbers.

    `first` is the first column; `gaps` are the indices of the rows after a gap.
    """
    steps = np.diff(first)
    inside = np.delete(steps, [gap - 1 for gap in gaps])
    wraps = np.unique(inside[inside != 1])
    counted = not np.any(first % 1) and np.all(inside[inside != 1] < 0) and len(wraps) <= 1
    if counted and np.mean(inside == 1) > 0.9:
        modulus = 1 - int(wraps[0]) if len(wraps) else 0
        if modulus:
            steps = np.mod(steps, modulus)
        if np.all(steps > 0):
            return np.concatenate([[0], np.cumsum(steps)]).astype(np.int64), True
    numbers = np.arange(len(first))
    for gap in gaps:
        numbers[gap:] += LOST
    return numbers, False
