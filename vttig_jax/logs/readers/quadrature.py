"""Angles in counts from the levels of two channels: A and B, or STEP and DIR.

The name `quadrature(A,B)` of a requested column means the counts of the channels `A` and `B`: four
counts a period if their edges alternate, and one count a rising edge of the first channel if it has
more than twice the edges of the second one, which is then the direction.
"""

import re
from collections.abc import Iterable

import numpy as np
from jaxtyping import Int64, Real

from ...base.errors import LogError
from .column_names import index_of
from .table import Table
from .times.stamps import read_stamps

_COUNTED = re.compile(r"quadrature\(\s*([^,]+?)\s*,\s*([^,]+?)\s*\)(?:\s*\[counts\])?")
_LOW, _HIGH = 1 / 3, 2 / 3
"""A level falls below the first fraction of its range and rises above the second one (chosen)."""


def with_counts(table: Table, requested: Iterable[str | None]) -> Table:
    """Return the table with a column for each requested `quadrature(A,B)`, and notes on them.

    **Raises** `LogError` for a channel that does not exist or stays at one level, and for levels
    that change so fast that counts are lost.
    """
    matches = filter(None, (_COUNTED.fullmatch(name or "") for name in requested))
    wanted = {f"quadrature({match[1]},{match[2]})": match.groups() for match in matches}
    if not wanted:
        return table
    columns = {table.names[k]: values for k, values in table.numeric().items()}
    for k, name in enumerate(table.names):
        if table.is_dated(k):
            columns[f"{name} [s]"] = read_stamps(table.texts(k), table.source)[0] / 1e9
    notes = [*table.notes, *table.left_out(range(len(columns)))]
    names = tuple(columns)
    for name, channels in wanted.items():
        pair = [names[index_of(one, "driving", names, table.source)] for one in channels]
        a, b = (_levels(columns[one], f"{table.source}: column `{one}`") for one in pair)
        edges = [int(np.count_nonzero(np.diff(one))) for one in (a, b)]
        steps = edges[0] > 2 * edges[1]
        counts = _steps(a, b) if steps else _quadrature(a, b, f"{table.source}: `{name}`")
        columns[f"{name} [counts]"] = counts
        how = f"the rising edges of `{pair[0]}` in the direction of `{pair[1]}`"
        four = f"the edges of `{pair[0]}` and `{pair[1]}`, four a period"
        notes.append(f"{name} counts {how if steps else four}: {sum(edges)} edges")
    return Table(
        tuple(columns),
        tuple(columns.values()),
        table.source,
        digest=table.digest,
        notes=tuple(notes),
    )


def _levels(values: Real[np.ndarray, " n"], where: str) -> Int64[np.ndarray, " n"]:
    """Return the level of each sample, 0 or 1; between both thresholds it is that before."""
    low, span = float(values.min()), float(np.ptp(values))
    if not 0 < span < np.inf:
        raise LogError(
            "the level of this channel never changes; name the channels A and B, or STEP and DIR.",
            where=where,
        )
    share = (values - low) / span
    clear = (share < _LOW) | (share > _HIGH)
    known = np.maximum.accumulate(np.where(clear, np.arange(len(values)), 0))
    return (share[known] > _HIGH).astype(np.int64)


def _quadrature(
    a: Int64[np.ndarray, " n"], b: Int64[np.ndarray, " n"], where: str
) -> Int64[np.ndarray, " n"]:
    """Return the counts of A and B, +1 for each edge where A leads."""
    moves = np.diff((a ^ b) + 2 * b) % 4  # the order of the states is 00, 10, 11, 01
    lost = np.flatnonzero(moves == 2)
    if lost.size:
        raise LogError(
            f"both levels change at once {lost.size} times, first at sample {lost[0] + 1}, so that"
            " counts are lost; sample at least eight times a period.",
            where=where,
        )
    return np.concatenate([[0], np.cumsum(np.where(moves == 3, -1, moves))])


def _steps(step: Int64[np.ndarray, " n"], way: Int64[np.ndarray, " n"]) -> Int64[np.ndarray, " n"]:
    """Return the counts of STEP, +1 for each rising edge where DIR is high, and −1 elsewhere."""
    rises = np.diff(step) > 0
    return np.concatenate([[0], np.cumsum(np.where(rises, 2 * way[1:] - 1, 0))])
