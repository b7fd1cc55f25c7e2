"""Text layouts whose header says the time of their columns, and files in sections.

TwinCAT Scope View: every column with the name `Name` is the time of the group of channels that
follows it, in ms or as FILETIME. There is one group for each sample time; groups with longer sample
times have fewer rows. Rows such as `SymbolName` and `Unit` describe the channels.

LabVIEW measurement (LVM): the file header says how many columns of time the rows have: one for all
channels, one for each (`Multi`), or none, where X0 and Delta_X of the segment header give the
stamps. Format: National Instruments, Specification for the LabVIEW Measurement File.

Oscilloscopes: the header states the first stamp and the increment of the time, or the rate, in rows
such as `HResolution,5e-2,5e-2` (Yokogawa), under the names `Start` and `Increment` or as `t0 = …,
tInc = …` (Rigol). Older ones of Tektronix have such rows beside the table.

Files in sections: several tables in one text, such as guide logs, reports of test stands and the
sheets of a workbook. A section begins with a line of names, perhaps a row of units, and a row of
numbers with as many fields. Its columns are named `2/motor` for column `motor` of section 2.
"""

import re
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from ...base.errors import LogError
from .column_names import (
    TIME_UNITS,
    fold,
    has_time,
    is_units_row,
    read_name,
    unit_in,
    unit_spelt,
    ways_in,
    with_units,
)
from .delimited import is_value, looks_like_number, split, to_number
from .table import ClockedColumn, Table, table_of
from .text import Lines, printable
from .text_rows import WHOLE, Row, column_of, decimal_of, numbers, rows_from
from .times import FILETIME, epoch_unit

_HEAD = 60
"""Number of first lines that may describe the channels (chosen)."""

END = "EOF"
_SAMPLE_TIME = re.compile(r"SampleTime(?:\[ms\])?(?=[\t;, :])")
"""First field of the row with the sample times, before one of the delimiters of the export."""

START, END_OF_HEADER = "LabVIEW Measurement", "***End_of_Header***"
_KEYS = ("Channels", "Samples", "X0", "Delta_X")
"""Keys of a segment header; the file header has none of them."""

_SAID = tomllib.loads(Path(__file__).with_suffix(".toml").read_text("utf-8"))
"""What the header of an oscilloscope says → its keys, in small letters without blanks."""

_SAID_BY = {key: said for said, keys in _SAID.items() for key in keys.split()}
_CLOCK = re.compile(r"inc(rement)?\b|sampl\w* ?(interval|rate)|hresolution", re.IGNORECASE)
_QUANTITY = re.compile(r"([-+]?(?:\d[\d.,]*|\.\d+)(?:[eE][-+]?\d+)?)\s*([A-Za-zµμ]*)")
_HERTZ = {"hz": 1.0, "khz": 1e3, "mhz": 1e6, "ghz": 1e9}
_VOLTS = re.compile(r"([A-Z]+\d*)\s*V")
"""Name of a channel of Rigol with its unit, such as `CH1V`."""


def read_twincat(text: Lines) -> Table | None:
    """Return the table of an export, which has the rows `Name` and `SampleTime`, or None."""
    match = next(filter(None, map(_SAMPLE_TIME.match, text[:_HEAD])), None)
    if match is None or not any(re.match(r"Name[\t;, :]", line) for line in text[:_HEAD]):
        return None
    lines = list(text)
    mark = match.string[match.end()]
    described, start = _description(lines, mark)
    names = described["Name"]
    times = [k for k, name in enumerate(names) if name == "Name"]
    ends = (k for k, line in enumerate(lines[-3:], len(lines) - 3) if line.strip() == END)
    end = max(next(ends, len(lines)), 0)
    rows, cut = rows_from(lines if end == len(lines) else [*lines[:end], ""], start, mark)
    if not rows:
        raise LogError("the export has no rows of numbers; export it again.")
    decimal = decimal_of(rows, mark)
    kind = "group of channels" if len(times) == 1 else "groups of channels, each"
    notes = [f"TwinCAT Scope: {len(times)} {kind} with a time of its own", *cut]
    columns = []
    for group, (first, last) in enumerate(zip(times, (*times[1:], len(names)), strict=True), 1):
        stamps = column_of(rows, first, f"time {group}", decimal)
        if len(stamps) and epoch_unit(stamps) == FILETIME:
            seconds = (stamps - int(rows[0][1][times[0]])) * TIME_UNITS["100ns"]
        else:
            seconds = stamps * TIME_UNITS["ms"]
        for k in range(first + 1, last):
            if name := _name(described, k):
                values = column_of(rows, k, name, decimal)
                columns.append(ClockedColumn(name, values, seconds))
    return table_of(columns, notes, start=0.0)


