"""Table: named columns of one file, each of which is read once, when it is used.

Some are computed from others by a formula such as `0.5*(m1+m2)`, with numbers, names of columns, +,
-, * and brackets. `quadrature(A,B)` are the counts of the levels of two channels, A and B or STEP
and DIR: four counts a period if their edges alternate, and one count a rising edge of the first
channel if it has more than twice the edges of the second one, which is then the direction.

Passes up and down that stand side by side, such as `position,up1,down1`, become one below the
other.
"""

import ast
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int64, Real, Shaped

from ...base.errors import LogError
from .column_names import (
    SHAFT_UNITS,
    WAYS,
    has_time,
    index_of,
    is_statistic,
    name_and_unit,
    stem_and_unit,
    ways_in,
    words_of,
)
from .text import printable
from .times import read_stamps

MOST_COLUMNS = 256
"""Largest number of channels in one matrix, its shorter side, and of columns of a text that has
fewer rows than columns (chosen)."""


@dataclass(eq=False)
class Table:
    """Columns of a file that are arrays; `TextTable` parses them from a text.

    - `names`: names of the columns; a text without a header has the names #1, #2, ….
    - `arrays`: values of the columns, which may differ in length.
    - `source`, `digest`: name of the file, and the SHA-256 of its bytes.
    - `clocks`: index of a column → index of the column with its time stamps in s, for channels with
      separate time stamps. - `held`: indices of columns of which only changes are logged.
    - `sample_numbers`: numbers of the rows in the full record if samples are missing.
    - `notes`: sentences on assumptions and on what is left out.
    - `ways`: index of a column of directions → the word in its first row, as it was written.
    - `computed`: the last columns, which are computed from others when they are read.
    """

    names: tuple[str, ...]
    arrays: tuple[Shaped[np.ndarray, " _"], ...]
    source: str = ""
    clocks: Mapping[int, int] = field(default_factory=dict)
    held: frozenset[int] = frozenset()
    sample_numbers: Int64[np.ndarray, " _"] | None = None
    digest: str = ""
    notes: tuple[str, ...] = ()
    ways: Mapping[int, str] = field(default_factory=dict)
    computed: "tuple[Computed, ...]" = ()

    @property
    def own(self) -> int:
        """Number of the columns of the file; computed ones follow them."""
        return len(self.names) - len(self.computed)

    def needed(self, indices: Iterable[int]) -> list[int]:
        """Return the columns of the file from which these columns follow."""
        of = ((k,) if k < self.own else self.computed[k - self.own].of for k in indices)
        return list(dict.fromkeys(k for one in of for k in one))

    def columns(self, indices: Sequence[int]) -> list[Real[np.ndarray, " _"]]:
        """Return the columns with these indices, without an incomplete last row.

        A column of integers that fit into int64 is int64, any other column is float64.

        **Raises** `LogError` naming the line and column of a field that is not a number.
        """
        read = self.needed(indices)
        found = dict(zip(read, self.own_columns(read), strict=True))
        return [
            found[k] if k < self.own else self.computed[k - self.own].value(found) for k in indices
        ]

    def own_columns(self, indices: Sequence[int]) -> list[Real[np.ndarray, " _"]]:
        """Return columns of the file as `columns` does."""
        found = []
        for values in (self.arrays[k] for k in indices):
            floats = values.dtype.kind == "f" or values.max() > np.iinfo(np.int64).max
            found.append(values.astype(np.float64 if floats else np.int64, copy=False))
        return found

    def numeric(self) -> dict[int, Real[np.ndarray, " _"]]:
        """Return index → values of all columns that hold only numbers."""
        found = self.own_numeric()
        return found | {
            k: one.value(found)
            for k, one in enumerate(self.computed, self.own)
            if found.keys() >= {*one.of}
        }

    def own_numeric(self) -> dict[int, Real[np.ndarray, " _"]]:
        """Return index → values of the columns of the file that hold only numbers."""
        return dict(enumerate(self.own_columns(range(self.own))))

    def left_out(self, indices: Sequence[int]) -> tuple[str, ...]:
        """Return a note if the last row is incomplete in `indices`, and is not read."""
        return ()

    def texts(self, index: int) -> list[str]:
        """Return the fields of a column, those of a text as they are written.

        **Raises** `LogError` naming the line of a row without this field.
        """
        return [str(value) for value in self.arrays[index]]

    def starts_with_a_number(self, index: int) -> bool:
        """Return whether the first field of a column is a number."""
        return True

    def is_dated(self, index: int) -> bool:
        """Return whether the first field of a column is a date with time, or a time of day."""
        return False

    def first_way(self, index: int) -> str:
        """Return the first word of a column of words for directions, of both senses, or ""."""
        return self.ways.get(index, "")

    @property
    def line_of(self) -> Callable[[int], int] | None:
        """Function from row to its line number in the file, from 1; None without lines."""
        return None

    def close(self) -> None:
        """Free the memory of the columns, which cannot be read any more."""
        self.arrays = ()


