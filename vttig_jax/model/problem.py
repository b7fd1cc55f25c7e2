"""Compressed logs: rows of all logs and flanks as one `Compressed`, in scaled coefficients."""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import jax
import numpy as np
from jaxtyping import Float, Int

from .columns import DELAY, GAP, GROUPS, KNOWN, ROUNDING, Column, ColumnName, embedding
from .density import FIRST, LAGS, MEMORY, SECOND, Compressed
from .rows import RowName, Rows, S

_RUNG = 16


@dataclass(frozen=True, eq=False)
class Problem:
    """Compressed logs, and the way back from scaled coefficients to those of the columns.

    The coefficients of the columns are b = `natural` @ (`unit` β + `start`), where β are those of
    `compressed` without its padding.
    """

    columns: tuple[Column, ...]
    compressed: Compressed
    natural: Float[np.ndarray, "columns columns"]
    start: Float[np.ndarray, " columns"]
    unit: float

    @property
    def index(self) -> dict[ColumnName, int]:
        """Place of every column by its name, see `index_of`."""
        return index_of(self.columns)

    def of(
        self,
        columns: tuple[Column, ...],
        logs: Sequence[Rows],
        weights: Sequence[Float[np.ndarray, " n"]] | None,
        delay_s: float,
    ) -> "Problem":
        """Return the problem of other columns or rows with the priors of this one."""
        widths = (np.asarray(self.compressed.usual) * self.unit).tolist()
        usual: dict[str, float] = dict(zip(GROUPS, widths, strict=True))
        memory, centres = np.asarray(self.compressed.memory), {DELAY: delay_s}
        return problem_of(columns, logs, weights, centres=centres, usual=usual, memory=memory)


def index_of(columns: Sequence[Column]) -> dict[ColumnName, int]:
    """Return the place of every column by its name; rounding stands behind that of its name."""
    found: dict[ColumnName, int] = {}
    for place, column in enumerate(columns):
        found.setdefault(column.name, place)
    return found


