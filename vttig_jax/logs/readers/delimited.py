"""Table of delimited text, with its rows as fields and its columns as arrays.

pyarrow reads the columns of a long text block by block. NumPy's C parser reads short texts and
texts that pyarrow refuses. If both fail, the columns are read field by field; this either converts
each field (quotes, thousands marks) or raises an error that names line and column.
"""

import csv
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np
from jaxtyping import Real

from ...base.errors import LogError
from ..channel.channel import EXACT_FLOAT
from .blocks import read_in_blocks
from .lines import Lines
from .number_format import choose_decimal, looks_like_number, to_number
from .times.stamps import looks_like_stamp

_COMMENT = re.compile(r"(?:^| )\s*#.*", re.DOTALL)
"""Comment at the end of a line."""

_WORD = re.compile(r".*[^\W\d_]{2}|\W{3}")
"""Start of a field that holds a word or is a ruled line, and is no number that was cut off."""

_FAR = 3.0  # steps of the rows above by which a number that was cut off lies apart (chosen)
_SHOWN = 40
"""Number of characters of a text below the table that its note shows (chosen)."""


@dataclass(frozen=True)
class TextTable:
    """Table in a text file.

    `lines` are all lines of the file. The rows start after the line with index `header`, which is
    −1 for a file without header.
    """

    names: tuple[str, ...]
    lines: Lines
    header: int
    delimiter: str | None
    decimal: str | None
    source: str

    @property
    def body(self) -> Iterator[str]:
        """All lines below the header."""
        return self.lines.starting_at(self.header + 1)

    def line_of(self, row: int) -> int:
        """Return the line number of a row in the file, from 1."""
        return next(n for k, (n, _) in enumerate(self.rows()) if k == row)

    def rows(self) -> Iterator[tuple[int, list[str]]]:
        """Yield the line number and fields of every row, without comments and empty rows."""
        for number, line in enumerate(self.body, self.header + 2):
            fields = self._fields(line)
            if fields:
                yield number, fields

    def texts(self, index: int) -> list[str]:
        """Return the fields of a column as they are written.

        **Raises** `LogError` naming the line of a row without this field.
        """
        found = []
        for number, fields in self.rows():
            if index >= len(fields) or not fields[index]:
                where = f"{self.source}: line {number}, column `{self.names[index]}`"
                raise LogError("the field is empty; write a value or remove the line.", where=where)
            found.append(fields[index])
        return found

    def is_dated(self, index: int) -> bool:
        """Return whether the first field of a column is a date with time, or a time of day."""
        fields = next((fields for _, fields in self.rows()), [])
        return index < len(fields) and looks_like_stamp(fields[index])

    def columns(self, indices: Sequence[int]) -> list[Real[np.ndarray, " n"]]:
        """Return columns as float64, or as int64 if float64 cannot represent their whole numbers.

        **Raises** `LogError` naming the line and column of a field that is not a number.
        """
        commas, decimal = self._marks(indices)
        if commas is None:
            return _by_field(self, indices, decimal)

        commented = self.lines.have("#", self.header + 1)

        def body() -> Iterator[str]:
            lines = map(self._content, self.body) if commented else self.body
            return (line.replace(",", ".") for line in lines) if commas else lines

        options = {"delimiter": self.delimiter, "comments": None, "quotechar": '"', "ndmin": 2}
        columns = read_in_blocks(self.lines, self.header + 1, self.delimiter, decimal, indices)
        if columns is None:
            try:
                array = np.loadtxt(body(), usecols=indices, **options)
            except ValueError:
                return _by_field(self, indices, decimal)
            columns = list(np.ascontiguousarray(array.T))
        for k, index in enumerate(indices):
            if _largest(columns[k]) >= EXACT_FLOAT:
                try:
                    integers = np.loadtxt(body(), usecols=index, dtype=np.int64, **options)
                except (ValueError, OverflowError):
                    continue
                columns[k] = integers[:, 0]
        return columns

    def complete_rows(self, indices: Sequence[int]) -> "tuple[TextTable, tuple[str, ...]]":
        """Return the table without text below it and an incomplete last line, and notes on them.

        Text below the table is lines that start with a word where the rows start with a number. If
        the rows start with a word too, such lines have no number in the columns `indices`.

        The last line is incomplete if a field of `indices` is missing or unreadable, but readable
        in the row above, or if no line end follows and fields are missing or the last number is cut
        off. A single row is always kept.
        """
        table, notes = self._without_text_below(indices)
        last = list(islice(table._from_below(), 4))
        if len(last) < 2:
            return table, notes
        (row, line, fields), (_, line_above, above) = last[:2]
        cut = any(_number_at(above, k) and not _number_at(fields, k) for k in indices)
        if row == len(table.lines) - 1:  # no line end follows
            counts = [
                len(split(self._content(text), self.delimiter, trim=False))
                for text in (line, line_above)
            ]
            cut = cut or counts[0] < min(len(self.names), counts[1])
            cut = cut or self._ends_in_a_number([own for _, _, own in last], indices)
        if not cut:
            return table, notes
        notes = (*notes, f"the last line ({row + 1}) is cut off and left out")
        return replace(table, lines=table.lines.before(row)), notes

    def _ends_in_a_number(self, last: Sequence[Sequence[str]], indices: Sequence[int]) -> bool:
        """Return whether the file ends inside the last number, which is then far from those above.

        `last` holds the fields of the last four rows, the last one first.
        """
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
        """Return the fields of a line without its comment; none for an empty row such as `;;`."""
        content = self._content(line)
        return split(content, self.delimiter) if content.strip() else []

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

    def _without_text_below(self, indices: Sequence[int]) -> "tuple[TextTable, tuple[str, ...]]":
        """Return the table without text below its last row of numbers, and a note on the text."""
        first = next((fields for _, fields in self.rows()), [])
        numbered = _number_at(first, 0)
        columns = indices or range(len(self.names))
        found: list[tuple[int, str]] = []
        for k, line, fields in self._from_below():
            lacks = numbered or not any(_number_at(fields, index) for index in columns)
            if not lacks or _number_at(fields, 0) or not _WORD.match(fields[0]):
                break
            found.append((k, line.strip()))
        else:
            return self, ()  # no row of numbers is above
        if not found:
            return self, ()
        row, text = found[-1]
        what = "line is" if len(found) == 1 else "lines are"
        text = text if len(text) <= _SHOWN else text[:_SHOWN] + "…"
        note = f"{len(found)} {what} text below the table and left out, from line {row + 1}: {text}"
        return replace(self, lines=self.lines.before(row)), (note,)

    def _marks(self, indices: Sequence[int]) -> tuple[bool | None, str]:
        """Return whether the numbers have decimal commas, and the decimal mark.

        The first value is None if a C parser cannot read the columns `indices`.
        """
        first = self.header + 1
        if not self.lines.have('"' if self.delimiter == "," else ",", first) and (
            self.decimal != ","
        ):
            return False, "."
        decimal, points = self.decimal, self.lines.have(".", first)
        if decimal is None and self.delimiter in (";", "\t") and not points:
            # This is the result of `choose_decimal`, without a list of all fields.
            rows = (row for _, row in self.rows())
            commas = any("," in row[k] for row in rows for k in indices if k < len(row))
            decimal = "," if commas else "."
        if decimal is None:
            fields = [row[k] for _, row in self.rows() for k in indices if k < len(row)]
            decimal = choose_decimal(fields, self.delimiter, self.source)
        if decimal == "," and self.delimiter != "," and not points:
            return True, decimal
        return None, decimal