def _description(lines: Sequence[str], mark: str) -> tuple[Mapping[str, list[str]], int]:
    """Return the rows that describe the channels, and the index of the first row of numbers.

    The describing rows are a mapping first field → fields.
    """
    described: dict[str, list[str]] = {}
    start = 0
    for k, line in enumerate(lines[:_HEAD]):
        fields = split(line, mark, trim=False)
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


def read_lvm(text: Lines) -> Table | None:
    """Return the table of a LabVIEW measurement file, or None for another text."""
    if not text[0].lstrip("\ufeff").strip().startswith(START):
        return None
    lines = list(text)
    ends = [k for k, line in enumerate(lines) if line.strip(" \t,;").startswith(END_OF_HEADER)]
    mark = "," if any(line.startswith("Separator,") for line in lines[:40]) else "\t"
    head = (split(line, mark, trim=False) for line in (lines[: ends[-1]] if ends else []))
    header = {fields[0]: fields[1:] for fields in head if fields[0]}
    if not ends or not set(_KEYS) & set(header) or len(lines) < ends[-1] + 3:
        raise LogError("the measurement has no rows of numbers; export it again.")
    if len(ends) > 2:
        raise LogError(
            f"the file has {len(ends) - 1} segments with headers of their own; write the"
            " measurement as one segment."
        )
    axis = next((name for name in header.get("X_Dimension", []) if name), "Time")
    if axis != "Time":
        raise LogError(f"its x axis is {axis} and not time; export channels over time.")
    names = split(lines[ends[-1] + 1], mark, trim=False)
    rows, cut = rows_from(lines, ends[-1] + 2, mark)
    decimal = (header.get("Decimal_Separator") or ["."])[0] or "."
    if decimal not in (".", ","):
        raise LogError(f"its Decimal_Separator is `{decimal}`; write `.` or `,` there.")
    own = header.get("X_Columns", ["One"])[0]
    places = [k for k, name in enumerate(names) if name not in ("X_Value", "Comment", "")]
    stated = {key: [one for one in header.get(key, []) if one] for key in (*_KEYS, "Y_Unit_Label")}
    columns = []
    for place, k in enumerate(places):
        values = column_of(rows, k, names[k], decimal)
        said = {key: one[place] for key, one in stated.items() if len(one) == len(places)}
        if own == "No":
            first, step = (to_number(said.get(key, ""), decimal) for key in ("X0", "Delta_X"))
            time = (first or 0.0) + (step or 0.0) * np.arange(len(values))
        else:
            clock = k - 1 if own == "Multi" else 0
            time = column_of(rows, clock, names[clock], decimal)[: len(values)] * 1.0
        unit = said.get("Y_Unit_Label", "")
        name = f"{names[k]} [{unit}]" if unit_in(unit) else names[k]
        columns.append(ClockedColumn(name, values, time))
    table = table_of(columns, start=0.0)
    if len(set(table.clocks.values())) < 2:
        return replace(table, clocks={}, notes=("LabVIEW measurement", *cut))
    return replace(table, notes=("LabVIEW measurement: channels with stamps of their own", *cut))


