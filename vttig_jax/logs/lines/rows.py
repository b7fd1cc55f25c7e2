"""Rows of a line search: uninterrupted stretches of one or several logs, stacked and thinned."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Float
from scipy.linalg import block_diag

from ...base.numerics.counting import whole_below
from ...base.units import REV

MOST_ROWS = 10_000
"""Longer logs are searched in block means."""

_ROWS_PER_CYCLE = 4.0
"""Fewest rows that a cycle of the highest frequency keeps when rows are averaged."""


@dataclass(frozen=True)
class Stretch:
    """One uninterrupted stretch: neighbouring rows are neighbours in time.

    **Arguments**
    - `angle`: of the driving shaft, rad, shape (n,); one zero for all runs. Anything else that
      cycles may be counted in works as well: 2π t/s gives lines in cycles per second.
    - `value`: rad, shape (n,).
    - `nuisance`: regressors that a line must stand out from, shape (n, p); at least a constant.
    - `group`: runs of one group (a flank, a log) share the coefficients of their regressors.
    """

    angle: Float[np.ndarray, " n"]
    value: Float[np.ndarray, " n"]
    nuisance: Float[np.ndarray, "n p"]
    group: str = ""

    def __post_init__(self):
        rows = {len(self.angle), len(self.value), len(self.nuisance)}
        if len(rows) != 1 or self.nuisance.ndim != 2 or self.nuisance.shape[1] == 0:
            raise ValueError(
                "Argument `nuisance` must have a row for every angle and value and at least one"
                f" column, but the shapes are {self.angle.shape}, {self.value.shape} and"
                f" {self.nuisance.shape}."
            )
        for name in ("angle", "value", "nuisance"):
            if not np.isfinite(getattr(self, name)).all():
                raise ValueError(
                    f"Argument `{name}` must be finite in every row, but is not: leave those rows"
                    " out and split the run there."
                )


@dataclass(frozen=True)
class Rows:
    """All runs below one another.

    **Arguments**
    - `turns`: driving revolutions, shape (n,), and their mean `origin` already taken off.
    - `width`: revolutions that a row is the mean over, shape (n,).
    - `value`: rad, shape (n,). `nuisance`: columns of every group, zero outside it, shape (n, q).
    - `starts`: first row of every run, and n.
    """

    turns: Float[np.ndarray, " n"]
    origin: float
    width: Float[np.ndarray, " n"]
    value: Float[np.ndarray, " n"]
    nuisance: Float[np.ndarray, "n q"]
    starts: tuple[int, ...]

    @property
    def runs(self) -> list[slice]:
        """Rows of every run."""
        return [slice(first, stop) for first, stop in pairwise(self.starts)]

    @property
    def span(self) -> float:
        """Revolutions between the lowest and the highest angle."""
        return float(np.ptp(self.turns))


def stack(runs: Sequence[Stretch], highest: float) -> Rows:
    """Rows of all runs, thinned by block means where there are more than `MOST_ROWS`.

    **Raises** `ValueError` where runs of one group differ in their columns, or where a cycle of
    `highest` has fewer than two rows: its alias would pass for it.
    """
    if not runs:
        raise ValueError("Argument `runs` must hold at least one run, but is empty.")
    step = _typical_step(runs)
    if step * highest > 0.5:
        raise ValueError(
            f"Argument `highest` must be at most {0.5 / step:.4g} cycles per revolution, but is"
            f" {highest:.4g}: the rows are {step:.3g} revolutions apart."
        )
    block = -(-sum(len(run.value) for run in runs) // MOST_ROWS)
    if block > 1 and step > 0:
        block = max(min(block, whole_below(1 / (_ROWS_PER_CYCLE * highest * step))), 1)
    groups: dict[str, list[Stretch]] = {}
    for run in runs:
        groups.setdefault(run.group, []).append(run)
    for name, own in groups.items():
        if len({run.nuisance.shape[1] for run in own}) != 1:
            raise ValueError(
                "Argument `nuisance` must have the same columns in all runs of a group, but group"
                f" {name!r} has {sorted({run.nuisance.shape[1] for run in own})}."
            )
    ordered = [_thinned(run, block) for own in groups.values() for run in own]
    turns = np.concatenate([run.angle for run in ordered]) / REV
    origin = float(turns.mean()) if len(turns) else 0.0
    return Rows(
        turns - origin,
        origin,
        np.concatenate([_width(run.angle / REV, block) for run in ordered]),
        np.concatenate([run.value for run in ordered]),
        np.asarray(
            block_diag(
                *[
                    np.concatenate([run.nuisance for run in ordered if run.group == name])
                    for name in groups
                ]
            )
        ),
        (0, *np.cumsum([len(run.value) for run in ordered]).tolist()),
    )


def _typical_step(runs: Sequence[Stretch]) -> float:
    """Revolutions from row to row where the shaft moves: the median weighed by the way."""
    steps = np.sort(np.concatenate([np.abs(np.diff(run.angle)) for run in runs])) / REV
    way = np.cumsum(steps)
    return float(steps[np.searchsorted(way, 0.5 * way[-1])]) if len(steps) and way[-1] else 0.0


def _thinned(run: Stretch, block: int) -> Stretch:
    if block == 1:
        return run
    kept = len(run.value) // block
    angle, value = (
        part[: kept * block].reshape(kept, block).mean(axis=1) for part in (run.angle, run.value)
    )
    columns = run.nuisance[: kept * block].reshape(kept, block, -1).mean(axis=1)
    return Stretch(angle, value, columns, run.group)


def _width(turns: Float[np.ndarray, " n"], block: int) -> Float[np.ndarray, " n"]:
    """Revolutions that a block mean was taken over; single samples have no width."""
    if block == 1 or len(turns) < 2:
        return np.zeros_like(turns)
    return np.abs(np.gradient(turns))
