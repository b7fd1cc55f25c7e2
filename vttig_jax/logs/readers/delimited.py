"""Tables of delimited text: their delimiter, header, rows and columns, and the numbers in them.

pyarrow parses the columns. What it refuses (thousands marks, rows of unequal length, damaged
fields) is read field by field, which either converts a field or names its line and column.

Thousands marks are the mark that is not the decimal mark, apostrophes and no-break spaces: 1,234.5,
1'234.5 and 1 234.5. `1,234` can mean 1.234 or 1234. If tabs or semicolons delimit the fields, the
comma is a decimal comma. Otherwise the argument `decimal` is required, unless another number in the
log resolves the ambiguity.
"""

import csv
import re
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from itertools import accumulate, islice, zip_longest
from typing import Any

import numpy as np
from jaxtyping import Real

from ...base.errors import LogError
from ...pair.schema import LogLayout
from ..channel.unwrap import EXACT_FLOAT
from ..source import SKIP
from .column_names import (
    TIME_UNITS,
    WAYS,
    bracket_of,
    first_way,
    fold,
    is_units_row,
    unit_in,
    ways_in,
    with_units,
)
from .table import MOST_COLUMNS, Table
from .text import Lines
from .times import looks_like_stamp

_PLAIN = r"[+-]?(?:\d+{0}?\d*|{0}\d+)(?:[eE][+-]?\d+)?"
_NUMBER = {mark: re.compile(_PLAIN.format(re.escape(mark))) for mark in ".,"}
_GROUPED = {
    mark: re.compile(rf"[+-]?\d{{1,3}}(?:{re.escape(mark)}\d{{3}})+(?!\d)") for mark in ".,"
}
_BLANKS = re.compile("['\u2019\u00a0\u2009\u202f]")
_BLANK_GROUPED = re.compile(rf"[+-]?\d{{1,3}}(?:{_BLANKS.pattern}\d{{3}})+(?!\d)")
_OTHER = re.compile("[^\\d.,+\\-eE'\u2019\u00a0\u2009\u202f]")
_SEXAGESIMAL = re.compile(
    r"""([+-]?)\s*(\d+)\s*°\s*(\d+)\s*['′]\s*(?:(\d+[.,]?\d*)\s*(?:["″]|''))?"""
)
"""Degrees, minutes and seconds of an angle, such as 12°30'05.2"."""

_QUOTED_COMMA = re.compile(r'"[^"\n]*,')
_UNIT_BEHIND = re.compile(r"(?<=\d) +[^\W\d]+$")
_NOT_FINITE = re.compile(r"[+-]?(?:nan|inf|infinity|∞)", re.IGNORECASE)

CURE = 'give --decimal "." or --decimal ","'


def looks_like_number(field: str) -> bool:
    """Return whether a field is a number with a decimal point or comma, or nan or inf."""
    try:  # most fields of a table are plain numbers, and most others have other characters
        float(field)
        return "_" not in field
    except ValueError:
        if _OTHER.search(field.strip()):
            return _SEXAGESIMAL.fullmatch(field.strip()) is not None
    return any(to_number(field, mark) is not None for mark in ".,")


def to_number(field: str, decimal: str) -> float | None:
    """Return the value of a field with a known decimal mark, or None if it is not a number.

    With a decimal point, commas may group thousands (`1,234.5`), and vice versa.
    """
    text = _without_thousands_blanks(field)
    if _NOT_FINITE.fullmatch(text):
        return float(text.replace("∞", "inf"))
    if angle := _SEXAGESIMAL.fullmatch(text):
        sign, degrees, minutes, seconds = angle.groups()
        size = int(degrees) + int(minutes) / 60 + float((seconds or "0").replace(",", ".")) / 3600
        return -size if sign == "-" else size
    if not _NUMBER[decimal].fullmatch(text):
        grouped = _thousands(text, "," if decimal == "." else ".")
        if grouped is None:
            return None
        text = grouped
    return float(text.replace(decimal, "."))


def choose_decimal(fields: Sequence[str], delimiter: str | None, where: str) -> str:
    """Return the decimal mark "." or "," of number fields, some of which may contain a comma.

    **Raises** `LogError` if the mark is ambiguous.
    """
    with_comma = [_without_thousands_blanks(field) for field in fields if "," in field]
    if not with_comma:
        return "."
    example = with_comma[0]
    if any("." in field for field in fields):
        raise LogError(
            f"the log has numbers with commas (`{example}`) and numbers with points; {CURE}.",
            where=where,
        )
    if delimiter in (";", "\t"):
        return ","
    if all(_GROUPED[","].fullmatch(field) for field in with_comma):
        raise LogError(
            f"`{example}` means {example.replace(',', '.')} or {example.replace(',', '')}; {CURE}.",
            where=where,
        )
    return ","