def read_waveforms(text: Lines) -> Table | None:
    """Return the channels of an oscilloscope whose header says what their columns do not.

    The header stands above rows without a time, or beside the rows of a table without names: in
    the columns before a time and its channels. Else the result is None.

    **Raises** `LogError` for an increment that is no number, another axis than time, blocks that
    were recorded one after the other, and rows that have other columns than the header names.
    """
    lines = text[:_HEAD]
    if not any(map(_CLOCK.search, lines)):
        return None
    last = next(line for line in reversed(lines) if line.strip())
    mark = next((mark for mark in ";\t," if mark in last), ",")
    comment = "#%/ " + ";" * (mark != ";")
    head = [split(line.lstrip(comment), mark, trim=False) for line in lines]
    are_rows = [any(row) and all(looks_like_number(one) for one in row if one) for row in head]
    first, said = next((k for k, both in enumerate(pairwise(are_rows)) if all(both)), 0), {}
    named = _beside(head)
    if named:
        first = 0
    elif first:
        said = _stated(head[:first])
        named = _above(head[:first], head[first], said)
    if not named:
        return None
    rows, cut = rows_from(list(text), first, mark)
    decimal, columns = decimal_of(rows, mark), {}
    for k, name in named.items():
        values = column_of(rows, k, name, decimal)
        same = name not in columns or np.array_equal(columns[name], values)
        columns[name if same else f"{name} #{k + 1}"] = values
    note = "oscilloscope: the header names the channels"
    if not any(name.startswith("time [") for name in columns):
        start, step = _clock(said)
        counted = columns.pop("X", np.arange(len(rows)))
        columns = {"time [s]": start + step * counted, **columns}
        note = f"oscilloscope: time = {start:g} s + {step:g} s × sample, as the header states"
    return table_of(columns.items(), (note, *cut))


def _stated(head: Sequence[Sequence[str]]) -> dict[str, list[str]]:
    """Return key of `_SAID` → words after the key, below it, or behind an equals sign or colon."""
    found: dict[str, list[str]] = {}
    for fields, below in zip(head, [*head[1:], []], strict=True):
        for k, text in enumerate(fields):
            key, *value = re.split("[=:]", text, maxsplit=1)
            said = _SAID_BY.get(re.sub(r"\(\d+/\d+\)|[\W_]", "", fold(key)))
            values = [one for one in value or (below[k : k + 1] if k else fields[1:]) if one]
            if said == "name":  # as in `Channels (2/8): D0, D1`, and no number of channels
                values += fields[1:] if value else []
                values = [one.strip() for one in values if not looks_like_number(one)]
            if said and values:
                found.setdefault(said, values)
    return found


def _beside(head: Sequence[Sequence[str]]) -> dict[int, str]:
    """Return index → name of the columns beside a header: a time and its channels; else none."""
    rows = [row for row in head if any(row)]
    columns = zip(*rows, strict=False)
    kinds = [np.mean([looks_like_number(one) for one in column]) for column in columns]
    start, names, named = 0, list[str](), dict[int, str]()
    for k in (k for k, share in enumerate(kinds) if share > WHOLE):
        if k == 0 or kinds[k - 1] <= WHOLE:
            said = _stated([row[start:k] for row in rows])
            if "step" not in said:
                return {}
            names = [_time_in(said), *with_units(said.get("name", []), said.get("unit", []))]
        named[k] = names.pop(0) if names else f"#{k + 1}"
        start = k + 1
    return named


def _time_in(said: Mapping[str, list[str]]) -> str:
    return f"time [{said.get('axis', ['s'])[0]}]"


def _above(
    head: Sequence[Sequence[str]], row: Sequence[str], said: Mapping[str, list[str]]
) -> dict[int, str]:
    """Return index → name of the columns below a header that states a clock.

    There is none if the line of names above the rows has a time.
    """
    if "step" not in said and not {"rate", "name"} <= said.keys():
        return {}  # a rate above other tables may be that before averaging
    places, names = [k for k, one in enumerate(row) if one], said.get("name", [])
    units, size = said.get("unit", []), len(places)
    if not names:
        last = [fields[:size] for fields in head if any(fields)][-2:]
        if is_units_row(last[-1]):
            units = last.pop()
        names = [_VOLTS.sub(r"\1 [V]", name) for name in last[-1]]
        if len(names) < size or any(map(looks_like_number, names)):
            names = [f"#{k + 1}" for k in places]
    elif len(names) == size - 1:
        names, units = [_time_in(said), *names], ["", *units]
    if len(names) != size:
        raise LogError(
            f"the rows have {size} columns, but the header names {len(names)}: "
            f"`{'`, `'.join(names)}`; export the channels again."
        )
    read = [read_name(name, "") for name in names[: None if "name" not in said else 0]]
    timed = bool(read) and (read[0].role == "time" or read[0].unit in TIME_UNITS)
    labels, rest = said.get("label", []), size - timed
    if len({*labels}) == rest:
        names = [*names[:timed], *labels]
    elif timed and len(units) != rest:
        return {}  # the header says nothing that the line of names does not
    if timed:
        names, units = [_time_in(said), *names[1:]], ["", *units]
    return dict(zip(places, with_units(names, units), strict=True))


