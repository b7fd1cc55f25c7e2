"""Records: JSON, pairs of a name and a number, rows in brackets, and tables on their side.

JSON is one value, or one a line (`.jsonl`): a list of objects, an object of lists, a list of rows,
nested in any way. Pairs are `motor=1.5 load=0.8` or `motor:1.5,load:0.8`, the same in each line and
perhaps behind a date, as the serial plotters of microcontrollers and many programs write them. Rows
in brackets are those of the YARP data dumper. A table on its side has one row for each channel,
which begins with its name.
"""

import json
import re
from collections.abc import Iterator, Sequence
from functools import partial
from itertools import islice
from typing import Any

import numpy as np

from ...base.errors import LogError
from ..source import Source
from .column_names import WAYS, first_way, fold, is_statistic, unit_in, with_units
from .delimited import TextTable, is_value, looks_like_number, split, to_number
from .matlab import DEEPEST
from .samples import SAMPLE, read_long_rows, roles_of
from .table import MOST_COLUMNS, Table, table_of
from .text import Lines, printable
from .text_rows import Row, content, cut_at, numbers
from .times import looks_like_stamp, read_stamps

_JSON = re.compile(r"\s*(?:\{\s*[\"}]|\[\s*[\[{])")
_LONGEST = 19  # digits of the largest int64

_KEY = re.compile(r"(?<![\w./\]-])\"?([^\W\d][\w./\[\]-]*+)\"?\s*+[=:](?!=)")
_AMOUNT = re.compile(r"([-+]?[\d.,]+(?:[eE][-+]?\d+)?)\s*([^\d\s.,]\S*|)")
_BRACKETS = str.maketrans(dict.fromkeys("()[]{},;", " "))
_MARKS = ("\t", ";", ",", None)


def _loads(text: str) -> Any:
    """Return the value of a JSON text; whole numbers beyond int64 are float64."""
    return json.loads(text, parse_int=lambda one: int(one) if len(one) <= _LONGEST else float(one))


def read_json(lines: Lines) -> Table | None:
    """Return lists of numbers of a text that begins as objects or rows of JSON do, or None."""
    if _JSON.match(next(lines.blocks(0), "")) is None:
        return None
    notes: list[str] = []
    try:
        value = _loads("".join(lines.blocks(0)))
    except RecursionError:
        value = None
    except json.JSONDecodeError as error:
        value = _json_lines(list(lines), notes, error)
    if isinstance(value, list) and value and all(isinstance(one, dict) for one in value):
        names = list(value[0])
        rows = ((k, [str(one.get(name)) for name in names]) for k, one in enumerate(value, 1))
        first = list(islice(rows, SAMPLE))
        if (roles := roles_of(names, [row for _, row in first])) is not None:
            return read_long_rows([*first, *rows], roles, notes)
    columns, ways = dict(_json_columns("", value, 0)), dict[int, str]()
    for k, (name, words) in enumerate(columns.items()):
        if words.dtype.kind == "U":
            ways[k] = first_way(words.tolist())
            columns[name] = np.array([WAYS[fold(word)] for word in words.tolist()])
    if not 0 < len(columns) <= 4 * MOST_COLUMNS:
        raise LogError(
            f"the JSON text has {len(columns) or 'no'} lists of numbers; write a list of objects,"
            " or an object of lists."
        )
    notes.insert(0, "JSON: messages count its records from 0")
    return table_of(columns.items(), notes, ways=ways)


def _json_lines(lines: Sequence[str], notes: list[str], error: json.JSONDecodeError) -> list[Any]:
    """Return the values of a text with one value a line; a last line that is cut off is left out.

    **Raises** `LogError` for a damaged line, and with `error` for one damaged value.
    """
    found: list[Any] = []
    for number, line in enumerate(lines, 1):
        try:
            found += [_loads(line)] if line.strip() else []
        except (ValueError, RecursionError):
            what = "the JSON text is damaged or cut off here; write it again."
            if len(found) < 2:
                raise LogError(what, where=f"line {error.lineno}") from None
            notes += cut_at(lines, number, what)
    return found