def problem_of(
    columns: tuple[Column, ...],
    logs: Sequence[Rows],
    weights: Sequence[Float[np.ndarray, " n"]] | None,
    *,
    centres: Mapping[ColumnName, float],
    usual: Mapping[str, float],
    noise: Float[np.ndarray, " taps"] | None = None,
    memory: Float[np.ndarray, " lags"] = MEMORY,
) -> Problem:
    """Compress the rows of all logs.

    **Arguments**
    - `weights`: weight of every row of each log, for logs with outliers.
    - `centres`: value at which a column is linearised; its prior is centred at zero.
    - `usual`: usual width τ of every group, in the unit of its coefficients.
    - `noise`: autocovariance of the rows at 0 … `LAGS` lags, rad², of a noise that the readings do
      not contain. Its expected products are added: a planned log.

    - `memory`: prior widths of atanh π_k.

    The parts of the delay and the bends of the gap are made orthogonal to their fixed part, which
    so stays the mean of the log. Neutral columns are added, so that few shapes are compiled.
    """
    sides = list(sides_of(columns, logs, weights))
    place, size = index_of(columns), len(columns)
    gram = products_of(sides)
    natural = np.eye(size)
    moves: list[tuple[list[int], list[int], np.ndarray]] = []
    for group, onto in (("delay_parts", [DELAY]), ("gap_by_speed", [GAP, DELAY])):
        fixed = [place[name] for name in onto if name in place]
        moving = [k for k, column in enumerate(columns) if column.prior == group]
        if moving and fixed:
            block = gram[np.ix_(fixed, fixed)]
            share = np.linalg.lstsq(block, gram[np.ix_(fixed, moving)], rcond=1e-9)[0]
            natural[np.ix_(fixed, moving)] -= share
            moves.append((fixed, moving, share))
    gram[:size, :size] = natural.T @ gram[:size, :size] @ natural
    gram[:size, -1] = natural.T @ gram[:size, -1]
    norm = np.sqrt(np.maximum(np.diag(gram)[:size], 0.0))
    dead = norm <= 1e-9 * norm.max()
    norm[dead] = 1.0
    natural = natural / norm
    # Random coefficients stay centred at zero: their prior may be so narrow that no digit is left.
    steady = np.array([c.prior not in GROUPS for c in columns]) & ~dead
    scaled, right = gram[:size, :size] / norm / norm[:, None], gram[:size, -1] / norm
    ridge = scaled[np.ix_(steady, steady)] + 1e-6 * np.eye(steady.sum())
    start = np.zeros(size)
    for _ in range(2):
        start[steady] += np.linalg.solve(ridge, (right - scaled @ start)[steady])
    wide = size + 1 + -(size + 1) % _RUNG
    kept = np.append(np.arange(size), wide - 1)
    whole = np.zeros((len(FIRST), wide, wide))
    square = 0.0
    for side in sides:
        away = side.link @ np.append(-(natural @ start), 1.0)
        found = windows(side.table, side.first, side.last, away)
        square += float(found[0, -1, -1])
        source, gain = np.zeros(wide, int), np.zeros(wide)  # a column of the link has one element
        source[kept], gain[kept] = np.abs(side.link).argmax(axis=0), side.link.sum(axis=0)
        elements = source[:, None] * len(away) + source
        gain = gain[:, None] * gain
        for pair, product in zip(whole, found, strict=True):
            pair += gain * product.take(elements)
        if noise is not None:
            counts = (side.last - side.first + 1)[:, None] - FIRST - SECOND
            expected = counts.sum(0) * noise[SECOND - FIRST] * np.where(FIRST < SECOND, 2.0, 1.0)
            whole[:, -1, -1] += expected
            square += float(expected[0])
    for fixed, moving, share in moves:
        whole[:, :, moving] -= whole[:, :, fixed] @ share
        whole[:, moving] -= share.T @ whole[:, fixed]
    scale = np.ones(wide)
    scale[:size] = 1 / norm
    whole *= scale[:, None] * scale
    whole = 0.5 * (whole + whole.transpose(0, 2, 1))  # a fit read from its folder is the same
    total = sum(len(one.table) for one in logs)
    unit = max(np.sqrt(square / total), 1e-15)
    whole[:, :, -1] /= unit
    whole[:, -1, :] /= unit
    width = np.array([c.width for c in columns]) * norm
    group = np.array([c.prior for c in columns])
    known = np.isin(group, (KNOWN, ROUNDING)) & ~dead
    member = np.zeros((wide - 1, len(GROUPS)))
    member[:size] = np.stack([(group == g) & ~dead for g in GROUPS], 1) / width[:, None] ** 2
    precision, centre = np.ones(wide - 1), np.zeros(wide - 1)
    precision[:size] = np.where(known, (unit / width) ** 2, dead)
    shift = np.array([centres.get(c.name, 0.0) for c in columns])
    centre[:size] = np.where(dead, 0.0, start + shift * norm) / unit
    compressed = Compressed(
        windows=jax.device_put(whole),  # the only large part: each search would copy it
        rows=np.asarray(float(total if weights is None else sum(np.sum(w) for w in weights))),
        runs=np.asarray(float(sum(len(side.first) for side in sides))),
        member=member,
        precision=precision,
        centre=centre,
        usual=np.array([usual[g] for g in GROUPS]) / unit,
        on=(member > 0).any(axis=0).astype(float),
        constant=np.asarray(2 * np.sum(np.log(width[np.isin(group, GROUPS) & ~dead]))),
        memory=memory,
    )
    return Problem(columns, compressed, natural, start, unit)


def cleared(problem: Problem, orders: Collection[RowName], width: float) -> Problem:
    """Return compressed logs in which orders have this prior width of their own.

    Differences between the flanks keep the width that they share.
    """
    logs, columns = problem.compressed, list(problem.columns)
    precision = np.zeros(len(logs.precision))
    for place, column in enumerate(columns):
        if column.row in orders and column.prior in GROUPS and not column.differs:
            columns[place] = replace(column, prior=KNOWN, width=width)
            share = (problem.unit * column.width / width) ** 2
            precision[place] = share * np.sum(logs.member[place])
    return replace(problem, columns=tuple(columns), compressed=with_known(logs, precision))


def with_known(logs: Compressed, precision: Float[np.ndarray, " columns"]) -> Compressed:
    """Return compressed logs in which some columns leave their groups for a known precision.

    A precision of 0 leaves a column as it is.
    """
    own = precision > 0
    member = np.where(own[:, None], 0.0, logs.member)
    gone = np.sum(logs.member, axis=1)[own]
    return replace(
        logs,
        member=member,
        precision=np.where(own, precision, logs.precision),
        on=(member > 0).any(axis=0).astype(float),
        constant=np.asarray(logs.constant + np.sum(np.log(gone))),
    )