def _without_thousands_blanks(field: str) -> str:
    """Return the field without the apostrophes and no-break spaces that separate thousands."""
    text = field.strip()
    head = _BLANK_GROUPED.match(text)
    if head is None:
        return text
    return _BLANKS.sub("", head[0]) + text[head.end() :]


def _thousands(text: str, mark: str) -> str | None:
    """Return `text` without its thousands marks, or None if their positions are wrong."""
    head = _GROUPED[mark].match(text)
    if head is None or mark in text[head.end() :]:
        return None
    rest = text.replace(mark, "")
    return rest if _NUMBER["." if mark == "," else ","].fullmatch(rest) else None


DELIMITERS = ("\t", ";", ",", "|", None)
"""Delimiters in the order in which they are tried; None means one or more blanks."""

NAMED = {"tab": "\t", "\\t": "\t", "space": None, " ": None, "semicolon": ";", "comma": ","}

PREAMBLE = 1000
"""Number of lines in which the first row of numbers is searched (chosen)."""

COMMENTS = ("#", "%", "//")

EMPTY = b" \t\r\n;,|"
"""Bytes of lines without content, such as empty rows at the end of a spreadsheet."""

_SEPARATOR = re.compile(r'"?sep=(\\t|.)"?', re.IGNORECASE)
"""Pattern of the first line of a file for Excel that names the delimiter."""

_COMMENT = re.compile(r"(?:^| )\s*#.*", re.DOTALL)
"""Comment at the end of a line."""

_WORD = re.compile(r".*[^\W\d_]{2}|\W{3}")
"""Start of a field that holds a word or is a ruled line, and is no number that was cut off."""

_RULED = re.compile(r"[-+|\s]+")
"""Line between the names and the rows, or between rows, of a printed table."""

_GAPS = "- -- --- – — nan NaN NAN NA N/A n/a n.a. #N/A #NV null NULL None none"
NO_NUMBERS = frozenset(("", *_GAPS.split()))
"""Fields without a number that the option `--missing skip` accepts."""

_SECONDS = re.compile(r"""\D*[;,\t|]\s*"\s*(?:[;,\t|]\D*)?""")
"""Row of names or units with a quotation mark alone in a field, which is the unit of seconds."""

_APART = re.compile(r"\s{2,}")
_LONGEST = 10_000  # most characters of the name of a column (chosen)
_FAR = 3.0  # steps of the rows above by which a number that was cut off lies apart (chosen)
_SHOWN = 40
"""Number of characters of a text below the table that its note shows (chosen)."""


def split(line: str, delimiter: str | None, *, trim: bool = True) -> list[str]:
    """Return the stripped fields of a line; `trim` removes empty fields at its end.

    A `delimiter` of None means one or more blanks.
    """
    if delimiter is None:
        fields = line.split()
    elif '"' in line and len(line) < csv.field_size_limit() and not _SECONDS.fullmatch(line):
        fields = next(csv.reader([line], delimiter=delimiter, skipinitialspace=True))
    else:
        fields = line.split(delimiter)
    fields = [field.strip() for field in fields]
    while trim and fields and not fields[-1]:
        fields.pop()
    return fields


def _stripped(line: str, delimiter: str | None) -> str:
    """Return a line without blanks around it; a tab that delimits an empty first field stays."""
    return line.strip(" \r\n") if delimiter == "\t" else line.strip()


def is_value(field: str) -> bool:
    """Return whether a field is a number, a date with time, or a time of day."""
    return looks_like_number(field) or looks_like_stamp(field)


class RowTooLong(LogError):
    """A row with more fields than the header has names: no column of it is certain."""


