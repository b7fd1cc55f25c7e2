"""LabVIEW measurement file (LVM): two headers, a row of names, and rows of numbers.

The file header says how many columns of time the rows have: one for all channels, one for each
(`Multi`), or none, where X0 and Delta_X of the segment header give the stamps. The segment header
has the units. Format: National Instruments, Specification for the LabVIEW Measurement File.
"""

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float

from ....base.errors import LogError
from ..column_names import unit_in
from ..delimited import split
from ..number_format import to_number
from ..table import Table

START, END = "LabVIEW Measurement", "***End_of_Header***"
_KEYS = ("Channels", "Samples", "X0", "Delta_X")
"""Keys of a segment header; the file header has none of them."""


def matches(lines: Sequence[str]) -> bool:
    """Return whether the text begins as a LabVIEW measurement file does."""
    return lines[0].lstrip("\ufeff").strip().startswith(START)


def read(lines: list[str], source: str) -> tuple[Table, tuple[str, ...]]:
    """Return the channels with their time stamps in s, and a note.

    **Raises** `LogError` for a file without rows or with several segments, for an axis that is not
    time, and for a field that is no number.
    """
    ends = [k for k, line in enumerate(lines) if line.strip(" \t,;").startswith(END)]
    mark = "," if any(line.startswith("Separator,") for line in lines[:40]) else "\t"
    header = {fields[0]: fields[1:] for fields in _rows(lines[: ends[-1]] if ends else [], mark)}
    if not ends or not set(_KEYS) & set(header) or len(lines) < ends[-1] + 3:
        raise LogError("the measurement has no rows of numbers; export it again.", where=source)
    if len(ends) > 2:
        raise LogError(
            f"the file has {len(ends) - 1} segments with headers of their own; write the"
            " measurement as one segment.",
            where=source,
        )
    axis = next((name for name in header.get("X_Dimension", []) if name), "Time")
    if axis != "Time":
        raise LogError(
            f"its x axis is {axis} and not time; export channels over time.", where=source
        )
    names = split(lines[ends[-1] + 1], mark, trim=False)
    rows = [
        (number, split(line, mark, trim=False))
        for number, line in enumerate(lines[ends[-1] + 2 :], ends[-1] + 3)
        if line.strip()
    ]
    notes = ["LabVIEW measurement"]
    # Without a line end, a last row of fewer fields or shorter numbers was not written to its end.
    if lines[-1].strip() and len(rows) > 1:
        notes.append(f"the last line ({rows.pop()[0]}) has no end and is left out")
    decimal = (header.get("Decimal_Separator") or ["."])[0] or "."
    table = _table(names, rows, header, decimal=decimal, source=source)
    if table.clocks:
        notes[0] += ": channels with stamps of their own"
    return table, tuple(notes)


def _rows(lines: Sequence[str], mark: str) -> list[list[str]]:
    return [fields for line in lines if (fields := split(line, mark, trim=False)) and fields[0]]


def _table(
    names: Sequence[str],
    rows: Sequence[tuple[int, list[str]]],
    header: Mapping[str, Sequence[str]],
    *,
    decimal: str,
    source: str,
) -> Table:
    """Return the channels, with clocks if their stamps differ."""
    values = [k for k, name in enumerate(names) if name not in ("X_Value", "Comment", "")]
    own = header.get("X_Columns", ["One"])[0]
    columns: list[str] = []
    arrays: list[np.ndarray] = []
    clocks: dict[int, int] = {}
    read: dict[int, np.ndarray] = {}  # column of stamps → stamps
    for place, k in enumerate(values):
        channel = _column(rows, k, decimal, f"{source}: column `{names[k]}`")
        if own == "No":
            x0, step = (_of_channel(header, key, place, values) for key in ("X0", "Delta_X"))
            first, delta = (to_number(text, decimal) for text in (x0, step))
            stamps = (first or 0.0) + (delta or 0.0) * np.arange(len(channel))
        else:
            at = k - 1 if own == "Multi" else 0
            if at not in read:
                read[at] = _column(rows, at, decimal, f"{source}: column `X_Value`")
            stamps = read[at][: len(channel)]
        clock = next((c for c in set(clocks.values()) if np.array_equal(arrays[c], stamps)), None)
        if clock is None:
            clock = len(columns)
            columns.append(f"time {len(set(clocks.values())) + 1} [s]")
            arrays.append(stamps)
        unit = _of_channel(header, "Y_Unit_Label", place, values)
        clocks[len(columns)] = clock
        columns.append(f"{names[k]} [{unit}]" if unit_in(unit) else names[k])
        arrays.append(channel)
    if len(set(clocks.values())) < 2:
        clocks = {}
    return Table(tuple(columns), tuple(arrays), source, clocks=clocks)


def _of_channel(
    header: Mapping[str, Sequence[str]], key: str, place: int, channels: Sequence[int]
) -> str:
    """Return the entry of a channel in a row of the segment header, or "" without one."""
    entries = [field for field in header.get(key, []) if field]
    return entries[place] if len(entries) == len(channels) else ""


def _column(
    rows: Sequence[tuple[int, list[str]]], k: int, decimal: str, where: str
) -> Float[np.ndarray, " n"]:
    """Return the numbers of a column; channels of fewer samples end with empty fields."""
    values = []
    for number, fields in rows:
        if k >= len(fields) or not fields[k]:
            break
        value = to_number(fields[k], decimal)
        if value is None:
            raise LogError(
                f"line {number}: `{fields[k]}` is no number; correct it or remove the line.",
                where=where,
            )
        values.append(value)
    return np.array(values)