class ClockedColumn(NamedTuple):
    """Channel with its values and time stamps in s; `time` is None without separate stamps."""

    name: str
    values: Real[np.ndarray, " n"]
    time: Float[np.ndarray, " n"] | None = None


def table_of(
    columns: Iterable[tuple[Any, ...]],
    notes: Sequence[str] = (),
    *,
    held: bool = False,
    start: float | None = None,
    ways: Mapping[int, str] | None = None,
) -> Table:
    """Return the table of all columns; channels with equal stamps share one column of time.

    A column is a `ClockedColumn`, or its name and values alone. Stamps are counted from `start`, by
    default from the earliest first stamp of all channels. `held` says that only changes of the
    channels are logged; `notes` and `ways` are those of the table.
    """
    found = [ClockedColumn(*one) for one in columns]
    if start is None:
        starts = [one.time[0] for one in found if one.time is not None and len(one.time)]
        start = min(starts, default=0.0)
    names: list[str] = []
    arrays: list[np.ndarray] = []
    clocks: dict[int, int] = {}
    stamps: list[int] = []
    for one in found:
        if one.time is not None:
            time = one.time - start
            clock = next((k for k in stamps if np.array_equal(arrays[k], time)), None)
            if clock is None:
                clock = len(names)
                stamps.append(clock)
                names.append(f"time {len(stamps)} [s]")
                arrays.append(time)
            clocks[len(names)] = clock
        names.append(printable(one.name))
        arrays.append(one.values)
    table = Table(tuple(names), tuple(arrays), clocks=clocks, notes=tuple(notes), ways=ways or {})
    table.held = frozenset(clocks) if held else frozenset()
    return table


def matrix_columns(name: str, array: np.ndarray) -> Iterator[tuple[str, Shaped[np.ndarray, " _"]]]:
    """Yield name and values of a vector, the rows of a wide matrix or the columns of a tall one.

    Names are in the notation of MATLAB: `x(1,:)` for the first row, `x(:,1)` for the first column.
    """
    array = array.squeeze()
    if array.ndim == 1 and array.size > 1:
        yield name, array
    if array.ndim != 2 or min(array.shape) > MOST_COLUMNS:
        return
    rows, columns = array.shape
    if rows < columns:
        yield from ((f"{name}({k + 1},:)", array[k]) for k in range(rows))
    elif columns < rows:
        yield from ((f"{name}(:,{k + 1})", array[:, k]) for k in range(columns))


