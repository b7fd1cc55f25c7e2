"""Rows of delimited text, and its columns as arrays.

Columns are read by NumPy's C parser; only what it refuses is read again field by field, which
either understands the field (quotes, thousands) or names line and column.
"""

import csv
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Real

from ...base.errors import LogError
from ..channel.channel import EXACT_FLOAT
from .number_format import choose_decimal, looks_like_number, to_number


@dataclass(frozen=True)
class TextTable:
    """A table found in text.

    `lines` are all lines of the file; rows start after line `header`, which may be -1.
    """

    names: tuple[str, ...]
    lines: list[str]
    header: int
    delimiter: str | None
    decimal: str | None
    source: str

    @property
    def body(self) -> list[str]:
        """The lines below the header."""
        return self.lines[self.header + 1 :]

    def line_of(self, row: int) -> int:
        """Line number in the file, from 1, of a row."""
        return next(n for k, (n, _) in enumerate(self.rows()) if k == row)

    def rows(self) -> Iterator[tuple[int, list[str]]]:
        """Line number and fields of every row; blank and comment lines are none."""
        for number, line in enumerate(self.body, self.header + 2):
            content = line.split("#", 1)[0]
            if content.strip():
                yield number, split(content, self.delimiter)

    def columns(self, indices: Sequence[int]) -> list[Real[np.ndarray, " n"]]:
        """Columns as float64, or int64 where a float could not hold their whole numbers.

        **Raises** `LogError` naming the line and column of a field that is no number.
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
                    whole = np.loadtxt(lines, usecols=index, dtype=np.int64, **options)
                except (ValueError, OverflowError):
                    continue
                columns[k] = whole[:, 0]
        return columns

    def without_cut_line(self, indices: Sequence[int]) -> "tuple[TextTable, tuple[str, ...]]":
        """The table without a last line that was cut off, and a note on it.

        It is cut off where a field of `indices` is missing or unreadable, though the row above has
        it, or where no line end follows and fields are missing. The only row is never left out.
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
        here, above = (split(text, self.delimiter) for text in texts)
        cut = any(_number_at(above, k) and not _number_at(here, k) for k in indices)
        if rows[0] == len(self.lines) - 1:  # no line end after it
            counts = [len(split(text, self.delimiter, trim=False)) for text in texts]
            cut = cut or counts[0] < min(len(self.names), counts[1])
        if not cut:
            return self, ()
        note = f"the last line ({rows[0] + 1}) is cut off and left out"
        return replace(self, lines=self.lines[: rows[0]]), (note,)

    def _prepared(self, indices: Sequence[int]) -> tuple[list[str] | None, str]:
        """Lines with decimal points, None where the C parser is no use, and the mark they had."""
        body = self.body
        whole = "\n".join(body)  # searched at once, ten times faster than line by line
        commas = ('"' if self.delimiter == "," else ",") in whole
        if not commas and self.decimal != ",":
            return body, "."
        decimal = self.decimal
        if decimal is None:
            fields = [row[k] for _, row in self.rows() for k in indices if k < len(row)]
            decimal = choose_decimal(fields, self.delimiter, self.source)
        if decimal == "," and self.delimiter != "," and "." not in whole:
            return [line.replace(",", ".") for line in body], decimal
        return None, decimal


def split(line: str, delimiter: str | None, *, trim: bool = True) -> list[str]:
    """Fields of a line without blanks around them and, with `trim`, without empty ones at its end.

    A `delimiter` of None is any run of blanks.
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
    return index < len(fields) and looks_like_number(fields[index])


def _by_field(table: TextTable, indices: Sequence[int], decimal: str) -> list[np.ndarray]:
    """Read field by field; slow, used only where the C parser cannot."""
    values: list[list[float]] = [[] for _ in indices]
    for number, fields in table.rows():
        for column, index in zip(values, indices, strict=True):
            where = f"{table.source}: line {number}, column `{table.names[index]}`"
            if index >= len(fields) or not fields[index]:
                raise LogError("empty; fill in the value or remove the line.", where=where)
            value = to_number(fields[index], decimal)
            if value is None:
                comma = "," in fields[index] or decimal == ","
                cure = f'decimal is "{decimal}"; correct it or --decimal' if comma else "correct it"
                raise LogError(f"`{fields[index]}` is no number; {cure}.", where=where)
            column.append(value)
    return [np.array(column) for column in values]