class TextTable(Table):
    """Table in a text. The rows start after the line `header`, −1 for a text without header.

    `missing` is true if fields without a number are NaN, and no error.
    """

    def __init__(
        self,
        names: Sequence[str],
        lines: Lines,
        header: int,
        delimiter: str | None,
        *,
        decimal: str | None,
        source: str = "",
        missing: bool = False,
    ):
        super().__init__(tuple(names), (), source)
        self.lines, self.header, self.delimiter, self.decimal = lines, header, delimiter, decimal
        self._nulls = NO_NUMBERS if missing else frozenset()
        self._no_row_is_too_long = False
        self._parsed: dict[tuple[int, str], np.ndarray] = {}
        head = [fields for _, fields in islice(self.rows(), PREAMBLE)]
        named, self._first, self._units = list(names), list[str](), dict[int, str]()
        for k, column in enumerate([*zip_longest(*head, fillvalue="")][: len(names)]):
            # A column of numbers may begin with `-`, and a unit may stand behind, as in `0.5 sec`.
            text = next((text for text in column if text not in NO_NUMBERS), column[0])
            behind = _UNIT_BEHIND.search(text)
            unit = behind[0] if behind and unit_in(behind[0]) in TIME_UNITS else ""
            self._first.append(text.removesuffix(unit))
            self._units[k] = unit
            kind = "deg" if _SEXAGESIMAL.fullmatch(self._first[k]) else unit.strip()
            if kind and not bracket_of(named[k]):
                named[k] += f" [{kind}]"
        self.names = tuple(named)
        self._ways = {k for k, text in enumerate(self._first) if fold(text) in WAYS}
        self._leave_out_text_below()
        self._last = list(islice(self._from_below(), 4))  # line index, text and fields, from below

    def rows(self) -> Iterator[tuple[int, list[str]]]:
        """Yield the line number and fields of every row, without comments and empty rows."""
        for number, line in enumerate(self.lines.starting_at(self.header + 1), self.header + 2):
            fields = self._fields(line)
            if fields:
                yield number, fields

    def own_columns(
        self, indices: Sequence[int], *, keep_last: bool = False
    ) -> list[Real[np.ndarray, " n"]]:
        """Return columns as float64, or as int64 where float64 cannot hold whole numbers.

        `keep_last` is true if an incomplete last row is an error, and is not left out.
        """
        decimal = self._decimal(indices)
        self._parse([k for k in indices if (k, decimal) not in self._parsed], decimal)
        if not keep_last and self.left_out(indices):
            return [self._parsed[k, decimal][:-1] for k in indices]
        for k in indices:  # raises for a field that is not read
            _ = self._value(self._last[0][0] + 1, self._last[0][2], k, decimal)
        return [self._parsed[k, decimal] for k in indices]

    def own_numeric(self) -> dict[int, Real[np.ndarray, " n"]]:
        """Return index → values of the columns of the file that hold only numbers."""
        indices = list(filter(self.starts_with_a_number, range(self.own)))
        try:
            return dict(zip(indices, self.own_columns(indices), strict=True))
        except RowTooLong:
            raise
        except LogError:
            pass
        found: dict[int, np.ndarray] = {}
        for k in indices:
            with suppress(LogError):
                (found[k],) = self.own_columns([k])
        return found

    def texts(self, index: int) -> list[str]:
        """Return the fields of a column as they are written, with those of the last row."""
        return [self._field(number, fields, index) for number, fields in self.rows()]

    def starts_with_a_number(self, index: int) -> bool:
        """Return whether the first field of a column is a number."""
        first = [self._first[k] if k < len(self._first) else "" for k in self.needed([index])]
        return all(looks_like_number(t) or t in self._nulls or fold(t) in WAYS for t in first)

    def first_way(self, index: int) -> str:
        """Return the first word of a column of words for directions, of both senses, or ""."""
        rows = self.rows() if index in self._ways else ()
        return first_way([row[index] if index < len(row) else "" for _, row in rows])

    def is_dated(self, index: int) -> bool:
        """Return whether the first field of a column is a date with time, or a time of day."""
        return index < min(self.own, len(self._first)) and looks_like_stamp(self._first[index])

    @property
    def line_of(self) -> Callable[[int], int]:
        """Function from row to line number; it keeps no text if each line below is a row."""
        first = self.header + 2
        if self._is_dense:
            return lambda row: first + row
        return lambda row: next(islice(self.rows(), row, None))[0]

    @property
    def _is_dense(self) -> bool:
        """Whether the lines below the header are rows, without comments and empty lines."""
        size = len(next(iter(self._parsed.values()), ()))
        ends = not next(self.lines.backwards())  # an empty line after the last line end
        return size == len(self.lines) - self.header - 1 - ends

    def close(self) -> None:
        """Free the memory of the columns, and that of the text if no line number needs it."""
        if self._is_dense:
            self.lines = Lines("")
        self._parsed = {}

    def left_out(self, indices: Sequence[int]) -> tuple[str, ...]:
        """Return a note if the last row is incomplete; a single row is always kept.

        It is incomplete if a field of `indices` is missing or unreadable, but readable in the row
        above, or if no line end follows and fields are missing or the last number is cut off.
        """
        indices = self.needed(indices)
        if len(self._last) < 2:
            return ()
        (row, line, fields), (_, line_above, above) = self._last[:2]
        gaps = self._nulls if row < len(self.lines) - 1 else ()
        lacking = [k for k in indices if _value_at(above, k) and not _value_at(fields, k)]
        cut = any("".join(fields[k : k + 1]) not in gaps for k in lacking)
        if row == len(self.lines) - 1:  # no line end follows
            both = map(self._content, (line, line_above))
            counts = [len(split(text, self.delimiter, trim=False)) for text in both]
            cut = cut or counts[0] < min(self.own, counts[1])
            cut = cut or self._ends_in_a_number(indices)
        return (f"the last line ({row + 1}) is cut off and left out",) if cut else ()

    def _ends_in_a_number(self, indices: Sequence[int]) -> bool:
        """Return whether the file ends inside the last number, which is then far from those above.

        The decision needs the last four rows.
        """
        last = [fields for _, _, fields in self._last]
        place = len(last[0]) - 1
        if len(last) < 4 or place not in indices or any(len(row) <= place for row in last):
            return False
        text, above = last[0][place], last[1][place]
        if text == above or not above.startswith(text):
            return False
        decimal = self.decimal or ("," if "," in above else ".")
        values = [to_number(row[place], decimal) for row in last]
        if None in values:
            return False
        steps = np.abs(np.diff(np.array(values, np.float64)))
        return bool(steps[0] > _FAR * steps[1:].max())

    def _fields(self, line: str) -> list[str]:
        """Return the fields of a line without its comment; none for `;;` and for a ruled line."""
        content = _stripped(self._content(line), self.delimiter)
        ruled = "---" in content and _RULED.fullmatch(content)
        return split(content, self.delimiter) if content.strip() and not ruled else []

    def _content(self, line: str) -> str:
        """Return a line without its comment, which starts with the line or after a blank.

        A `#` inside a field, as in `1.#QNAN`, is no comment, nor is one that other fields follow,
        as in `run #3;5.2`.
        """
        if "#" not in line:
            return line
        if self.delimiter is None:
            return _COMMENT.sub("", line)
        found = _COMMENT.search(line)
        if found is None or (line[: found.start()].strip() and self.delimiter in found[0]):
            return line
        return line[: found.start()]

    def _from_below(self) -> Iterator[tuple[int, str, list[str]]]:
        """Yield index, line and fields of every row, from the last one to the first one."""
        below = range(len(self.lines) - 1, self.header, -1)
        for k, line in zip(below, self.lines.backwards(), strict=False):
            fields = self._fields(line)
            if fields:
                yield k, line, fields

    def _leave_out_text_below(self) -> None:
        """Leave out the lines of text below the last row of numbers, with a note.

        These are lines whose first field with content is a word where the first row has a number,
        such as `;mean;0.12`. Where it has a word too, such lines have none of its numbers.
        """
        numbers = [k for k in range(len(self._first)) if _value_at(self._first, k)]
        row, text, count = 0, "", 0
        for k, line, fields in self._from_below():
            place = next((k for k, one in enumerate(fields) if one not in NO_NUMBERS), 0)
            begun = fields[place]
            lacks = place in numbers or not any(_value_at(fields, index) for index in numbers)
            worded = (begun[:1].isalpha() and len(begun) > 1) or _WORD.match(begun)
            if not lacks or _value_at(fields, place) or not worded:
                break
            row, text, count = k, line.strip(), count + 1
        else:
            return  # no row of numbers is above
        if not count:
            return
        self.lines = self.lines.before(row)
        what = "line is" if count == 1 else "lines are"
        text = text if len(text) <= _SHOWN else text[:_SHOWN] + "…"
        note = f"{count} {what} text below the table and left out, from line {row + 1}: {text}"
        self.notes = (*self.notes, note)

    def _decimal(self, indices: Sequence[int]) -> str:
        """Return the decimal mark of the columns `indices`."""
        first = self.header + 1
        if self.decimal is not None:
            return self.decimal
        quoted = self.delimiter == ","  # a comma in a field is then between quotes
        has_mark = self.lines.have('"' if quoted else ",", first)
        if not has_mark or (quoted and not self.lines.match(_QUOTED_COMMA, first)):
            return "."
        fields = (row[k] for _, row in self.rows() for k in indices if k < len(row))
        if self.delimiter in (";", "\t") and not self.lines.have(".", first):
            return "," if any("," in field for field in fields) else "."
        return choose_decimal(list(fields), self.delimiter, self.source)

    def _parse(self, indices: Sequence[int], decimal: str) -> None:
        """Parse columns of all rows; an unreadable field of the last row, which may be cut, is NaN.

        **Raises** `LogError` for an unreadable field of another row.
        """
        found = dict(zip(indices, self._by_arrow(indices, decimal) or (), strict=False))
        if len(indices) > 1 and not found:
            found = {k: one[0] for k in indices if (one := self._by_arrow([k], decimal))}
        last, fields = self._last[0][0] + 1, self._last[0][2]
        slow = [k for k in indices if k not in found]
        all_rows = slow and not self._no_row_is_too_long
        for number, row in self.rows() if all_rows else [(last, fields)]:
            if len(row) > self.own:
                raise _more_fields(row, self.names, self.delimiter, self._at(number))
        self._no_row_is_too_long |= bool(slow)
        rows = [
            [self._value(number, row, k, decimal) for k in slow]
            for number, row in (self.rows() if slow else ())
            if number < last
        ]
        found |= {k: np.array([row[place] for row in rows] + [0.0]) for place, k in enumerate(slow)}
        for k in indices:
            try:
                found[k][-1] = self._value(last, fields, k, decimal)
            except LogError:
                found[k][-1] = np.nan
            self._parsed[k, decimal] = self._exact(k, found[k])

    def _exact(self, index: int, values: np.ndarray) -> np.ndarray:
        """Return a column as int64 if float64 cannot represent its whole numbers."""
        if max(np.fmax.reduce(values), -np.fmin.reduce(values), 0.0) < EXACT_FLOAT:
            return values
        found = self._by_arrow([index], ".", whole=True)
        try:
            if found is None:
                return np.array([int(text) for text in self.texts(index)], np.int64)
            found[0][-1] = int(self._last[0][2][index])
        except (ValueError, OverflowError, IndexError, LogError):
            return values
        return found[0]

    def _by_arrow(
        self, indices: Sequence[int], decimal: str, *, whole: bool = False
    ) -> list[np.ndarray] | None:
        """Return columns of all rows as pyarrow parses them, with room for the last row.

        The result is None if it refuses a row or a field. `whole` is true for int64. Numbers such
        as `nan(1)` are numbers only to pyarrow, so that a bracket is refused.
        """
        if not indices:
            return None
        import pyarrow as pa
        from pyarrow import csv as arrow

        delimiter, first, last = self.delimiter or "\t", self.header + 1, self._last[0][0]
        row = next((line for line in self.lines.starting_at(first) if self._fields(line)), "")
        names = [str(k) for k in range(len(split(self._content(row), self.delimiter, trim=False)))]
        if decimal == delimiter or max(indices) >= len(names):
            return None
        wanted = [names[k] for k in indices]
        kind = pa.int64() if whole else pa.float64()
        read = arrow.ReadOptions(use_threads=False, column_names=names, block_size=1 << 21)
        convert = arrow.ConvertOptions(
            column_types=dict.fromkeys(wanted, kind),
            include_columns=wanted,
            null_values=[*self._nulls],
            decimal_point=decimal,
        )
        pool = pa.system_memory_pool()  # the default pool keeps the memory of all blocks
        arrays = [np.empty(last - first + 1, np.int64 if whole else np.float64) for _ in indices]
        size = 0
        for block in self.lines.before(last).blocks(first) if last > first else ():
            if "(" in block:
                return None
            if self.delimiter is None or "#" in block:
                contents = map(self._content, block.split("\n"))
                block = "\n".join(
                    "\t".join(one.split()) if self.delimiter is None else one for one in contents
                )
            if not block.strip():
                continue
            quote = '"' if '"' in block else False
            parse = arrow.ParseOptions(delimiter=delimiter, quote_char=quote)
            try:
                source = pa.BufferReader(block.encode())
                table = arrow.read_csv(source, read, parse, convert, memory_pool=pool)
            except (pa.ArrowInvalid, pa.ArrowNotImplementedError, UnicodeEncodeError):
                return None
            for array, name in zip(arrays, wanted, strict=True):
                place = size
                for chunk in table.column(name).chunks:  # its `to_numpy` would import pandas
                    if chunk.null_count and whole:
                        return None
                    known = chunk.fill_null(np.nan) if chunk.null_count else chunk
                    array[place : place + len(chunk)] = np.from_dlpack(known)
                    place += len(chunk)
            size += len(table)
        for array in arrays:
            array.resize(size + 1, refcheck=False)
        return arrays

    def _field(self, number: int, fields: Sequence[str], index: int) -> str:
        """Return the field of a column; raise `LogError` if the row in line `number` lacks it."""
        if index < len(fields) and fields[index]:
            return fields[index]
        raise LogError(
            f"the field is empty; write a value, {SKIP}.",
            where=self._at(number, index),
        )

    def _at(self, number: int, index: int | None = None) -> str:
        """Return the place of a line, or of the field of a column in it."""
        column = "" if index is None else f", column `{self.names[index]}`"
        return ": ".join(filter(None, (self.source, f"line {number}{column}")))

    def _value(self, number: int, fields: Sequence[str], index: int, decimal: str) -> float:
        """Return the number in a field of the row in line `number`, or raise `LogError`."""
        ways = index in self._ways
        if self._nulls and not ways and (index >= len(fields) or fields[index] in self._nulls):
            return np.nan
        text = self._field(number, fields, index).removesuffix(self._units.get(index, ""))
        value = WAYS.get(fold(text)) if ways else to_number(text, decimal)
        if value is None:
            comma = "," in text or decimal == ","
            cure = f'decimal is "{decimal}"; correct it or --decimal' if comma else "correct it"
            cure += f", {SKIP}" * (text in NO_NUMBERS)
            raise LogError(
                f"`{text}` is no number; {cure}.",
                where=self._at(number, index),
            )
        return value


