"""Table of delimited text, with its rows as fields and its columns as arrays.

NumPy's C parser reads the columns. If it fails, they are read field by field; this either converts
the field (quotes, thousands marks) or raises an error that names line and column.
"""

import csv
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Real

from ...base.errors import LogError
from ..channel.channel import EXACT_FLOAT
from .number_format import choose_decimal, looks_like_number, to_number
from .times.stamps import looks_like_stamp


@dataclass(frozen=True)
class TextTable:
    """Table in a text file.

    `lines` are all lines of the file; the rows start after the line with index `header` (or −1).
    """

    names: tuple[str, ...]
    lines: list[str]
    header: int
    delimiter: str | None
    decimal: str | None
    source: str

    @property
    def body(self) -> list[str]:
        """Lines below the header."""
        return self.lines[self.header + 1 :]

    def line_of(self, row: int) -> int:
        """Return the line number of a row in the file, from 1."""
        return next(n for k, (n, _) in enumerate(self.rows()) if k == row)

    def rows(self) -> Iterator[tuple[int, list[str]]]:
        """Yield the line number and fields of every row, without blank and comment lines."""
        for number, line in enumerate(self.body, self.header + 2):
            content = line.split("#", 1)[0]
            if content.strip():
                yield number, split(content, self.delimiter)

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
        lines, decimal = self._prepared(indices)
        if lines is None:
            return _by_field(self, indices, decimal)
        options = {"delimiter": self.delimiter, "comments": "#", "quotechar": '"', "ndmin": 2}
        try:
            array = np.loadtxt(lines, usecols=indices, **options)
        except ValueError:
            return _by_field(self, indices, decimal)
        columns: list[np.ndarray] = list(np.ascontiguousarray(array.T))
        for k, index in enumerate(indices):
            if np.nanmax(np.abs(columns[k]), initial=0) >= EXACT_FLOAT:
                try:
                    integers = np.loadtxt(lines, usecols=index, dtype=np.int64, **options)
                except (ValueError, OverflowError):
                    continue
                columns[k] = integers[:, 0]
        return columns

    def without_cut_line(self, indices: Sequence[int]) -> "tuple[TextTable, tuple[str, ...]]":
        """Return the table without an incomplete last line, and a note on that line.

        The line is incomplete if a field of `indices` is missing or unreadable, but readable in the
        row above, or if fields are missing and no line end follows. A single row is always kept.
        """
        last = len(self.lines) - 1
        rows: list[int] = []
        while last > self.header and len(rows) < 2:
            if self.lines[last].split("#", 1)[0].strip():
                rows.append(last)
            last -= 1
        if len(rows) < 2:
            return self, ()
        texts = [self.lines[k].split("#", 1)[0] for k in rows]
        fields, above = (split(text, self.delimiter) for text in texts)
        cut = any(_number_at(above, k) and not _number_at(fields, k) for k in indices)
        if rows[0] == len(self.lines) - 1:  # no line end follows
            counts = [len(split(text, self.delimiter, trim=False)) for text in texts]
            cut = cut or counts[0] < min(len(self.names), counts[1])
        if not cut:
            return self, ()
        note = f"the last line ({rows[0] + 1}) is cut off and left out"
        return replace(self, lines=self.lines[: rows[0]]), (note,)

    def _prepared(self, indices: Sequence[int]) -> tuple[list[str] | None, str]:
        """Return lines with decimal points (None: the C parser fails) and the decimal mark."""
        body = self.body
        text = "\n".join(body)  # one search is ten times faster than a search in each line
        commas = ('"' if self.delimiter == "," else ",") in text
        if not commas and self.decimal != ",":
            return body, "."
        decimal = self.decimal
        if decimal is None:
            fields = [row[k] for _, row in self.rows() for k in indices if k < len(row)]
            decimal = choose_decimal(fields, self.delimiter, self.source)
        if decimal == "," and self.delimiter != "," and "." not in text:
            return [line.replace(",", ".") for line in body], decimal
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


def _by_field(table: TextTable, indices: Sequence[int], decimal: str) -> list[np.ndarray]:
    """Read the columns field by field; this is slow and only used if the C parser fails."""
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
