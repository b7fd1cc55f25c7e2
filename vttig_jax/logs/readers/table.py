"""Delimited text as a table: which delimiter, and where the header is, if there is one."""

from collections.abc import Sequence
from itertools import islice

from ...base.errors import LogError
from .delimited import TextTable, split
from .number_format import CURE, looks_like_number

DELIMITERS = ("\t", ";", ",", "|", None)
"""Tried in this order; None is any run of blanks."""

NAMED = {"tab": "\t", "\\t": "\t", "space": None, " ": None, "semicolon": ";", "comma": ","}

PREAMBLE = 1000
"""Lines among which the first row of numbers is looked for."""

COMMENTS = ("#", "%", "//")


def find_table(
    text: str,
    source: str,
    *,
    delimiter: str | None = None,
    decimal: str | None = None,
    highest: int = 0,
) -> TextTable:
    """Find header and delimiter of a delimited table; lines before the header are skipped.

    The header is the last line before the first row of numbers that has as many fields; it may be
    a comment. With `highest`, the highest number among columns asked for by number (`#2`), a table
    needs no header and one column will do; without a header the columns are called #1, #2, ….

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
        return TextTable(tuple(names), lines, header, candidate, decimal, source)
    if highest:
        table = _headerless(lines, tried, source, decimal, highest, sure=delimiter is not None)
        if table is not None:
            return table
    raise _no_table(lines, tried, source)


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


def _headerless(
    lines: list[str],
    tried: Sequence[str | None],
    source: str,
    decimal: str | None,
    highest: int,
    *,
    sure: bool,
) -> TextTable | None:
    """The rows of numbers as a table with columns #1, #2, …; None where there are none.

    `sure`: the delimiter was given, so that a comma between digits is that.
    """
    quoted = any('"' in line for line in lines[:PREAMBLE])
    if decimal == "," and not sure and not quoted:
        tried = [one for one in tried if one != ","]
    starts = {one: _first_row(lines, one) for one in tried}
    rows = {one: split(lines[k], one) for one, k in starts.items() if k is not None}
    whole = [one for one, fields in rows.items() if all(map(looks_like_number, fields))]
    for delimiter in (*whole, *rows):
        start = starts[delimiter]
        assert start is not None  # `rows` has no others
        names = tuple(f"#{k + 1}" for k in range(len(rows[delimiter])))
        table = TextTable(names, lines, start - 1, delimiter, decimal, source)
        if delimiter == "," and decimal is None and not sure:
            _refuse_doubtful_commas(table, highest)
        return table
    return _single_column(lines, tried, source, decimal)


def _refuse_doubtful_commas(table: TextTable, highest: int) -> None:
    """`147,31` is two columns or one number, unless a column beyond the first half is asked for."""
    width = len(table.names)
    if width % 2 or 2 * highest > width:
        return
    rows = list(islice(table.rows(), 100))
    lines = [table.lines[number - 1].strip() for number, _ in rows]
    for line, (_, fields) in zip(lines, rows, strict=True):
        behind = fields[1::2]
        fronts = [field.lstrip("+-") for field in fields[::2]]
        if " " in line or len(fields) != width or not all(map(str.isdigit, fronts + behind)):
            return
    numbers = "one number" if width == 2 else f"{width // 2} numbers"
    raise LogError(
        f"`{lines[0]}` is {width} columns, or {numbers} with a decimal comma; {CURE}.",
        where=f"{table.source}: line {rows[0][0]}",
    )


def _single_column(
    lines: list[str], tried: Sequence[str | None], source: str, decimal: str | None
) -> TextTable | None:
    """A column of numbers, below its name or without one; each may end with a delimiter."""
    for delimiter in tried:
        for k, line in enumerate(lines[:PREAMBLE]):
            if not line.strip() or line.lstrip().startswith(COMMENTS):
                continue
            fields = split(line, delimiter)
            if (delimiter is not None and delimiter not in line) or len(fields) != 1:
                continue
            if not looks_like_number(fields[0]):
                continue
            above = _names(lines[k - 1], delimiter) if k else []
            names = tuple(above) if len(above) == 1 else ("#1",)
            return TextTable(names, lines, k - 1, delimiter, decimal, source)
    return None


def _no_table(lines: list[str], tried: Sequence[str | None], source: str) -> LogError:
    for delimiter in tried:
        start = _first_row(lines, delimiter)
        if start is not None:
            return LogError(
                "numbers without a header; put a line with column names such as"
                " time_s,driving_counts,driven_counts above them, or name the columns by number"
                " (--column driving=#1).",
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
        " line (a single column of numbers is read with driving=#1 and driven=#row).",
        where=source,
    )