def _value_at(fields: Sequence[str], index: int) -> bool:
    return index < len(fields) and is_value(fields[index])


def find_table(
    lines: Lines, source: str, layout: LogLayout = LogLayout(), highest: int = 0
) -> TextTable:
    """Find the header and delimiter of a delimited table; lines before the header are skipped.

    The header is the last line before the first row of numbers with the same number of fields; it
    may be a comment. `layout` states the form of the text. `highest` is the highest requested
    column number (`#2`) or 0. With a number, the table may have one column and no header; its
    columns are then named #1, #2, ….

    **Raises** `LogError` for text without header or without rows below it, and for a table on its
    side.
    """
    lines = lines.trimmed(EMPTY)
    stated = _SEPARATOR.fullmatch(lines[0].strip())
    if stated is not None:  # an empty line stays, so that the numbers of the lines do
        lines = Lines(lines.data, lines.start + len(lines[0]), lines.stop)
    candidates = DELIMITERS if stated is None else (stated[1].replace("\\t", "\t"),)
    if layout.delimiter is not None:
        candidates = (NAMED.get(layout.delimiter, layout.delimiter),)
        if candidates[0] is not None and len(candidates[0]) != 1:
            raise LogError(
                f"{layout.delimiter!r} is no delimiter; write one character, tab or space.",
                where="log.delimiter",
            )
    marks: dict[str, Any] = {"decimal": layout.decimal, "source": source}
    marks["missing"] = layout.missing == "skip"
    first_rows = {mark: _first_row(lines, mark) for mark in candidates}
    starts = {mark: start for mark, start in first_rows.items() if start is not None}
    for mark, start in starts.items():
        header = _header_before(lines, start, mark)
        if header is not None:
            names = _names_with_units(lines, header, mark, len(split(lines[start], mark)))
            if header + 1 < start and (units := _units_below(lines, header, mark)):
                header, names = header + 1, with_units(names, units)
            _check_width(lines, start, names, mark, source)
            return TextTable(names, lines, header, mark, **marks)
    if highest:
        given = layout.delimiter is not None
        table = _headerless(lines, candidates, starts, marks, highest, given=given)
        if table is not None:
            return table
    raise _no_table(lines, source)


