"""Rows of a line search: stretches of one or several logs, stacked and averaged."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Float
from scipy.linalg import block_diag

from ...base.numerics.counting import whole_below
from ...base.units import REV

MOST_ROWS = 10_000
"""Largest number of rows; the rows of longer logs are block means (chosen)."""

_ROWS_PER_CYCLE = 4.0
"""Least number of block means per cycle of the highest frequency (chosen)."""


@dataclass(frozen=True)
class Stretch:
    """Uninterrupted stretch of a log, with its rows in time order.

    **Arguments**
    - `angle`: driving angle in rad, shape (n,), with the same zero for all runs. It may be another
      variable: 2π t/s gives lines in cycles per second.
    - `value`: transmission error or residual in rad, shape (n,).
    - `nuisance`: regressors that are fitted with every line, shape (n, p); at least a constant.
    - `group`: name of a group (a flank, a log); its runs share the coefficients of the regressors.
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
                    f"Argument `{name}` must be finite in every row, but it is not; remove these"
                    " rows and split the run there."
                )


@dataclass(frozen=True)
class Rows:
    """Rows of all runs in one stack.

    **Arguments**
    - `turns`: driving revolutions minus their mean `origin`, shape (n,).
    - `width`: revolutions over which each row is averaged, shape (n,).
    - `value`: rad, shape (n,). `nuisance`: columns of every group, zero outside it, shape (n, q).
    - `starts`: first row of every run, and n at the end.
    """

    turns: Float[np.ndarray, " n"]
    origin: float
    width: Float[np.ndarray, " n"]
    value: Float[np.ndarray, " n"]
    nuisance: Float[np.ndarray, "n q"]
    starts: tuple[int, ...]

    @property
    def runs(self) -> list[slice]:
        """Slice of the rows of every run."""
        return [slice(first, stop) for first, stop in pairwise(self.starts)]

    @property
    def span(self) -> float:
        """Revolutions between the lowest and the highest angle."""
        return float(np.ptp(self.turns))


def stack(runs: Sequence[Stretch], highest: float) -> Rows:
    """Stack the rows of all runs; more than `MOST_ROWS` rows are averaged in blocks.

    **Raises** `ValueError` if runs of one group differ in their columns, or if a cycle of `highest`
    has fewer than two rows, because its alias would look the same.
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
    for name, members in groups.items():
        if len({run.nuisance.shape[1] for run in members}) != 1:
            raise ValueError(
                "Argument `nuisance` must have the same columns in all runs of a group, but group"
                f" {name!r} has {sorted({run.nuisance.shape[1] for run in members})}."
            )
    ordered = [_block_means(run, block) for members in groups.values() for run in members]
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
    """Return the median of the revolutions from row to row, weighted by travel."""
    steps = np.sort(np.concatenate([np.abs(np.diff(run.angle)) for run in runs])) / REV
    path = np.cumsum(steps)
    return float(steps[np.searchsorted(path, 0.5 * path[-1])]) if len(steps) and path[-1] else 0.0


def _block_means(run: Stretch, block: int) -> Stretch:
    if block == 1:
        return run
    count = len(run.value) // block
    angle, value = (
        part[: count * block].reshape(count, block).mean(axis=1) for part in (run.angle, run.value)
    )
    columns = run.nuisance[: count * block].reshape(count, block, -1).mean(axis=1)
    return Stretch(angle, value, columns, run.group)


def _width(turns: Float[np.ndarray, " n"], block: int) -> Float[np.ndarray, " n"]:
    """Return the revolutions over which each row is averaged; single samples have width 0."""
    if block == 1 or len(turns) < 2:
        return np.zeros_like(turns)
    return np.abs(np.gradient(turns))
