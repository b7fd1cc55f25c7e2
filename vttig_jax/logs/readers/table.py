"""Detection of the delimiter and the header of delimited text."""

import re
from collections import Counter
from collections.abc import Iterator, Sequence
from itertools import islice

from ...base.errors import LogError
from .delimited import TextTable, split
from .lines import Lines
from .matrix_columns import MOST_COLUMNS
from .number_format import CURE, looks_like_number
from .times.stamps import looks_like_stamp
from .units_row import is_units_row, with_units

DELIMITERS = ("\t", ";", ",", "|", None)
"""Delimiters in the order in which they are tried; None means one or more blanks."""

NAMED = {"tab": "\t", "\\t": "\t", "space": None, " ": None, "semicolon": ";", "comma": ","}

PREAMBLE = 1000
"""Number of lines in which the first row of numbers is searched (chosen)."""

_LONGEST = 10_000
"""Most characters of the name of a column (chosen)."""

COMMENTS = ("#", "%", "//")

EMPTY = " \t\r;,|"
"""Characters of a line without content, such as an empty row at the end of a spreadsheet."""

_SEPARATOR = re.compile(r'"?sep=(\\t|.)"?', re.IGNORECASE)
"""Pattern of the first line of a file for Excel that names the delimiter."""


def find_table(
    text: str,
    source: str,
    *,
    delimiter: str | None = None,
    decimal: str | None = None,
    highest: int = 0,
) -> TextTable:
    """Find the header and delimiter of a delimited table; lines before the header are skipped.

    The header is the last line before the first row of numbers with the same number of fields; it
    may be a comment. `highest` is the highest requested column number (`#2`) or 0. With a number,
    the table may have one column and no header; its columns are then named #1, #2, ….

    **Raises** `LogError` for text without header or without rows below it.
    """
    lines = Lines.of(text).without_empty_end(EMPTY)
    stated = _SEPARATOR.fullmatch(lines[0].strip())
    if stated is not None:
        lines = Lines.of(text[len(lines[0]) : lines.stop])
    if delimiter is None:
        candidates = DELIMITERS if stated is None else (stated[1].replace("\\t", "\t"),)
    else:
        candidates = (NAMED.get(delimiter, delimiter),)
        if candidates[0] is not None and len(candidates[0]) != 1:
            raise LogError(
                f"{delimiter!r} is no delimiter; write one character, tab or space.",
                where="log.delimiter",
            )
    for candidate in candidates:
        start = _first_row(lines, candidate)
        if start is None:
            continue
        _refuse_side(lines, start, candidate, source)
        header = _header_before(lines, start, candidate)
        if header is None:
            continue
        names = _names_with_units(lines, header, candidate)
        if max(map(len, names)) > _LONGEST:
            raise LogError("no name of a column is so long.", where=f"{source}: line {header + 1}")
        _check_width(lines[start], start, names, candidate, source)
        return TextTable(
            names=tuple(names),
            lines=lines,
            header=header,
            delimiter=candidate,
            decimal=decimal,
            source=source,
        )
    if highest:
        given = delimiter is not None
        table = _headerless(lines, candidates, source, decimal, highest, given=given)
        if table is not None:
            return table
    raise _no_table(lines, candidates, source)


def _refuse_side(lines: Lines, start: int, delimiter: str | None, source: str) -> None:
    """Raise `LogError` for rows of more fields than a log has channels and the text has lines."""
    width, rows = len(split(lines[start], delimiter)), len(lines) - start
    if width > max(MOST_COLUMNS, rows):
        raise LogError(
            f"the table lies on its side: {width} columns, but {rows} rows; write a column for each"
            " channel, or begin each row with the name of its channel.",
            where=f"{source}: line {start + 1}",
        )


def _names(line: str, delimiter: str | None) -> list[str]:
    text = line.strip()
    for mark in COMMENTS:
        text = text.removeprefix(mark)
    if delimiter is None:  # keeps "time [s]" as one name
        text = text.replace(" [", "[").replace(" (", "(")
    return split(text, delimiter)


def _names_with_units(lines: Lines, header: int, delimiter: str | None) -> list[str]:
    """Return the column names; a row of units as header line is added to the names above it."""
    names = _names(lines[header], delimiter)
    if header == 0 or not is_units_row(split(lines[header], delimiter, trim=False)):
        return names
    above = _names(lines[header - 1], delimiter)
    if len(above) < len(names) or all(map(looks_like_number, above)):
        return names
    return with_units(above, split(lines[header], delimiter, trim=False))


def _first_row(lines: Lines, delimiter: str | None) -> int | None:
    """Return the index of the first row of numbers of the table, or None.

    A row of numbers has at least two fields, at least half of them numbers. A line such as
    `Channels:;3` above the table is skipped, because the next line is not a row of numbers and the
    rows of the table have another number of fields. Several such lines are skipped if at least
    twice as many rows have another number of fields.
    """
    found = list(_rows_of_numbers(lines, delimiter))
    if not found:
        return None
    first, width = found[0]
    widths = Counter(width for _, width in found)
    usual, times = widths.most_common(1)[0]
    if times >= 2 * widths[width]:
        return next(k for k, width in found if width == usual)
    rows = iter(found[1:])
    following = _next_with_content(lines, first)
    if following is None or _width_of_numbers(lines[following], delimiter) == width:
        return first
    for k, other in rows:
        after = _next_with_content(lines, k)
        below = 0 if after is None else _width_of_numbers(lines[after], delimiter)
        if width != other == below:
            return k
    return first