def _clock(said: Mapping[str, list[str]]) -> tuple[float, float]:
    """Return the first stamp and the increment of the time in s."""
    axis, blocks = said.get("axis", ["s"])[0], said.get("blocks", ["1"])[0]
    starts, steps = (_sizes(said.get(key, ["0"]), TIME_UNITS, axis) for key in ("start", "step"))
    if "step" not in said:
        steps = {1 / one for one in _sizes(said["rate"], _HERTZ, "hz") if one}
    what = "states no start and increment of the time in s that all channels share"
    what += f" (`{', '.join(said.get('step', []))}`); export channels over time with one rate."
    if blocks != "1":
        what = f"names {blocks} blocks (`BlockNumber`), one recorded after the other; export one."
    if blocks != "1" or len(starts) != 1 or len(steps) != 1 or not min(steps) > 0:
        raise LogError(f"the header {what}")
    return starts.pop(), steps.pop()


def _sizes(texts: Sequence[str], units: Mapping[str, float], unit: str) -> set[float]:
    """Return the different values of texts such as `20 MHz`; those without a unit are in `unit`."""
    found = _QUANTITY.findall(" ".join(texts))
    values = (
        (to_number(one, "," if "," in one else "."), unit_spelt(own or unit)) for one, own in found
    )
    return {value * units.get(own, np.nan) for value, own in values if value is not None}


DELIMITERS = (",", ";", "\t")
"""Delimiters in the order in which they are tried."""

FEWEST_ROWS = 3
"""Least number of rows of a table that counts as a section (chosen)."""

_DIGIT = re.compile(r"\d")
_WORD = re.compile(r"""^[^\S\n]*["']?[^\W\d_]""", re.MULTILINE)
"""Pattern of the beginning of a line of names."""


@dataclass
class Section:
    """One table of a text with several tables.

    **Arguments**
    - `heading`: first line of the text above the names, "" without one.
    - `names`: names of its columns. - `line`: number of the line of names.
    - `units`: row of units below the names, or None. - `rows`: its rows.
    - `others`: numbers of the lines between the rows that are not rows.
    """

    heading: str
    names: list[str]
    line: int
    units: list[str] | None = None
    rows: list[Row] = field(default_factory=list)
    others: list[int] = field(default_factory=list)

    def columns(self, number: int, mark: str) -> Iterator[tuple[str, np.ndarray]]:
        """Yield the columns whose first row is a number or a date, of rows in which none lacks.

        With the `number` 0 they have the names of the text alone.
        """
        named = with_units(self.names, self.units or [])
        first = self.rows[0][1]
        chosen = [k for k, text in enumerate(first) if is_value(text)]
        self.others += [line for line, row in self.rows if not all(row[k] for k in chosen)]
        self.rows = [row for row in self.rows if all(row[1][k] for k in chosen)]
        for k in chosen:
            name = printable(named[k])
            place = f"section {number}, column `{name}`" if number else f"column `{name}`"
            cells = [(line, row[k]) for line, row in self.rows]
            yield (
                f"{number}/{name}" if number else name,
                numbers(cells, decimal_of(self.rows, mark), place),
            )


