"""Delimited text as a table: where the header is, and the columns as arrays.

Columns are read by NumPy's C parser; only what it refuses is read again field by field, which
either understands the field (quotes, thousands) or names line and column.
"""

import csv
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Real

from ..base.errors import LogError
from .channel import EXACT_FLOAT
from .numbers import choose_decimal, looks_like_number, to_number

DELIMITERS = ("\t", ";", ",", "|", None)
"""Tried in this order; None is any run of blanks."""

NAMED = {"tab": "\t", "\\t": "\t", "space": None, " ": None, "semicolon": ";", "comma": ","}

PREAMBLE = 1000
"""Lines among which the first row of numbers is looked for."""

COMMENTS = ("#", "%", "//")


@dataclass(frozen=True)
class Table:
    """A table found in text. `lines` are all lines of the file; rows start after `header`."""

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

    def _prepared(self, indices: Sequence[int]) -> tuple[list[str] | None, str]:
        """Lines with decimal points, None where the C parser is no use, and the mark they had."""
        body = self.body
        if self.delimiter == ",":
            commas = any('"' in line for line in body)
        else:
            commas = any("," in line for line in body)
        if not commas and self.decimal != ",":
            return body, "."
        decimal = self.decimal
        if decimal is None:
            fields = [row[k] for _, row in self.rows() for k in indices if k < len(row)]
            decimal = choose_decimal(fields, self.delimiter, self.source)
        if decimal == "," and self.delimiter != "," and not any("." in line for line in body):
            return [line.replace(",", ".") for line in body], decimal
        return None, decimal


def find_table(
    text: str, source: str, *, delimiter: str | None = None, decimal: str | None = None
) -> Table:
    """Find header and delimiter of a delimited table; lines before the header are skipped.

    The header is the last line before the first row of numbers that has as many fields; it may be
    a comment.

    **Raises** `LogError` where there is no header, or nothing below it.
    """
    lines = text.split("\n")
    if delimiter is None:
        tried = DELIMITERS
    else:
        tried = (NAMED.get(delimiter, delimiter),)
        if tried[0] is not None and len(tried[0]) != 1:
            raise LogError(
                f"{delimiter!r} is no delimiter; write one character, tab or space.",
                where="log.delimiter",
            )
    for candidate in tried:
        start = _first_row(lines, candidate)
        if start is None:
            continue
        header = _header_before(lines, start, candidate)
        if header is None:
            continue
        names = _names(lines[header], candidate)
        _check_width(lines[start], start, names, candidate, source)
        return Table(tuple(names), lines, header, candidate, decimal, source)
    raise _no_table(lines, tried, source)


def split(line: str, delimiter: str | None) -> list[str]:
    """Fields of a line without blanks around them and without empty ones at its end."""
    if delimiter is None:
        fields = line.split()
    elif '"' in line:
        fields = next(csv.reader([line], delimiter=delimiter, skipinitialspace=True))
    else:
        fields = line.split(delimiter)
    fields = [field.strip() for field in fields]
    while fields and not fields[-1]:
        fields.pop()
    return fields


def _names(line: str, delimiter: str | None) -> list[str]:
    text = line.strip()
    for mark in COMMENTS:
        text = text.removeprefix(mark)
    if delimiter is None:  # "time [s]" is one name
        text = text.replace(" [", "[").replace(" (", "(")
    return split(text, delimiter)


def _first_row(lines: list[str], delimiter: str | None) -> int | None:
    """First line of at least two fields of which at least half are numbers."""
    for k, line in enumerate(lines[:PREAMBLE]):
        if line.lstrip().startswith(COMMENTS):
            continue
        fields = split(line, delimiter)
        if len(fields) >= 2 and 2 * sum(map(looks_like_number, fields)) >= len(fields):
            return k
    return None


def _header_before(lines: list[str], start: int, delimiter: str | None) -> int | None:
    width = len(split(lines[start], delimiter))
    spare = None
    for k in range(start - 1, -1, -1):
        names = _names(lines[k], delimiter)
        if len(names) == width:
            return k
        if spare is None and len(names) >= 2 and not lines[k].lstrip().startswith(COMMENTS):
            spare = k
    return spare


def _check_width(
    line: str, start: int, names: list[str], delimiter: str | None, source: str
) -> None:
    width = len(split(line, delimiter))
    if width > len(names):
        cure = (
            "; decimal commas between commas cannot be told apart, so save it with semicolons."
            if delimiter == ","
            else "; correct the header."
        )
        raise LogError(
            f"{width} fields under a header of {len(names)}{cure}",
            where=f"{source}: line {start + 1}",
        )


def _no_table(lines: list[str], tried: Sequence[str | None], source: str) -> LogError:
    for delimiter in tried:
        start = _first_row(lines, delimiter)
        if start is not None:
            return LogError(
                "numbers without a header; put a line with column names such as"
                " time_s,driving_counts,driven_counts above them.",
                where=f"{source}: line {start + 1}",
            )
    content = [k for k, line in enumerate(lines) if line.strip()]
    if len(content) == 1:
        return LogError(
            "a header without a single line of numbers; export the log again.",
            where=f"{source}: line {content[0] + 1}",
        )
    return LogError(
        "no table of numbers with at least two columns; a log is CSV, TSV or TXT with one header"
        " line.",
        where=source,
    )


def _by_field(table: Table, indices: Sequence[int], decimal: str) -> list[np.ndarray]:
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
