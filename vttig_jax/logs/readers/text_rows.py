"""Rows of a text and the columns of numbers in them, for the readers of layouts.

Every row keeps the number of its line, so that errors name it; `open_table` adds the name of the
file. A damaged last line was not written to its end: it is left out with a note.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Real

from ...base.errors import LogError
from .delimited import split, to_number
from .text import printable
from .times import looks_like_stamp, read_stamps

WHOLE = 0.9
"""Least share of the rows that have the usual form; others are damaged (chosen)."""

SPARE = 16
"""Number of first lines of a text in which a layout is recognised (chosen)."""

Cell = tuple[int, str]
"""Line number and text of a field."""

Row = tuple[int, list[str]]
"""Line number and fields of a line."""


def content(lines: Sequence[str], most: int = SPARE) -> list[str]:
    """Return those of the first `most` lines that are not empty, without blanks around them."""
    return [line.strip() for line in lines[:most] if line.strip()]


def rows_from(lines: Sequence[str], first: int, mark: str) -> tuple[list[Row], list[str]]:
    """Return the rows from the line with index `first` on, and a note on the last one.

    A last line without a line end was not written to its end and is left out.
    """
    rows = [
        (number, split(line, mark, trim=False))
        for number, line in enumerate(lines[first:], first + 1)
        if line.strip()
    ]
    if len(rows) < 2 or not lines[-1].strip():
        return rows, []
    return rows[:-1], cut_at(lines, rows[-1][0], "")


def cut_at(lines: Sequence[str], number: int, what: str) -> list[str]:
    """Return a note on a damaged line if it is the last one; raise `LogError` for other lines."""
    if any(rest.strip() for rest in lines[number:]):
        raise LogError(what, where=f"line {number}")
    return [f"the last line ({number}) is cut off and left out"]


def decimal_of(rows: Sequence[Row], mark: str) -> str:
    """Return the decimal mark: a comma if the fields hold commas that delimit nothing."""
    commas = mark != "," and any("," in field for _, row in rows[:9] for field in row)
    return "," if commas else "."


def column_of(rows: Sequence[Row], k: int, name: str, decimal: str) -> Real[np.ndarray, " n"]:
    """Return column `k` as `numbers` does; short channels end with empty fields.

    **Raises** `LogError` for an empty field above other ones, and for one that is no number.
    """
    what = f"column `{name}`"
    found = [(number, row[k]) for number, row in rows if k < len(row) and row[k]]
    for (number, _), (own, _) in zip(rows, found, strict=False):
        if number != own:
            raise LogError(
                "the field is empty; write a value or remove the line.",
                where=f"line {number}, {what}",
            )
    return numbers(found, decimal, what)


def numbers(cells: Sequence[Cell], decimal: str, what: str) -> Real[np.ndarray, " n"]:
    """Return a column: int64 for whole numbers, else float64; dates in s since the first one.

    **Raises** `LogError` for a field that is no number; `what` names the column.
    """
    texts = [text for _, text in cells]
    if texts and looks_like_stamp(texts[0]):
        lines = [f"line {line}, " for line, _ in cells]
        return read_stamps(texts, lambda r: f"{'' if r is None else lines[r]}{what}")[0]
    if texts and all(text.lstrip("+-").isdigit() and len(text) < 19 for text in texts):
        return np.array([int(text) for text in texts], np.int64)
    values = []
    for line, text in cells:
        value = to_number(text, decimal)
        if value is None:
            raise LogError(
                f"`{printable(text)}` is no number; correct it or remove the line.",
                where=f"line {line}, {what}",
            )
        values.append(value)
    return np.array(values, np.float64)