def _rows_of_numbers(lines: Lines, delimiter: str | None) -> Iterator[tuple[int, int]]:
    """Yield line index and number of fields of each row of numbers among the first lines."""
    head = lines[: PREAMBLE + 1]
    for k, line in enumerate(head[:PREAMBLE]):
        width = _width_of_numbers(line, delimiter)
        # Names such as `x-axis,1,2` are above units, not above numbers.
        if width and not is_units_row(split("".join(head[k + 1 : k + 2]), delimiter)):
            yield k, width


def _width_of_numbers(line: str, delimiter: str | None) -> int:
    """Return the number of fields of a row of numbers, or 0 for any other line."""
    if (delimiter or "") not in line or line.lstrip().startswith(COMMENTS):
        return 0
    fields = split(line, delimiter)
    if len(fields) < 2:
        return 0
    numbers = sum(looks_like_number(field) or looks_like_stamp(field) for field in fields)
    return len(fields) if 2 * numbers >= len(fields) else 0


def _next_with_content(lines: Lines, row: int) -> int | None:
    """Return the index of the first line after `row` with content that is no comment, or None."""
    for k in range(row + 1, min(len(lines), PREAMBLE)):
        if lines[k].strip() and not lines[k].lstrip().startswith(COMMENTS):
            return k
    return None


def _header_before(lines: Lines, start: int, delimiter: str | None) -> int | None:
    """Return the index of the header of the table whose first row is `start`, or None.

    If no line has the number of names, it is the nearest line of several names. Between blanks,
    more names than columns are no header: a name has several words, or the line is a sentence. A
    row of numbers with empty fields has another width than `start` and is no header.
    """
    width = len(split(lines[start], delimiter))
    fallback = None
    for k in range(start - 1, -1, -1):
        names = _names(lines[k], delimiter)
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
    line: str, start: int, names: list[str], delimiter: str | None, source: str
) -> None:
    width = len(split(line, delimiter))
    if width > len(names):
        cure = (
            "save it with semicolons if it has decimal commas."
            if delimiter == ","
            else "correct the header."
        )
        raise LogError(
            f"this row has {width} fields, but the header has {len(names)}; {cure}",
            where=f"{source}: line {start + 1}",
        )


def _headerless(
    lines: Lines,
    candidates: Sequence[str | None],
    source: str,
    decimal: str | None,
    highest: int,
    *,
    given: bool,
) -> TextTable | None:
    """Return the rows of numbers as a table with columns #1, #2, …, or None without rows.

    `given` is true if the user stated the delimiter; a comma between digits is then a delimiter.
    """
    quoted = any('"' in line for line in lines[:PREAMBLE])
    if decimal == "," and not given and not quoted:
        candidates = [mark for mark in candidates if mark != ","]
    starts = {mark: _first_row(lines, mark) for mark in candidates}
    rows = {mark: split(lines[k], mark) for mark, k in starts.items() if k is not None}
    numeric = [mark for mark, fields in rows.items() if all(map(looks_like_number, fields))]
    for delimiter in (*numeric, *rows):
        start = starts[delimiter]
        assert start is not None  # `rows` has no other delimiters
        names = tuple(f"#{k + 1}" for k in range(len(rows[delimiter])))
        table = TextTable(
            names=names,
            lines=lines,
            header=start - 1,
            delimiter=delimiter,
            decimal=decimal,
            source=source,
        )
        if delimiter == "," and decimal is None and not given:
            _refuse_ambiguous_commas(table, highest)
        return table
    return _single_column(lines, candidates, source, decimal)


def _refuse_ambiguous_commas(table: TextTable, highest: int) -> None:
    """Raise `LogError` for rows such as `147,31`, which are two columns or one decimal number.

    If `highest`, the highest requested column number, needs all columns, the comma delimits them.
    """
    width = len(table.names)
    if width % 2 or 2 * highest > width:
        return
    rows = list(islice(table.rows(), 100))
    lines = [table.lines[number - 1].strip() for number, _ in rows]
    for line, (_, fields) in zip(lines, rows, strict=True):
        decimals = fields[1::2]
        integers = [field.lstrip("+-") for field in fields[::2]]
        if " " in line or len(fields) != width or not all(map(str.isdigit, integers + decimals)):
            return
    numbers = "one number" if width == 2 else f"{width // 2} numbers"
    raise LogError(
        f"`{lines[0]}` means {width} columns, or {numbers} with a decimal comma; {CURE}.",
        where=f"{table.source}: line {rows[0][0]}",
    )


def _single_column(
    lines: Lines, candidates: Sequence[str | None], source: str, decimal: str | None
) -> TextTable | None:
    """Return a table of one column with or without a name, or None.

    Each line may end with a delimiter.
    """
    for delimiter in candidates:
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
            return TextTable(
                names=names,
                lines=lines,
                header=k - 1,
                delimiter=delimiter,
                decimal=decimal,
                source=source,
            )
    return None


def _no_table(lines: Lines, candidates: Sequence[str | None], source: str) -> LogError:
    for delimiter in candidates:
        start = _first_row(lines, delimiter)
        if start is not None:
            return LogError(
                "the numbers are without a header; write a line with column names such as"
                " time_s,driving_counts,driven_counts above them, or name the columns by number"
                " (--column driving=#1).",
                where=f"{source}: line {start + 1}",
            )
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