def _names(line: str, delimiter: str | None, width: int) -> list[str]:
    """Return the names in a line above rows of `width` fields."""
    text = _stripped(line, delimiter)
    for mark in COMMENTS:
        text = text.removeprefix(mark)
    if delimiter is not None:
        return split(text, delimiter)
    # Names with a bracket or with single blanks, such as "time [s]   motor angle [deg]".
    names, apart = text.replace(" [", "[").replace(" (", "(").split(), _APART.split(text.strip())
    return apart if len(names) != width == len(apart) else names


def _names_with_units(lines: Lines, header: int, delimiter: str | None, width: int) -> list[str]:
    """Return the column names; a row of units or directions is added to the names above it."""
    names = _names(lines[header], delimiter, width)
    first, *ways = split(lines[header], delimiter, trim=False)
    if header and not first and all(map(ways_in, ways)):  # each pair below one name
        above = accumulate(split(lines[header - 1], delimiter, trim=False), lambda a, b: b or a)
        return [f"{a} {b}".strip() for a, b in zip(above, ["", *ways], strict=False)]
    if header > 1 and is_units_row(split(lines[header - 1], delimiter, trim=False)):
        header -= 1  # names, units, and a row such as that of the amplifiers
    if header == 0 or not is_units_row(split(lines[header], delimiter, trim=False)):
        return names
    row = lines[header - 1]
    above = _names(row, delimiter, width)
    numbered = len(above) > 1 == len({re.sub(r"\d+", "", name) for name in above})
    if numbered and header > 1 and len(_names(lines[header - 2], delimiter, width)) == len(above):
        row = lines[header - 2]  # above `Ch=0`, `Ch=1`
        above = _names(row, delimiter, width)
    if delimiter is not None:  # a name of several columns is above the first one
        above += [""] * (len(split(row, delimiter, trim=False)) - len(above))
    if len(above) < len(names) or all(map(looks_like_number, above)):
        return names
    return with_units(above, split(lines[header], delimiter, trim=False))