@dataclass(frozen=True, eq=False)
class Side:
    """Rows of a log on one flank: runs `first` to `last` of its table, whose columns `link` takes
    to those of the model and y."""

    table: Float[np.ndarray, "n names"]
    first: Int[np.ndarray, " runs"]
    last: Int[np.ndarray, " runs"]
    link: Float[np.ndarray, "names q"]


def sides_of(
    columns: Sequence[Column],
    logs: Sequence[Rows],
    weights: Sequence[Float[np.ndarray, " n"]] | None = None,
) -> Iterator[Side]:
    """Yield the rows of every log on each of its flanks, where outliers are bridged."""
    for number, rows in enumerate(logs):
        table = rows.table if weights is None else bridged(rows, weights[number])
        for flank in S:
            if (runs := np.array(rows.flanks) == flank).any():
                link = embedding(columns, rows.names, number, flank)
                yield Side(table, rows.first[runs], rows.last[runs], link)


def products_of(sides: Sequence[Side]) -> Float[np.ndarray, "q q"]:
    """Return Σ [X | y]ᵀ [X | y] over all rows."""
    gram = np.zeros((sides[0].link.shape[1],) * 2)
    for side in sides:
        # Views of the runs, so that the table is in memory once.
        runs = (side.table[a : b + 1] for a, b in zip(side.first, side.last, strict=True))
        gram += side.link.T @ sum((run.T @ run for run in runs), np.zeros(())) @ side.link
    return gram


def windows(
    table: Float[np.ndarray, "n q"],
    first: Int[np.ndarray, " runs"],
    last: Int[np.ndarray, " runs"],
    away: Float[np.ndarray, " q"],
) -> Float[np.ndarray, "pairs q q"]:
    """Return D_ij = Σ_runs Σ_k z_{k+i} z_{k+j}ᵀ, where k leaves out the first and last i rows.

    For i < j the transpose is added. The runs are the rows `first` to `last`, both included; each
    has more than `LAGS` rows. In z the last column is `table` @ `away`. D_{i+1,j+1} follows from
    D_ij by the rows at the ends of the runs.
    """
    end = np.cumsum(last - first + 1 + LAGS) - LAGS
    begin = end - (last - first + 1)
    apart = np.zeros((end[-1] + LAGS, table.shape[1]))  # zeros between runs: no product joins two
    for a, b, to in zip(first, last, begin, strict=True):
        apart[to : to + b - a + 1] = table[a : b + 1]
    apart[:, -1] = apart @ away
    ends = [apart[np.concatenate([begin + lag, end - 1 - lag])] for lag in range(LAGS)]
    pairs = zip(FIRST.tolist(), SECOND.tolist(), strict=True)
    where = {pair: place for place, pair in enumerate(pairs)}
    found = np.empty((len(FIRST), len(away), len(away)))
    for lag in range(LAGS + 1):
        product = apart[: len(apart) - lag].T @ apart[lag:]
        if lag:
            product = product + product.T
        found[where[0, lag]] = product
        for step in range(LAGS - lag):
            outer = ends[step].T @ ends[step + lag]
            product = product - (outer + outer.T if lag else outer)
            found[where[step + 1, step + 1 + lag]] = product
    return found


def bridged(rows: Rows, weight: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n q"]:
    """Return the rows, where outliers are bridged between the good rows around them.

    All columns of such a row, y too, are interpolated alike, so that it says nothing beyond its
    neighbours; a weight of zero would say that its noise is zero. A row whose probability to be
    good is between 0 and 1 is moved in part.
    """
    table = rows.table.copy()
    good = np.flatnonzero(weight > 0.5)
    moved = np.flatnonzero(weight < 0.99)
    for first, last in zip(rows.first, rows.last, strict=True):
        own = good[(good >= first) & (good <= last)]
        for row in moved[(moved >= first) & (moved <= last)]:
            at = np.searchsorted(own, row)
            before, after = own[:at], own[at + (at < len(own) and own[at] == row) :]
            ends = [k for part, k in ((before, -1), (after, 0)) if len(part) for k in [part[k]]]
            if ends:
                share = 0.5 if len(ends) < 2 else (row - ends[0]) / (ends[1] - ends[0])
                bridge = (1 - share) * rows.table[ends[0]] + share * rows.table[ends[-1]]
                table[row] = weight[row] * rows.table[row] + (1 - weight[row]) * bridge
    return table
