"""Output of LinuxCNC `halsampler` with lost samples: lines `overrun` between the rows of numbers.

The rows have neither header nor time. With the option -t of halsampler, the first field is the
number of the sample. An output without a line `overrun` is read like any table without a header.
"""

import numpy as np

from ....base.errors import LogError
from ..number_format import looks_like_number
from ..table import MOST_COLUMNS, Table
from ..text import Lines
from .cells import Found, Layout, Row, numbers

OVERRUN = "overrun"
LOST = 10
"""Number of samples assumed to be lost in a gap of unknown length (chosen). It is more than five,
so that all later steps treat the gap as a pause."""


def _matches(lines: Lines) -> bool:
    """Return whether a line is `overrun` and the first other line contains only numbers."""
    if not lines.have(OVERRUN) or OVERRUN not in (line.strip() for line in lines):
        return False
    first = next((line for line in lines if line.strip() not in ("", OVERRUN)), "").split()
    return 0 < len(first) <= MOST_COLUMNS and all(map(looks_like_number, first))


def _read(lines: list[str], source: str) -> Found:
    rows: list[Row] = []
    gaps: list[int] = []
    for number, line in enumerate(lines, 1):
        fields = line.split()
        if fields == [OVERRUN]:
            gaps.append(len(rows))
        elif fields:
            if rows and len(fields) != len(rows[0][1]):
                if not any(rest.strip() for rest in lines[number:]):
                    break  # the last line is cut off
                raise LogError(
                    f"this row has {len(fields)} fields, but the first one has {len(rows[0][1])};"
                    " correct it or remove the line.",
                    where=f"{source}: line {number}",
                )
            rows.append((number, fields))
    names = tuple(f"#{k + 1}" for k in range(len(rows[0][1])))
    arrays = tuple(
        numbers([(number, row[k]) for number, row in rows], ".", source, f"column {name}")
        for k, name in enumerate(names)
    )
    inner = [gap for gap in gaps if 0 < gap < len(rows)]
    counts, counted = _sample_numbers(arrays[0], inner)
    how = "as the sample numbers say" if counted else f"each taken as {LOST} samples"
    note = f"halsampler: {len(inner)} gaps where samples were lost, {how}"
    return Table(names, arrays, source, sample_numbers=counts), (note,)


def _sample_numbers(first: np.ndarray, gaps: list[int]) -> tuple[np.ndarray, bool]:
    """Return the number of each sample, and whether the first column contains these numbers.

    `first` is the first column; `gaps` are the indices of the rows after a gap.
    """
    steps = np.diff(first)
    inside = np.delete(steps, [gap - 1 for gap in gaps])
    wraps = np.unique(inside[inside != 1])
    counted = first.dtype.kind == "i" and np.all(inside[inside != 1] < 0) and len(wraps) <= 1
    if counted and np.mean(inside == 1) > 0.9:
        modulus = 1 - int(wraps[0]) if len(wraps) else 0
        if modulus:
            steps = np.mod(steps, modulus)
        if np.all(steps > 0):
            return np.concatenate([[0], np.cumsum(steps)]), True
    numbers = np.arange(len(first))
    for gap in gaps:
        numbers[gap:] += LOST
    return numbers, False


HALSAMPLER = Layout(_matches, _read)
