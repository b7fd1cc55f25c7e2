"""Files in sections: several tables in one text, each with a header and perhaps a heading.

Guide logs and reports of test stands are such files. A section begins with a line of names above a
row of numbers with as many fields. Its columns are named `2/motor` for column `motor` of section 2.
"""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from ....base.errors import LogError
from ..delimited import split
from ..number_format import looks_like_number, to_number
from ..table import Table
from ..text import Lines, printable
from ..times.stamps import looks_like_stamp, read_stamps

DELIMITERS = (",", ";", "\t")
"""Delimiters in the order in which they are tried."""

FEWEST_ROWS = 3
"""Least number of rows of a table that counts as a section (chosen)."""

_BELOW_FIRST = 2
"""Number of lines of the first header and the first row; no second section can begin in them."""

_WORD = re.compile(r"""^\s*["']?[^\W\d_]""", re.MULTILINE)
"""Pattern of the beginning of a line of names."""


@dataclass
class Section:
    """One table of a text with several tables.

    **Arguments**
    - `heading`: first line of the text above the names, "" without one.
    - `names`: names of its columns. - `line`: number of the line of names.
    - `rows`: line number and fields of every row.
    - `others`: numbers of the lines between the rows that are not rows.
    """

    heading: str
    names: list[str]
    line: int
    rows: list[tuple[int, list[str]]] = field(default_factory=list)
    others: list[int] = field(default_factory=list)


def matches(lines: Lines) -> bool:
    """Return whether the text has at least two tables, each with a line of names."""
    return lines.match(_WORD, _BELOW_FIRST) and len(_sections(list(lines))[0]) > 1


def read(lines: list[str], source: str) -> tuple[Table, tuple[str, ...]]:
    """Return the columns of all sections, and notes that describe the sections.

    **Raises** `LogError` for text in a column of numbers.
    """
    found, delimiter = _sections(lines)
    decimal = _decimal(found, delimiter)
    names: list[str] = []
    arrays: list[np.ndarray] = []
    notes = []
    for number, section in enumerate(found, 1):
        rows = [row for row in section.rows if all(row[1][k] for k in _numeric(section))]
        for k in _numeric(section):
            names.append(printable(f"{number}/{section.names[k]}"))
            place = f"{source}: section {number}, column `{printable(section.names[k])}`"
            arrays.append(_values([(line, row[k]) for line, row in rows], decimal, place))
        notes.append(_note(number, section, len(rows)))
    return Table(tuple(names), tuple(arrays), source), tuple(notes)


def _sections(lines: Sequence[str]) -> tuple[list[Section], str]:
    """Return the sections of a text and its delimiter; no sections if there are fewer than two."""
    for delimiter in DELIMITERS:
        found = [one for one in _walk(lines, delimiter) if len(one.rows) >= FEWEST_ROWS]
        if len(found) > 1:
            return found, delimiter
    return [], DELIMITERS[0]


def _walk(lines: Sequence[str], delimiter: str) -> Iterator[Section]:
    """Yield the tables of a text in their order."""
    current: Section | None = None
    heading, between, parted = "", [], True
    for number, line in enumerate(lines, 1):
        if not line.strip():
            heading, parted = "", True
            continue
        fields = split(line, delimiter)
        # A line of text between two rows is a damaged row, unless it repeats the names.
        begins = parted or (current is not None and fields == current.names)
        parted = False
        if begins and _WORD.match(line) and _is_header(fields, lines, number, delimiter):
            if current is not None:
                yield current
            current = Section(heading, fields, number)
            heading, between = "", []
        elif current is not None and len(fields) == len(current.names) and _has_numbers(fields):
            current.others += between
            current.rows.append((number, fields))
            between = []
        else:
            heading, parted = heading or line.strip(), True
            between.append(number)
    if current is not None:
        yield current


def _is_header(fields: list[str], lines: Sequence[str], number: int, delimiter: str) -> bool:
    """Return whether `fields`, from the line `number`, are names above a row of numbers."""
    if len(fields) < 2 or any(map(looks_like_number, fields)) or not all(fields):
        return False
    below = next((line for line in lines[number : number + 3] if line.strip()), "")
    row = split(below, delimiter)
    return len(row) == len(fields) and _has_numbers(row)


def _has_numbers(fields: list[str]) -> bool:
    """Return whether the first field or most of the fields are numbers or dates."""
    kinds = [looks_like_number(one) or looks_like_stamp(one) for one in fields]
    return kinds[0] or 2 * sum(kinds) >= len(kinds)


def _numeric(section: Section) -> list[int]:
    """Return the indices of the columns whose first row is a number or a date."""
    first = section.rows[0][1]
    return [k for k, text in enumerate(first) if looks_like_number(text) or looks_like_stamp(text)]


def _decimal(found: Sequence[Section], delimiter: str) -> str:
    """Return the decimal mark: a comma if fields contain commas that are not delimiters."""
    fields = (text for one in found for _, row in one.rows[:9] for text in row)
    return "," if delimiter != "," and any("," in text for text in fields) else "."


def _values(texts: list[tuple[int, str]], decimal: str, place: str) -> np.ndarray:
    """Return the numbers of a column; dates are converted to seconds since the first date.

    `texts` are line number and field of every row.
    """
    if texts and not looks_like_number(texts[0][1]):
        stamps = read_stamps([text for _, text in texts], place)[0]
        return (stamps - stamps[0]) / 1e9
    numbers = [to_number(text, decimal) for _, text in texts]
    wrong = next((k for k, value in enumerate(numbers) if value is None), None)
    if wrong is not None:
        line, text = texts[wrong]
        raise LogError(
            f"`{printable(text)}` in line {line} is no number; correct it or remove the line.",
            where=place,
        )
    return np.array(numbers, np.float64)


def _note(number: int, section: Section, rows: int) -> str:
    """Return a note on a section: its position, its rows, and the rows that are omitted."""
    heading = f" `{printable(section.heading[:40])}`" if section.heading else ""
    text = f"section {number}{heading} at line {section.line}: {rows} rows"
    left_out = len(section.rows) - rows
    if left_out:
        text += f", left out: {left_out} with empty fields"
    if section.others:
        text += f", no rows between them: {len(section.others)}, first line {section.others[0]}"
    return f"{text}; `--column driving={number}/NAME` chooses it"