def _units_below(lines: Lines, header: int, delimiter: str | None) -> list[str]:
    """Return the row of units below the names, with empty fields, or an empty list.

    Between blanks a unit belongs to the name whose end is nearest to its own.
    """
    fields = split(lines[header + 1], delimiter, trim=False)
    if not is_units_row(fields):
        return []
    if delimiter is None:
        ends = [one.end() for one in re.finditer(r"\S+(?: [\[(]?\S+)*", lines[header])]
        placed = [""] * len(ends)
        for one in re.finditer(r"\S+", lines[header + 1]):
            placed[int(np.argmin([abs(one.end() - end) for end in ends]))] = one[0]
        return placed
    return fields


def _first_row(lines: Lines, delimiter: str | None) -> int | None:
    """Return the index of the first row of numbers of the table, or None.

    A row of numbers has at least two fields, at least half of them numbers. A line such as
    `Channels:;3` above the table is skipped, because the next line is not a row of numbers and the
    rows of the table have another number of fields. Several such lines are skipped if at least
    twice as many rows have another number of fields, or begin with no word as these lines do.
    """
    head = lines[: PREAMBLE + 1]
    widths_of_lines = [_width_of_numbers(line, delimiter) for line in head[:PREAMBLE]]
    for k, line in enumerate(head[1:]):
        if widths_of_lines[k] and is_units_row(split(line, delimiter)):
            widths_of_lines[k] = 0  # names such as `x-axis,1,2` are above units, not above numbers
    begun = [split(line, delimiter)[:1] or [""] for line in head]
    worded = [w * bool(_WORD.match(one)) for (one,), w in zip(begun, widths_of_lines, strict=False)]
    if 3 * np.count_nonzero(worded) <= np.count_nonzero(widths_of_lines):
        widths_of_lines = [a - b for a, b in zip(widths_of_lines, worded, strict=True)]
    found = [(k, width) for k, width in enumerate(widths_of_lines) if width]
    if not found:
        return None
    first, width = found[0]
    widths = Counter(width for _, width in found)
    usual, times = widths.most_common(1)[0]
    if times >= 2 * widths[width]:
        return next(k for k, width in found if width == usual)

    def below(row: int) -> int | None:
        """Width of the first line after `row` with content that is no comment."""
        for k in range(row + 1, len(widths_of_lines)):
            if lines[k].strip() and not lines[k].lstrip().startswith(COMMENTS):
                return widths_of_lines[k]
        return None

    if below(first) in (None, width):
        return first
    return next((k for k, other in found[1:] if width != other == below(k)), first)