def read_sections(lines: Lines) -> Table | None:
    """Return the columns of at least two tables, each with a line of names, or None.

    Passes up and down without a time are one table with a direction, which is that of the headings
    or of the first column that rises in some passes and falls in others.
    """
    found, mark = _sections(list(lines)) if lines.match(_WORD, 2) else ([], "")
    if not found:
        return None
    columns: dict[str, np.ndarray] = {}
    notes = []
    first, *rest = found
    least = min(len(one.names) for one in found)
    # First and last row of each section in the columns that all have; what is no number is NaN.
    edges = [(one.rows[k][1][:least], decimal_of(one.rows, mark)) for one in found for k in (0, -1)]
    ends = np.array([[to_number(text, point) for text in row] for row, point in edges], np.float64)
    rises = bool(np.all(np.diff(ends[:, 0]) > 0))
    ways = np.sign(ends[1::2] - ends[::2]).T.tolist()
    # Positions come before errors, and numbers of points rise in every pass.
    senses = next((one for one in ways if {*one} == {1.0, -1.0}), ways[0])
    said = [ways_in(one.heading) for one in found]
    if all(len(ways) == 1 for ways in said):
        senses = [sense for ways in said for sense in ways]
    passes = not has_time(first.names) and {*senses} == {1.0, -1.0}
    if (rises or passes) and all(one.names == first.names for one in rest):
        starts = [one.line for one in found]
        first.rows += [row for one in rest for row in one.rows]
        columns.update(first.columns(0, mark))
        if rises:  # one clock, a header a page
            note = f"the names are written {len(found)} times, and the rows go on below them: one"
            return table_of(columns.items(), [f"{note} table"])
        own = np.searchsorted(starts, [line for line, _ in first.rows]) - 1
        note = f"{len(found)} passes up and down below one another are one table"
        direction = "direction", np.take(senses, own)
        return table_of([*columns.items(), direction], [note], ways={len(columns): "+"})
    for number, section in enumerate(found, 1):
        columns.update(section.columns(number, mark))
        heading = f" `{printable(section.heading[:40])}`" if section.heading else ""
        note = f"section {number}{heading} at line {section.line}: {len(section.rows)} rows"
        if section.others:
            note += f"; {len(section.others)} lines between them are left out, the first is line"
            note += f" {min(section.others)}"
        notes.append(f"{note}; `--column driving={number}/NAME` chooses it")
    return table_of(columns.items(), notes)


def _sections(lines: Sequence[str]) -> tuple[list[Section], str]:
    """Return the sections of a text and its delimiter; no sections if there are fewer than two."""
    for mark in (mark for mark in DELIMITERS if any(mark in line for line in lines)):
        found = [one for one in _walk(lines, mark) if len(one.rows) >= FEWEST_ROWS]
        if len(found) > 1:
            return found, mark
    return [], DELIMITERS[0]


def _walk(lines: Sequence[str], mark: str) -> Iterator[Section]:
    """Yield the tables of a text in their order."""
    current = Section("", [], 0)  # what stands above the first table is none
    heading, between, parted = "", [], True
    for number, line in enumerate(lines, 1):
        if not line.strip():
            heading, parted = "", True
            continue
        fields = split(line, mark)
        # A line of text between two rows is a damaged row, unless it repeats the names.
        begins = parted or fields == current.names
        parted = False
        if begins and _WORD.match(line) and _is_header(fields, lines, number, mark):
            yield current
            current = Section(heading, fields, number)
            heading, between = "", []
        elif current.names and len(fields) == len(current.names) and _has_numbers(fields):
            current.others += between
            current.rows.append((number, fields))
            between = []
        elif current.names and not current.rows and is_units_row(fields):
            current.units = fields
        else:
            heading, parted = heading or line.strip(), True
            between.append(number)
    yield current


def _is_header(fields: list[str], lines: Sequence[str], number: int, mark: str) -> bool:
    """Return whether `fields`, from the line `number`, are names above a row of numbers."""
    if len(fields) < 2 or not any(map(_DIGIT.search, lines[number : number + 4])):
        return False
    if not all(fields) or any(map(looks_like_number, fields)):
        return False
    below = [line for line in lines[number : number + 4] if line.strip()]
    rows = [split(line, mark) for line in below[:2]]
    row = rows[-1] if is_units_row(rows[0]) else rows[0]
    return len(row) == len(fields) and _has_numbers(row)


def _has_numbers(fields: list[str]) -> bool:
    """Return whether the first field is a number or a date, or more than half of the fields are."""
    kinds = list(map(is_value, fields))
    return kinds[0] or 2 * sum(kinds) > len(kinds)
