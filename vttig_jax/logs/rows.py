"""Rows of a log that a user leaves out: without a number, outside a window, or in cuts."""

from collections.abc import Callable, Mapping

import numpy as np
from jaxtyping import Float, Int, Real

from ..base.errors import LogError
from ..pair.schema import LogLayout, as_cut, as_edge
from .channel.unwrap import unwrap
from .source import FEWEST_SAMPLES, Source


def kept_rows(
    layout: LogLayout,
    columns: Mapping[str, Real[np.ndarray, " n"]],
    turns: Callable[[], Float[np.ndarray, " n"]],
    place: Source,
) -> tuple[Int[np.ndarray, " m"] | None, tuple[str, ...]]:
    """Return the rows that a table [log] keeps, and notes; None for all rows.

    `columns` is role → values of the columns that are used, with the time in s, and `turns` returns
    the driving angle in turns. Places in a log count from its first sample with numbers.

    **Raises** `LogError` if fewer than `FEWEST_SAMPLES` rows are left.
    """
    stated = ((layout.start, 1), (layout.stop, -1))
    edges = [(as_edge(edge, "log"), sign) for edge, sign in stated if edge is not None]
    if not layout.leaves_out_rows:
        return None, ()
    numbers = np.logical_and.reduce([np.isfinite(one) for one in columns.values()])
    keep, notes = np.ones(len(numbers), bool), []
    if layout.missing == "skip" and not numbers.all():
        keep, first = numbers.copy(), int(np.argmin(numbers))
        lacking = [r for r, one in columns.items() if not np.isfinite(one).all()]
        names = " and ".join(f"`{place.columns.get(role, role)}`" for role in lacking)
        where = f"line {place.line_of(first)}" if place.line_of else f"sample {first}"
        count = len(numbers) - np.count_nonzero(numbers)
        notes.append(
            f"{count} of {len(numbers)} rows have no number in {names} and are left out, {where}"
            " first"
        )
    start = int(np.argmax(numbers))
    axes = {"s": lambda: columns["time"], "rev": turns}
    for (value, unit), sign in edges:
        keep &= sign * (_since(axes[unit](), start) - value) >= 0
    for text in layout.cut:
        low, high, unit = as_cut(text, "log.cut")
        along = _since(axes[unit](), start)
        keep &= ~((along >= low) & (along <= high))
    given = [("--from", layout.start), ("--to", layout.stop), *(("--cut", c) for c in layout.cut)]
    words = " ".join(f"{option} {value}" for option, value in given if value is not None)
    rows = np.flatnonzero(keep)
    if len(rows) < FEWEST_SAMPLES:
        lasts = float(np.nanmax(_since(columns["time"], start)))
        raise LogError(
            f"{words or '--missing skip'} leaves {len(rows)} of {len(keep)} samples, and a log has"
            f" at least {FEWEST_SAMPLES}; it lasts {lasts:.6g} s, and places count from its first"
            " sample.",
            where=place.name,
        )
    if words:
        notes.append(f"{len(rows)} of {len(keep)} samples are read, with {words}")
    return rows, tuple(notes)


def _since(values: Real[np.ndarray, " n"], start: int) -> Real[np.ndarray, " n"]:
    return values - values[start]


def unwrapped(
    values: Real[np.ndarray, " n"], modulus: int | float | None
) -> Real[np.ndarray, " n"]:
    """Return readings with whole turns added in the rows with numbers."""
    if modulus is None:
        return values
    found, numbers = values.copy(), np.isfinite(values)
    found[numbers] = unwrap(values[numbers], modulus)
    return found


def joined(
    readings: Mapping[str, Real[np.ndarray, " n"]],
    rows: Int[np.ndarray, " m"],
    moduli: Mapping[str, int | float | None],
    sizes: Mapping[str, float],
) -> dict[str, Real[np.ndarray, " m"]]:
    """Return the readings of the shafts in the kept rows, unwrapped through the rows left out.

    A gap may hold whole turns, which the readings in it count, or damaged readings, which do not.
    Of both ways through a gap, that over its readings and that of the smallest step, each shaft
    takes the one with which both shafts turn alike.

    `moduli` is role → readings at which they wrap, or None; `sizes` is role → radians of the driven
    shaft per reading.
    """
    gaps = np.flatnonzero(np.diff(rows) > 1)
    found, steps = {}, {}
    for role, values in readings.items():
        found[role] = near = unwrapped(values[rows], moduli[role])
        through = unwrapped(values, moduli[role])[rows]
        steps[role] = np.array([np.diff(through)[gaps], np.diff(near)[gaps]])
    ways = dict.fromkeys(readings, np.zeros(len(gaps), np.int64))
    if len(readings) == 2:
        x, y = (sizes[role] * steps[role] for role in ("driving", "driven"))
        best = np.abs(y - x[:, None]).reshape(4, -1).argmin(axis=0)
        ways = {"driving": best // 2, "driven": best % 2}
    for role, near in found.items():
        chosen = steps[role][ways[role], np.arange(len(gaps))]
        turns = np.zeros(len(rows), near.dtype)
        turns[gaps + 1] = chosen - steps[role][1]
        found[role] = near + np.cumsum(turns)
    return found


def complete(columns: Mapping[int, Real[np.ndarray, " _"]]) -> dict[int, Real[np.ndarray, " _"]]:
    """Return the columns in rows in which each of them has a number, to compare them.

    A column that leaves fewer than three times `FEWEST_SAMPLES` of these rows is left out.
    """
    found: dict[int, np.ndarray] = {}
    for size in {len(one) for one in columns.values()}:
        numbers = {k: np.isfinite(one) for k, one in columns.items() if len(one) == size}
        rows, kept = np.ones(size, bool), []
        for k in sorted(numbers, key=lambda k: -np.count_nonzero(numbers[k])):
            both = rows & numbers[k]
            if np.count_nonzero(both) >= min(3 * FEWEST_SAMPLES, size):
                rows, kept = both, [*kept, k]
        found |= {k: columns[k][rows] for k in kept}
    return dict(sorted(found.items()))