def _width_of_numbers(line: str, delimiter: str | None) -> int:
    """Return the number of fields of a row of numbers, or 0 for any other line."""
    if (delimiter or "") not in line or line.lstrip().startswith(COMMENTS):
        return 0
    fields = split(line, delimiter)
    if len(fields) < 2:
        return 0
    seen = fields[:MOST_COLUMNS]
    return len(fields) if 2 * sum(map(is_value, seen)) >= len(seen) else 0


def _header_before(lines: Lines, start: int, delimiter: str | None) -> int | None:
    """Return the index of the header of the table whose first row is `start`, or None.

    If no line has the number of names, it is the nearest line of several names. Between blanks,
    more names than columns are no header: a name has several words, or the line is a sentence. A
    row of numbers with empty fields has another width than `start` and is no header.
    """
    width, fallback = len(split(lines[start], delimiter)), None
    whole = len(split(lines[start], delimiter, trim=False))
    for k in range(start - 1, -1, -1):
        names = _names(lines[k], delimiter, width)
        # The last cells of the first row may be empty, as below `Remarks`.
        wider = k == start - 1 and len(names) == whole > width
        if wider and not any(map(looks_like_number, names)):
            return k
        if len(names) != width and _width_of_numbers(lines[k], delimiter):
            continue
        if len(names) == width:
            return k
        if delimiter is None and len(names) > width:
            continue
        if fallback is None and len(names) >= 2 and not lines[k].lstrip().startswith(COMMENTS):
            fallback = k
    return fallback