def _json_columns(path: str, value: Any, depth: int) -> Iterator[tuple[str, np.ndarray]]:
    """Yield path and values of every list of numbers, dates or words for directions.

    Objects in lists are transposed.
    """
    if depth > DEEPEST:
        return
    if isinstance(value, dict):
        for key, own in value.items():
            yield from _json_columns(f"{path}.{key}" if path else key, own, depth + 1)
    if not isinstance(value, list) or len(value) < 2:
        return
    kinds = {type(one) for one in value} - {type(None)}
    if kinds == {dict}:
        for key in dict.fromkeys(key for one in value for key in one or ()):
            column = [one and one.get(key) for one in value]
            yield from _json_columns(f"{path}.{key}" if path else key, column, depth + 1)
    elif kinds == {list} and len({one and len(one) for one in value}) == 1:
        wide = len(value) < len(value[0])
        for k, column in enumerate(value if wide else map(list, zip(*value, strict=True)), 1):
            name = f"{path}({k},:)" if wide else f"{path}(:,{k})"
            yield from _json_columns(name if path else f"#{k}", column, depth + 1)
    elif kinds == {str} and looks_like_stamp(value[0] or ""):
        fields = [one or "" for one in value]
        yield f"{path} [s]", read_stamps(fields, partial(Source(path).at, ""))[0]
    elif kinds == {str} and first_way([one or "" for one in value]):
        yield path, np.array(value)
    elif kinds & {int, float} or (kinds == {str} and looks_like_number(value[0] or "")):
        # A text among numbers is no number, which a fit refuses with its place.
        array = np.array([_number(one) for one in value])
        yield path, array.astype(np.float64) if array.dtype.kind == "O" else array


def _number(value: Any) -> Any:
    if isinstance(value, int | float):
        return value
    number = to_number(value, ".") if isinstance(value, str) else None
    return np.nan if number is None else number


def _pairs(line: str) -> tuple[list[str], list[str]]:
    """Return names and texts of a line of pairs; a date in front of them has the name `time`."""
    found = list(_KEY.finditer(line))
    if not found:
        return [], []
    ends = [match.start() for match in found[1:]] + [len(line)]
    names = [match[1] for match in found]
    texts = [
        line[match.end() : end].strip(" \t,;|\"'") for match, end in zip(found, ends, strict=True)
    ]
    before = line[: found[0].start()].strip(" \t[](),;|-")
    return (["time", *names], [before, *texts]) if looks_like_stamp(before) else (names, texts)


def read_pairs(text: Lines) -> Table | None:
    """Return the columns of a text whose lines are pairs of a name and a value, or None.

    Each of the first lines has the same names, at least two with a number.
    """
    head = content(text)
    keys = [_KEY.findall(line) for line in head]
    if len(keys) > 2:
        del keys[-1]  # it may be cut off
    if len(keys) < 2 or any(own != keys[0] for own in keys):
        return None
    if not 2 <= len(keys[0]) == len(set(keys[0])) <= MOST_COLUMNS:
        return None
    lines, (names, first) = list(text), _pairs(head[0])
    if sum(_AMOUNT.match(one) is not None for one in first) < 2:
        return None
    amounts = map(_AMOUNT.fullmatch, first)
    units = [one[2] if one is not None and unit_in(one[2]) else "" for one in amounts]
    notes = [f"each line has pairs of a name and a value: {', '.join(names)}"]
    kept, other = [], 0
    for number, line in enumerate(lines, 1):
        own, texts = _pairs(line)
        if own and len(own) < len(names) and own == names[: len(own)]:
            notes += cut_at(lines, number, "the line is cut off; correct it or remove it.")
        elif own != names and line.strip():
            other += 1
        fields = zip(texts, units, strict=True) if own == names else ()
        kept.append("\t".join(text.removesuffix(unit).strip() for text, unit in fields))
    if other:
        notes.append(f"{other} lines with other names are left out")
    return _plain(with_units(names, units), kept, "\t", notes)


