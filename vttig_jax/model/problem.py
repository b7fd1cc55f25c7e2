"""Compressed logs: rows of all logs and flanks as one `Compressed`, in scaled coefficients."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from .columns import FLAT, GROUPS, KNOWN, Column, embedding
from .density import FIRST, LAGS, Compressed
from .rows import Name, Rows
from .windows import windows

_RUNG = 32


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
    def index(self) -> dict[Name, int]:
        """Place of every column by its name."""
        return {column.name: place for place, column in enumerate(self.columns)}


def problem_of(
    columns: tuple[Column, ...],
    logs: Sequence[Rows],
    weights: Sequence[Float[np.ndarray, " n"]] | None,
    *,
    centres: Mapping[Name, float],
    usual: Mapping[str, float],
) -> Problem:
    """Compress the rows of all logs.

    **Arguments**
    - `weights`: weight of every row of each log, for logs with outliers.
    - `centres`: value at which a column is linearised; its prior is centred at zero.
    - `usual`: usual width τ of every group, in the unit of its coefficients.

    The parts of the delay and the bends of the gap are made orthogonal to their fixed part, which
    so stays the mean of the log.
    """
    parts = [
        (number, side, table, embedding(columns, rows.names, number, side))
        for number, rows in enumerate(logs)
        for side, table in _sides(rows, None if weights is None else weights[number])
    ]
    gram = sum(link.T @ (table[0].T @ table[0]) @ link for _, _, table, link in parts)
    assert not isinstance(gram, int)
    place = {column.name: k for k, column in enumerate(columns)}
    size = len(columns)
    natural = np.eye(size)
    for kind, onto in (("part", [("delay",)]), ("bend", [("gap",), ("delay",)])):
        fixed = [place[name] for name in onto if name in place]
        moving = [k for name, k in place.items() if name[0] == kind]
        if moving and fixed:
            block = gram[np.ix_(fixed, fixed)]
            share = np.linalg.lstsq(block, gram[np.ix_(fixed, moving)], rcond=1e-9)[0]
            natural[np.ix_(fixed, moving)] -= share
    gram[:size, :size] = natural.T @ gram[:size, :size] @ natural
    gram[:size, -1] = natural.T @ gram[:size, -1]
    norm = np.sqrt(np.maximum(np.diag(gram)[:size], 0.0))
    dead = norm <= 1e-9 * norm.max()
    norm[dead] = 1.0
    natural = natural / norm
    # Random coefficients stay centred at zero: their prior may be so narrow that no digit is left.
    steady = np.array([c.prior in (FLAT, KNOWN) for c in columns]) & ~dead
    few = np.ix_(steady, steady)
    scaled = gram[:size, :size] / norm / norm[:, None]
    ridge = scaled[few] + 1e-6 * np.eye(steady.sum())
    start, total = np.zeros(size), sum(len(table[0]) for *_, table, _ in parts)
    for _ in range(2):
        left = np.zeros(size)
        for _, _, (table, *_), link in parts:
            residual = table @ (link @ np.append(-(natural @ start), 1.0))
            left += natural.T @ (link[:, :-1].T @ (table.T @ residual))
        start[steady] += np.linalg.solve(ridge, left[steady])
    whole = np.zeros((len(FIRST), size + 1, size + 1))
    square = 0.0
    for _, _, (table, first, last), link in parts:
        centred = table.copy()
        centred[:, -1] = table @ (link @ np.append(-(natural @ start), 1.0))
        square += float(centred[:, -1] @ centred[:, -1])
        link = link.copy()
        link[:, :-1] = link[:, :-1] @ natural
        whole += link.T @ windows(centred, first, last) @ link
    unit = max(np.sqrt(square / total), 1e-15)
    whole[:, :, -1] /= unit
    whole[:, -1, :] /= unit
    width = np.array([c.width for c in columns]) * norm
    group = np.array([c.prior for c in columns])
    known = (group == KNOWN) & ~dead
    member = np.stack([(group == g) & ~dead for g in GROUPS], axis=1) / width[:, None] ** 2
    precision = np.where(known, (unit / width) ** 2, 0.0)
    shift = np.array([centres.get(c.name, 0.0) for c in columns])
    compressed = Compressed(
        windows=whole,
        rows=float(total) if weights is None else float(sum(np.sum(w) for w in weights)),
        runs=float(sum(len(first) for *_, (_, first, _), _ in parts)),
        member=member,
        precision=np.where(dead, 1.0, precision),
        centre=(np.where(dead, 0.0, start + shift * norm)) / unit,
        usual=np.array([usual[g] for g in GROUPS]) / unit,
        on=(member > 0).any(axis=0).astype(float),
        constant=float(2 * np.sum(np.log(width[np.isin(group, GROUPS) & ~dead]))),
    )
    return Problem(columns, padded(compressed), natural, start, unit)


def _sides(rows: Rows, weight: Float[np.ndarray, " n"] | None):
    """Yield each flank with its rows and the ends of its runs."""
    table = rows.table if weight is None else bridged(rows, weight)
    for side in (1, -1):
        runs = rows.side == side
        if runs.any():
            pieces = [
                np.arange(a, b + 1) for a, b in zip(rows.first[runs], rows.last[runs], strict=True)
            ]
            length = np.array([len(piece) for piece in pieces])
            last = np.cumsum(length) - 1
            yield side, (table[np.concatenate(pieces)], last - length + 1, last)


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


def padded(logs: Compressed) -> Compressed:
    """Return the same density with neutral columns, so that few shapes are compiled."""
    size = len(logs.precision)
    more = -(size + 1) % _RUNG
    windows = np.asarray(logs.windows)
    place = np.append(np.arange(size), size + more)
    wide = np.zeros((len(windows), size + more + 1, size + more + 1))
    wide[:, place[:, None], place] = windows
    pad = lambda values, value: np.append(values, np.full(more, value))  # noqa: E731
    return Compressed(
        windows=jnp.asarray(wide),
        rows=jnp.asarray(logs.rows),
        runs=jnp.asarray(logs.runs),
        member=jnp.asarray(np.vstack([logs.member, np.zeros((more, len(GROUPS)))])),
        precision=jnp.asarray(pad(logs.precision, 1.0)),
        centre=jnp.asarray(pad(logs.centre, 0.0)),
        usual=jnp.asarray(logs.usual),
        on=jnp.asarray(logs.on),
        constant=jnp.asarray(logs.constant),
    )


def first_theta(logs: Compressed) -> Float[np.ndarray, " p"]:
    """Return where the search starts: correlated noise, large orders and small moving parts."""
    usual = np.log(np.asarray(logs.usual)) - np.array([0.0, 0.0, 2.0, 2.0, 2.0, 2.0])
    return np.concatenate([[1.0], np.zeros(LAGS - 1), [-0.5], usual])