def split(line: str, delimiter: str | None, *, trim: bool = True) -> list[str]:
    """Return the stripped fields of a line; `trim` removes empty fields at its end.

    A `delimiter` of None means one or more blanks.
    """
    if delimiter is None:
        fields = line.split()
    elif '"' in line:
        fields = next(csv.reader([line], delimiter=delimiter, skipinitialspace=True))
    else:
        fields = line.split(delimiter)
    fields = [field.strip() for field in fields]
    while trim and fields and not fields[-1]:
        fields.pop()
    return fields


def _number_at(fields: list[str], index: int) -> bool:
    if index >= len(fields):
        return False
    return looks_like_number(fields[index]) or looks_like_stamp(fields[index])


def _largest(values: Real[np.ndarray, " n"]) -> float:
    """Return the largest magnitude in a column, computed without a copy of the column."""
    if not len(values):
        return 0.0
    ends = np.fmax.reduce(values), -np.fmin.reduce(values)
    return float(np.nanmax([*ends, 0.0]))


def _by_field(table: TextTable, indices: Sequence[int], decimal: str) -> list[np.ndarray]:
    """Return the columns, read field by field; this is slow and only used if the C parser fails."""
    values: list[list[float]] = [[] for _ in indices]
    for number, fields in table.rows():
        for column, index in zip(values, indices, strict=True):
            where = f"{table.source}: line {number}, column `{table.names[index]}`"
            if index >= len(fields) or not fields[index]:
                raise LogError("the field is empty; write a value or remove the line.", where=where)
            value = to_number(fields[index], decimal)
            if value is None:
                comma = "," in fields[index] or decimal == ","
                cure = f'decimal is "{decimal}"; correct it or --decimal' if comma else "correct it"
                raise LogError(f"`{fields[index]}` is no number; {cure}.", where=where)
            column.append(value)
    return [np.array(column) for column in values]