def _plain(
    names: Sequence[str], lines: Sequence[str], mark: str | None, notes: Sequence[str]
) -> TextTable:
    """Return a table without a header, whose line numbers are those of the file."""
    table = TextTable(names, Lines("\n".join(lines)), -1, mark, decimal=None)
    table.notes = (*notes, *table.notes)
    return table


def read_brackets(lines: Lines) -> Table | None:
    """Return the columns of lines with equally many fields, some in brackets, or None.

    At least half of the fields are numbers, in the same places of each of the first lines.
    """
    first = content(lines)
    rows = [line.translate(_BRACKETS).split() for line in first]
    if len(rows) > 2:
        del rows[-1]  # it may be cut off
    if len(rows) < 2 or not all(any(mark in line for mark in "([{") for line in first):
        return None
    kinds = {tuple(map(looks_like_number, row)) for row in rows}
    (kind,) = kinds if len(kinds) == 1 else ((),)
    if not 1 < len(kind) <= MOST_COLUMNS or 2 * sum(kind) < len(kind):
        return None
    names = [f"#{k + 1}" for k in range(len(kind))]
    rows = [line.translate(_BRACKETS) for line in lines]
    return _plain(names, rows, None, ["rows in brackets: columns #1, #2, …"])


def _side(lines: Sequence[str]) -> list[Row]:
    """Return the rows of a table on its side, or no rows for any other text.

    Every row has a name, perhaps a label such as a unit or a direction, and then only numbers, of
    which it has more than there are such rows. Rows with a name alone are headings. Statistics and
    shorter rows above and below are left out.
    """
    for mark in _MARKS if len(lines) <= MOST_COLUMNS else ():
        rows = [(number, split(line, mark)) for number, line in enumerate(lines, 1)]
        width = max(len(row) for _, row in rows)
        places = [k for k, (_, row) in enumerate(rows) if len(row) == width]
        below = [one for one in rows[places[-1] + 1 :] if one[1]]
        cut = below * (len(below) == 1 and not is_statistic(below[0][1][0]))
        inner = [(n, row) for n, row in rows[places[0] : places[-1] + 1] if len(row) > 1]
        whole = all(len(row) == width for _, row in inner)
        block = [(n, row) for n, row in inner if not is_statistic(row[0])] + cut
        if len(block) > 1 and width > len(block) + 2 and whole:
            values = (text for _, row in block for text in row[2:MOST_COLUMNS])
            if not any(is_value(row[0]) for _, row in block) and all(map(is_value, values)):
                return block
    return []


def read_side(lines: Lines) -> Table | None:
    """Return the channels of a table with one line for each, or None for another text."""
    rows = _side(lines)
    if not rows:
        return None
    number, last = rows[-1]
    if len(last) != len(rows[0][1]):
        raise LogError(
            f"this row has {len(last)} fields, but the one above has {len(rows[0][1])}; the file is"
            " cut off, write it again.",
            where=f"line {number}",
        )
    names, labels = ([row[k] for _, row in rows] for k in (0, 1))
    skip = 1 if any(map(is_value, labels)) else 2
    if skip == 2:
        named = zip(labels, with_units(names, labels), strict=True)
        names = [f"{one} {name}" if fold(one) in WAYS else name for one, name in named]
    decimal = "," if any("," in text for _, row in rows for text in row[skip:]) else "."
    columns = []
    for name, (number, row) in zip(names, rows, strict=True):
        cells = [(number, text) for text in row[skip:]]
        columns.append((name, numbers(cells, decimal, f"row `{printable(name)}`")))
    note = f"the table lies on its side: {len(rows)} rows of {len(last) - skip} samples"
    return table_of(columns, [note])