def _check_width(
    lines: Lines, start: int, names: list[str], delimiter: str | None, source: str
) -> None:
    """Raise `LogError` for a row with more fields than names, and for a table on its side."""
    fields = split(lines[start], delimiter)
    width = len(fields)
    if len(lines) - start < width > MOST_COLUMNS:
        rows = sum(1 for line in lines.starting_at(start) if line.strip())
        raise LogError(
            f"the table lies on its side ({rows} rows of {width} columns); write one row for each"
            " instant and one column for each channel.",
            where=f"{source}: line {start + 1}",
        )
    if max(map(len, names)) > _LONGEST:
        raise LogError(
            "a name of a column here is a text of its own; write the names in one line.",
            where=f"{source}: line {start}",
        )
    if width > len(names):
        raise _more_fields(fields, names, delimiter, f"{source}: line {start + 1}")


def _more_fields(
    fields: Sequence[str], names: Sequence[str], delimiter: str | None, where: str
) -> RowTooLong:
    cure = "correct the line or the header"
    if delimiter == ",":
        cure = "correct it, or write decimal points if it has decimal commas"
    return RowTooLong(
        f"this row has {len(fields)} fields, but the header has {len(names)}; {cure}.", where=where
    )


def _headerless(
    lines: Lines,
    candidates: Sequence[str | None],
    starts: dict[str | None, int],
    marks: dict[str, Any],
    highest: int,
    *,
    given: bool,
) -> TextTable | None:
    """Return the rows of numbers as a table with columns #1, #2, …, or None without rows.

    A single column may have a name above it.

    `starts` is delimiter → index of the first row, for those `candidates` that have one. `given` is
    true if the user stated the delimiter; a comma between digits is then a delimiter.
    """
    if marks["decimal"] == "," and not given and not any('"' in line for line in lines[:PREAMBLE]):
        candidates = [mark for mark in candidates if mark != ","]
    rows = {mark: split(lines[starts[mark]], mark) for mark in candidates if mark in starts}
    numeric = [m for m, row in rows.items() if all(map(looks_like_number, row[:MOST_COLUMNS]))]
    for delimiter in (*numeric, *rows):
        start = starts[delimiter]
        names = [f"#{k + 1}" for k in range(len(rows[delimiter]))]
        _check_width(lines, start, names, delimiter, marks["source"])
        table = TextTable(names, lines, start - 1, delimiter, **marks)
        if delimiter == "," and marks["decimal"] is None and not given:
            _refuse_ambiguous_commas(table, highest)
        return table
    for delimiter in candidates:  # a table of one column, whose lines may end with a delimiter
        for k, line in enumerate(lines[:PREAMBLE]):
            if not line.strip() or line.lstrip().startswith(COMMENTS):
                continue
            fields = split(line, delimiter)
            if (delimiter or "") in line and len(fields) == 1 and looks_like_number(fields[0]):
                above = _names(lines[k - 1], delimiter, 1) if k else []
                names = above if len(above) == 1 else ["#1"]
                return TextTable(names, lines, k - 1, delimiter, **marks)
    return None


def _refuse_ambiguous_commas(table: TextTable, highest: int) -> None:
    """Raise `LogError` for rows such as `147,31`, which are two columns or one decimal number.

    If `highest`, the highest requested column number, needs all columns, the comma delimits them.
    """
    width = len(table.names)
    if width % 2 or 2 * highest > width:
        return
    rows = list(islice(table.rows(), 100))
    for number, fields in rows:
        decimals = fields[1::2]
        integers = [field.lstrip("+-") for field in fields[::2]]
        blank = " " in table.lines[number - 1].strip()
        if blank or len(fields) != width or not all(map(str.isdigit, integers + decimals)):
            return
    numbers = "one number" if width == 2 else f"{width // 2} numbers"
    line = table.lines[rows[0][0] - 1].strip()
    raise LogError(
        f"`{line}` means {width} columns, or {numbers} with a decimal comma; {CURE}.",
        where=f"{table.source}: line {rows[0][0]}",
    )


def _no_table(lines: Lines, source: str) -> LogError:
    content = [k for k, line in enumerate(lines) if line.strip()]
    if len(content) == 1:
        return LogError(
            "the file has a header without a single line of numbers; export the log again.",
            where=f"{source}: line {content[0] + 1}",
        )
    return LogError(
        "the file has no table of numbers with at least two columns; a log is CSV, TSV or TXT with"
        " one header line (read a single column of numbers with driving=#1 and driven=#row).",
        where=source,
    )
