"""Files in sections: several tables in one text, each with a header and perhaps a heading.

Guide logs, reports of test stands and the sheets of a workbook are such files. A section begins
with a line of names, perhaps a row of units, and a row of numbers with as many fields. Its columns
are named `2/motor` for column `motor` of section 2.
"""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from ..column_names import is_units_row, with_units
from ..delimited import is_value, split
from ..number_format import looks_like_number
from ..table import Table
from ..text import Lines, printable
from .cells import Found, Layout, Row, decimal_of, numbers

DELIMITERS = (",", ";", "\t")
"""Delimiters in the order in which they are tried."""

FEWEST_ROWS = 3
"""Least number of rows of a table that counts as a section (chosen)."""

_BELOW_FIRST = 2
"""Number of lines of the first header and the first row; no second section can begin in them."""

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

    def columns(self, number: int, mark: str, source: str) -> Iterator[tuple[str, np.ndarray]]:
        """Yield the columns whose first row is a number or a date, of rows in which none lacks."""
        named = with_units(self.names, self.units or [])
        first = self.rows[0][1]
        chosen = [k for k, text in enumerate(first) if is_value(text)]
        self.others += [line for line, row in self.rows if not all(row[k] for k in chosen)]
        self.rows = [row for row in self.rows if all(row[1][k] for k in chosen)]
        for k in chosen:
            name = printable(named[k])
            place = f"section {number}, column `{name}`"
            cells = [(line, row[k]) for line, row in self.rows]
            yield f"{number}/{name}", numbers(cells, decimal_of(self.rows, mark), source, place)


def _matches(lines: Lines) -> bool:
    """Return whether the text has at least two tables, each with a line of names."""
    return lines.match(_WORD, _BELOW_FIRST) and len(_sections(list(lines))[0]) > 1


def _read(lines: list[str], source: str) -> Found:
    found, mark = _sections(lines)
    columns: dict[str, np.ndarray] = {}
    notes = []
    for number, section in enumerate(found, 1):
        columns.update(section.columns(number, mark, source))
        heading = f" `{printable(section.heading[:40])}`" if section.heading else ""
        note = f"section {number}{heading} at line {section.line}: {len(section.rows)} rows"
        if section.others:
            note += f"; {len(section.others)} lines between them are left out, the first is line"
            note += f" {min(section.others)}"
        notes.append(f"{note}; `--column driving={number}/NAME` chooses it")
    return Table(tuple(columns), tuple(columns.values()), source), tuple(notes)


def _sections(lines: Sequence[str]) -> tuple[list[Section], str]:
    """Return the sections of a text and its delimiter; no sections if there are fewer than two."""
    for mark in (mark for mark in DELIMITERS if any(mark in line for line in lines)):
        found = [one for one in _walk(lines, mark) if len(one.rows) >= FEWEST_ROWS]
        if len(found) > 1:
            return found, mark
    return [], DELIMITERS[0]


def _walk(lines: Sequence[str], mark: str) -> Iterator[Section]:
    """Yield the tables of a text in their order."""
    current: Section | None = None
    heading, between, parted = "", [], True
    for number, line in enumerate(lines, 1):
        if not line.strip():
            heading, parted = "", True
            continue
        fields = split(line, mark)
        # A line of text between two rows is a damaged row, unless it repeats the names.
        begins = parted or (current is not None and fields == current.names)
        parted = False
        if begins and _WORD.match(line) and _is_header(fields, lines, number, mark):
            if current is not None:
                yield current
            current = Section(heading, fields, number)
            heading, between = "", []
        elif current is not None and len(fields) == len(current.names) and _has_numbers(fields):
            current.others += between
            current.rows.append((number, fields))
            between = []
        elif current is not None and not current.rows and is_units_row(fields):
            current.units = fields
        else:
            heading, parted = heading or line.strip(), True
            between.append(number)
    if current is not None:
        yield current


def _is_header(fields: list[str], lines: Sequence[str], number: int, mark: str) -> bool:
    """Return whether `fields`, from the line `number`, are names above a row of numbers."""
    if len(fields) < 2 or not all(fields) or any(map(looks_like_number, fields)):
        return False
    below = [line for line in lines[number : number + 4] if line.strip()][:2]
    if not any(map(_DIGIT.search, below)):
        return False
    rows = [split(line, mark) for line in below]
    row = rows[-1] if is_units_row(rows[0]) else rows[0]
    return len(row) == len(fields) and _has_numbers(row)


def _has_numbers(fields: list[str]) -> bool:
    """Return whether the first field or most of the fields are numbers or dates."""
    kinds = list(map(is_value, fields))
    return kinds[0] or 2 * sum(kinds) >= len(kinds)


SECTIONS = Layout(_matches, _read)
