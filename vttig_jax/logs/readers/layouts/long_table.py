"""Long tables: each line has the time, the name of the channel and one value."""

from collections.abc import Sequence
from itertools import islice, pairwise

from ....base.errors import LogError
from ..delimited import split
from ..number_format import looks_like_number
from ..table import Table
from ..times.stamps import looks_like_stamp
from .channels import Channel, table_of

_DELIMITERS = ("\t", ";", ",")
_SAMPLE = 400
"""Number of rows from which the layout is recognised (chosen)."""

_MOST_CHANNELS = 50
"""Largest number of different channel names in these rows (chosen)."""

_FEWEST = 4
"""Least mean number of rows per channel (chosen)."""


def matches(lines: Sequence[str]) -> bool:
    """Return whether each row consists of a time, one of a few channel names, and a number."""
    return _columns(lines) is not None


def read(lines: list[str], source: str) -> tuple[Table, tuple[str, ...]]:
    """Return the channels with their stamps, and notes; an incomplete last line is omitted.

    **Raises** `LogError` for a row of another form.
    """
    found = _columns(lines)
    assert found is not None  # `matches` has found it
    delimiter, (time, name, value) = found
    channels: dict[str, Channel] = {}
    notes = ["long table: every channel has its own time stamps"]
    for number, line in enumerate(lines[1:], 2):
        if not line.strip():
            continue
        fields = split(line, delimiter)
        if len(fields) <= max(time, name, value):
            if not any(rest.strip() for rest in lines[number:]):
                notes.append(f"the last line ({number}) is cut off and left out")
                continue
            raise LogError(
                "this line has too few fields; correct it or remove it.",
                where=f"{source}: line {number}",
            )
        number_text = fields[value] if delimiter == "," else fields[value].replace(",", ".")
        channels.setdefault(fields[name], Channel()).add(fields[time], number_text, number)
    return table_of(channels, source, held=False), tuple(notes)


def _columns(lines: Sequence[str]) -> tuple[str, tuple[int, int, int]] | None:
    """Return the delimiter and the column indices of time, name and value, or None."""
    for delimiter in _DELIMITERS:
        content = (line for line in islice(lines, 1, None) if line.strip())
        rows = [split(line, delimiter) for line in islice(content, _SAMPLE)]
        if len(rows) < _FEWEST or not 3 <= len(rows[0]) <= 5:
            continue
        if len({len(row) for row in rows[:-1]}) != 1:
            continue
        roles = _roles(rows[:-1], split(lines[0], delimiter))
        if roles is not None:
            return delimiter, roles
    return None


def _roles(rows: list[list[str]], head: list[str]) -> tuple[int, int, int] | None:
    if len(head) != len(rows[0]) or any(map(looks_like_number, head)):
        return None
    names, times, values = [], [], []
    for k in range(len(rows[0])):
        column = [row[k] for row in rows]
        if all(map(looks_like_stamp, column)):
            times.append(k)
        elif all(map(looks_like_number, column)):
            values.append(k)
        elif not any(map(looks_like_number, column)) and _repeats(column):
            names.append(k)
    if not times and len(values) == 2:
        times = [values.pop(0)]
    if len(names) == len(times) == len(values) == 1:
        return times[0], names[0], values[0]
    return None


def _repeats(column: list[str]) -> bool:
    """Return whether a column contains few different names, each often and mixed with others."""
    different = len(set(column))
    changes = sum(a != b for a, b in pairwise(column))
    often = different * _FEWEST <= len(column) or different * 2 <= len(column) < _FEWEST * 4
    return 2 <= different <= _MOST_CHANNELS and often and changes >= different