def one_pass(table: Table, requested: Iterable[str | None]) -> Table:
    """Return a table of passes up and down side by side as one of one reading a row.

    The rows of a pass up are in the order of rising positions and those of a pass down in that of
    falling ones. Readings that do not follow the positions are errors. Rounds below one another, in
    which the positions repeat, are further passes.
    A table with a time, or of which one of these columns is `requested`, stays as it is.
    """
    # A mean of passes is no pass of its own: it has the sense 0.
    parts = {k for one in table.computed for k in one.of}
    senses = [
        {0.0} if k in parts or is_statistic(name) else ways_in(name)
        for k, name in enumerate(table.names)
    ]
    up, down = ([k for k, own in enumerate(senses) if own == {sign}] for sign in (1, -1))
    passes = [k for both in zip(up, down, strict=False) for k in both]
    names = [table.names[k] for k in passes]
    timed = has_time(table.names)
    if timed or not up or len(up) != len(down) or {*names} & {*requested}:
        return table
    values = table.numeric()
    kept = [k for k, own in enumerate(senses) if not own and k in values]
    rounds = max((_rounds(values[k]) for k in kept), default=1)
    size = len(next(iter(values.values()), ())) // rounds
    kept = [k for k in kept if rounds == 1 or _rounds(values[k]) == rounds]
    values = values | {k: values[k][:size] for k in kept}
    even = [k for k in kept if abs(np.sign(np.diff(values[k])).sum()) == len(values[k]) - 1 > 0]
    named = [name_and_unit(name, SHAFT_UNITS, table.source) for name in names]
    stems, units = zip(*named, strict=True)
    lacking = {*passes} - values.keys()
    if not even or len({*units}) > 1 or not all(map(table.starts_with_a_number, lacking)):
        return table
    if lacking:
        table.columns([*lacking])  # raises for a field without a number
    position = values[even[-1]]
    counted = [k for k in even[:-1] if np.all(np.abs(np.diff(values[k])) == 1)]  # `No.`
    kept = [k for k in kept if k not in counted]
    rising = np.argsort(position)
    order = np.concatenate([rising, rising[::-1]] * len(up) * rounds)
    each = [values[k][r * size : (r + 1) * size] for r in range(rounds) for k in passes]
    reading = np.stack(each)[np.arange(len(order)) // size, order]
    ways = np.tile(np.repeat([1, -1], size), len(up) * rounds)
    name = " ".join(word for word in words_of(stems[0]) if word not in WAYS) or "driven"
    # Most steps of angles are alike, also of those modulo a turn, and steps of errors are not.
    slope = np.diff(reading.reshape(-1, len(position))[::2]) / np.diff(position[rising])
    usual = np.median(slope)
    if np.mean(np.abs(slope - usual) < 0.2 * np.abs(usual)) < 0.5:
        name = "transmission_error"
    name += f" [{units[0]}]" * (units[0] is not None)
    said = ", ".join(f"`{name}`" for name in names)
    note = f"{said} are passes up and down side by side, read as one pass after the other"
    arrays = (*(values[k][order] for k in kept), reading, ways)
    columns, told = (*(table.names[k] for k in kept), name, "direction"), (*table.notes, note)
    return Table(
        columns, arrays, table.source, digest=table.digest, notes=told, ways={len(kept) + 1: "+"}
    )


def _rounds(column: Real[np.ndarray, " n"]) -> int:
    """Return how often the readings of a column come again, all in their order, or 1."""
    count = int(np.count_nonzero(column == column[:1]))
    size = len(column) // max(count, 1)
    whole = size > 2 and np.array_equal(column, np.tile(column[:size], count))
    return count if whole else 1


_PARTS = (("deg", "d"), ("arcmin", "min", "m"), ("arcsec", "s"))
"""Units at the ends of the names of the parts of an angle; those of time are read as parts too."""


def with_joined_angles(table: Table) -> Table:
    """Add a column for each angle of degrees, minutes and perhaps seconds side by side; return it.

    The names have one stem, or only the first one has it. Degrees are whole numbers, and so are
    minutes above seconds. A minus before one of the parts is that of the angle, also in `-0`.
    """
    endings = [stem_and_unit(name) for name in table.names]
    joined = []
    for k, (stem, unit) in enumerate(endings[:-1]):
        behind = zip(endings[k + 1 :], _PARTS[1:], strict=False)
        of = [k]
        for (other, own), units in behind:
            if own not in units or other not in (stem, ""):
                break
            of.append(k + len(of))
        if unit not in _PARTS[0] or len(of) < 2 or has_time([stem]):
            continue
        values = table.numeric()
        if not values.keys() >= {*of}:
            continue
        parts = [np.abs(values[i]) for i in of]
        whole = all(not np.any(part % 1 > 0) for part in parts[:-1])
        times = len(of) == 2 and np.all(np.diff(values[of[1]]) > 0)  # `deg,min` with a time in min
        if not whole or times or any(np.any(part > 60) for part in parts[1:]):
            continue
        signs = [[text.strip()[:1] in ("-", "−") for text in table.texts(i)] for i in of]
        value = partial(_angle, of, np.where(np.any(signs, axis=0), -1.0, 1.0))
        joined.append(Computed(f"{stem or 'angle'} [deg]", tuple(of), value))
    table.names = (*table.names, *(one.name for one in joined))
    table.computed = (*table.computed, *joined)
    parts = [", ".join(f"`{table.names[k]}`" for k in one.of) for one in joined]
    told = [f"`{one.name}` is the sum of {own}" for one, own in zip(joined, parts, strict=True)]
    table.notes = (*table.notes, *told)
    return table


def _angle(
    of: Sequence[int], signs: Real[np.ndarray, " n"], columns: "Columns"
) -> Real[np.ndarray, " n"]:
    """Return the angle in degrees of its parts in degrees, minutes and seconds."""
    size = sum(np.abs(columns[k]) / 60.0**place for place, k in enumerate(of))
    return signs[: len(columns[of[0]])] * size


_COUNTED = re.compile(r"quadrature\(\s*([^,]+?)\s*,\s*([^,]+?)\s*\)(?:\s*\[counts\])?")
_NUMBER = r"(?<![\w.#])(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?(?![\w.])"
_OPERATIONS = {ast.Add: np.add, ast.Sub: np.subtract, ast.Mult: np.multiply}
_LOW, _HIGH = 1 / 3, 2 / 3
"""A level falls below the first fraction of its range and rises above the second one (chosen)."""

Columns = Mapping[int, Real[np.ndarray, " n"]]


@dataclass(frozen=True)
class Computed:
    """Column `name` that `value` computes from the columns `of` of a table, in their `unit`."""

    name: str
    of: tuple[int, ...]
    value: Callable[[Columns], Real[np.ndarray, " n"]]
    unit: str | None = None


def with_computed(table: Table, requested: Iterable[str | None]) -> Table:
    """Add a column to a table for each requested name that says how it is computed; return it.

    A name that a column has is that column.

    **Raises** `LogError` for a column that does not exist, a formula that cannot be read, and
    channels whose levels do not count.
    """
    computed, notes = [*table.computed], []
    for name in dict.fromkeys(one for one in requested if one and one not in table.names):
        counted = _COUNTED.fullmatch(name)
        if counted:
            one, note = _counts(table, counted[1], counted[2])
            notes.append(note)
        elif re.search(r"[-+*]", name):
            try:  # a name such as `motor-pos` may mean a column of the table
                index_of(name, "driving", table.names, "")
                continue
            except LogError:
                one = _formula(name, table)
        else:
            continue
        computed.append(one)
    clocks = dict(table.clocks)
    for k, one in enumerate(computed, table.own):
        stamps = {table.clocks.get(index) for index in one.of}
        if len(stamps) > 1:
            raise LogError(
                "its columns have time stamps of their own; export them at common times.",
                where=f"{table.source}: `{one.name}`",
            )
        clocks.update((k, stamp) for stamp in stamps if stamp is not None)
    table.names = (*table.names[: table.own], *(one.name for one in computed))
    table.computed, table.clocks = tuple(computed), clocks
    table.notes = (*table.notes, *notes)
    return table


def _formula(text: str, table: Table) -> Computed:
    """Return the column of a formula; the longest name of a column at a place is meant.

    **Raises** `LogError` for a text that is no formula, for a column that does not exist, and for
    columns in different units.
    """
    longest = sorted(map(re.escape, table.names), key=len, reverse=True)
    token = re.compile(f"({_NUMBER})|({'|'.join(longest)})(?![\\w.])|[^\\s+*()-]+")
    used: list[int] = []

    def spelt(match: re.Match[str]) -> str:
        """Return a number as it is, and `c3` for the column with index 3."""
        if match[1]:
            return match[1]
        used.append(index_of(match[0], "driving", table.names, table.source))
        return f"c{used[-1]}"

    try:
        tree = ast.parse(token.sub(spelt, text[:1000]), mode="eval").body
        _ = _value(tree, dict.fromkeys(used, np.zeros(1)))
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        raise LogError(
            "this is no formula; write names or numbers (#3) of columns, and numbers, with +, -, *"
            " and brackets, such as 0.5*(m1+m2).",
            where=f"{table.source}: `{text}`",
        ) from None
    of = tuple(dict.fromkeys(used))
    units = {name_and_unit(table.names[k], SHAFT_UNITS, text)[1] for k in of}
    if len(units) > 1 and units <= {None, *SHAFT_UNITS}:
        said = ", ".join(f"`{table.names[k]}`" for k in of)
        raise LogError(
            f"its columns {said} have different units; convert them by factors of the formula, and"
            " rename them.",
            where=f"{table.source}: `{text}`",
        )
    unit = units.pop() if len(units) == 1 else None
    return Computed(text, of, partial(_value, tree), unit if unit in SHAFT_UNITS else None)


def _value(node: ast.AST, columns: Columns) -> Real[np.ndarray, " n"]:
    """Return the value of a part of a formula; raise `SyntaxError` for what is none."""
    match node:
        case ast.Constant(value=int() | float() as number):
            return np.asarray(number)
        case ast.Name(id=name):
            return columns[int(name[1:])]
        case ast.UnaryOp(op=ast.USub() | ast.UAdd() as sign, operand=operand):
            value = _value(operand, columns)
            return -value if isinstance(sign, ast.USub) else value
        case ast.BinOp(left=left, op=op, right=right) if type(op) in _OPERATIONS:
            return _OPERATIONS[type(op)](_value(left, columns), _value(right, columns))
    raise SyntaxError


def _counts(table: Table, first: str, second: str) -> tuple[Computed, str]:
    """Return the column with the counts of two channels, and a note on how they are counted."""
    indices = [index_of(one, "driving", table.names, table.source) for one in (first, second)]
    pair = [table.names[k] for k in indices]
    columns = [table.columns([k])[0] for k in indices]
    a, b = map(_levels, columns, [f"{table.source}: column `{name}`" for name in pair])
    edges = [int(np.count_nonzero(np.diff(one))) for one in (a, b)]
    steps, name = edges[0] > 2 * edges[1], f"quadrature({first},{second})"
    if steps:  # +1 for each rising edge of STEP where DIR is high, and −1 elsewhere
        counts = np.concatenate([[0], np.cumsum(np.where(np.diff(a) > 0, 2 * b[1:] - 1, 0))])
    else:  # +1 for each edge where A leads; the order of the states is 00, 10, 11, 01
        moves = np.diff((a ^ b) + 2 * b) % 4
        lost = np.flatnonzero(moves == 2)
        if lost.size:
            raise LogError(
                f"both levels change at once {lost.size} times, first at sample {lost[0] + 1}, so"
                " that counts are lost; sample at least eight times a period.",
                where=f"{table.source}: `{name}`",
            )
        counts = np.concatenate([[0], np.cumsum(np.where(moves == 3, -1, moves))])
    # Logic analysers export a row for each change of a level; their time is what always rises.
    dated = filter(table.is_dated, range(table.own))
    stamps = [read_stamps(table.texts(k)[: len(a)], lambda _: table.source)[0] for k in dated]
    others = [*table.own_numeric().values(), *stamps]
    times = [one for one in others if np.all(one[1:] > one[:-1])]
    changes = [one[1:] != one[:-1] for one in others if set(one.tolist()) <= {0, 1}]
    own = np.flatnonzero(np.diff(counts)) + 1
    edges = len(own) if steps else sum(edges)
    if len(times) == 1 and np.all(np.any(changes, axis=0)):
        time = times[0]  # the shaft stands between two counts at its own edges
        ends = {"left": counts[0], "right": counts[-1]}
        counts = np.interp(time, time[own], 0.5 * (counts[own - 1] + counts[own]), **ends)
    how = f"the rising edges of `{pair[0]}` in the direction of `{pair[1]}`"
    four = f"the edges of `{pair[0]}` and `{pair[1]}`, four a period"
    note = f"{name} counts {how if steps else four}: {edges} edges"

    def value(columns: Columns) -> Real[np.ndarray, " n"]:
        return counts[: len(columns[indices[0]])]  # an incomplete last row may be left out

    return Computed(f"{name} [counts]", tuple(indices), value, "counts"), note


def _levels(values: Real[np.ndarray, " n"], where: str) -> Int64[np.ndarray, " n"]:
    """Return the level of each sample, 0 or 1.

    A level changes where it passes the middle for the last time before it reaches the other
    threshold: so an edge is at one place in both directions, also of sines. An infinite value is
    beyond the range of the instrument, so that it has the level of its sign.
    """
    known = values[np.isfinite(values)].astype(np.float64)
    low, span = float(known.min(initial=np.inf)), float(np.ptp(known)) if known.size else 0.0
    if not 0 < span < np.inf:
        raise LogError(
            "the level of this channel never changes; name the channels A and B, or STEP and DIR.",
            where=where,
        )
    share = (values - low) / span
    clear = (share < _LOW) | (share > _HIGH)
    place = np.arange(len(values))
    level = share[np.maximum.accumulate(np.where(clear, place, 0))] > _HIGH
    passed = np.maximum.accumulate(np.where(np.diff(share > 0.5, prepend=False), place, 0))
    begins = np.zeros(len(values), int)
    reached = np.flatnonzero(np.diff(level)) + 1
    begins[passed[reached]] = reached
    return level[np.maximum.accumulate(begins)].astype(np.int64)
