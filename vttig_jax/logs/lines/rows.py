"""Rows of a line search: stretches of one or several logs, averaged in blocks and stacked."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import groupby, pairwise
from operator import attrgetter

import numpy as np
from jaxtyping import Float

from ...base.numerics.counting import whole_below
from ...base.units import REV

_ROWS_PER_CYCLE = 6.0
"""Rows per cycle of the highest frequency; denser rows are averaged in blocks (chosen)."""

_LEAST_ROWS = 1000
"""Least number of rows that averaging leaves (chosen)."""


@dataclass(frozen=True)
class Stretch:
    """Uninterrupted stretch of a log, also called a run, with its rows in time order.

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


_KNOWN = 12  # largest number of lines whose columns are cached (chosen)

Wave = Float[np.ndarray, "n 2"]
"""Columns of one line: cosine and sine at every row; each column is contiguous in memory."""


@dataclass(frozen=True, eq=False)
class KnownWaves:
    """Cache of the columns of the lines that were computed last; the key is the frequency."""

    last: dict[float, Wave] = field(default_factory=dict)

    def of(self, cycles: float, compute: Callable[[float], Wave]) -> Float[np.ndarray, "n 2"]:
        """Return the columns of the line at `cycles`, computed only if not in the cache."""
        if cycles not in self.last:
            if len(self.last) >= _KNOWN:
                del self.last[next(iter(self.last))]
            self.last[cycles] = compute(cycles)
        return self.last[cycles]


@dataclass(frozen=True)
class Rows:
    """Rows of all runs, one run after the other.

    **Arguments**
    - `turns`: driving revolutions minus their mean `origin`, shape (n,).
    - `width`: revolutions over which each row is averaged, shape (n,).
    - `value`: transmission error or residual in rad, shape (n,).
    - `nuisance`: for every group the slice of its rows, and its regressors, shape (rows, q).
    - `starts`: index of the first row of every run, and n at the end.
    - `waves`: cache of the columns of lines.
    """

    turns: Float[np.ndarray, " n"]
    origin: float
    width: Float[np.ndarray, " n"]
    value: Float[np.ndarray, " n"]
    nuisance: tuple[tuple[slice, Float[np.ndarray, "_ _"]], ...]
    starts: tuple[int, ...]
    waves: KnownWaves = field(default_factory=KnownWaves, repr=False, compare=False)

    @property
    def runs(self) -> list[slice]:
        """Slice of the rows of every run that has rows; a run shorter than one block has none."""
        return [slice(first, stop) for first, stop in pairwise(self.starts) if stop > first]

    @property
    def span(self) -> float:
        """Revolutions between the lowest and the highest angle."""
        return float(np.ptp(self.turns))


def stack(runs: Sequence[Stretch], highest: float) -> Rows:
    """Stack the rows of all runs; rows denser than six per cycle of `highest` are averaged.

    **Raises** `ValueError` if runs of one group differ in their columns, or if a cycle of `highest`
    has fewer than two rows, because its alias would look the same.
    """
    if not runs:
        raise ValueError("Argument `runs` must hold at least one run, but is empty.")
    step = typical_step(runs)
    if highest > (most := highest_resolved(runs)):
        raise ValueError(
            f"Argument `highest` must be at most {most:.4g} cycles per revolution, but is"
            f" {highest:.4g}: the rows are {step:.3g} revolutions apart."
        )
    block = sum(len(run.value) for run in runs) // _LEAST_ROWS
    if step > 0:
        block = min(block, whole_below(1 / (_ROWS_PER_CYCLE * highest * step)))
    groups: dict[str, list[Stretch]] = {}
    for run in runs:
        groups.setdefault(run.group, []).append(run)
    for name, members in groups.items():
        if len({run.nuisance.shape[1] for run in members}) != 1:
            raise ValueError(
                "Argument `nuisance` must have the same columns in all runs of a group, but group"
                f" {name!r} has {sorted({run.nuisance.shape[1] for run in members})}."
            )
    ordered = [_averaged(run, max(block, 1)) for members in groups.values() for run in members]
    turns = np.concatenate([run.angle for run, _ in ordered]) / REV
    origin = float(turns.mean()) if len(turns) else 0.0
    starts = (0, *np.cumsum([len(run.value) for run, _ in ordered]).tolist())
    return Rows(
        turns=turns - origin,
        origin=origin,
        width=np.concatenate([width for _, width in ordered]),
        value=np.concatenate([run.value for run, _ in ordered]),
        nuisance=_by_group([run for run, _ in ordered], starts),
        starts=starts,
    )


def _by_group(
    runs: Sequence[Stretch], starts: Sequence[int]
) -> tuple[tuple[slice, Float[np.ndarray, "_ _"]], ...]:
    """Return the slice of rows and the regressors of every group; runs of a group are neighbours.

    `starts` holds the index of the first row of every run, and the number of rows at the end.
    """
    blocks, first = [], 0
    for _, members in groupby(runs, key=attrgetter("group")):
        parts = [run.nuisance for run in members]
        blocks.append((slice(starts[first], starts[first + len(parts)]), np.concatenate(parts)))
        first += len(parts)
    return tuple(blocks)


def highest_resolved(runs: Sequence[Stretch], rows_per_cycle: float = 2.0) -> float:
    """Return the frequency with this number of rows per cycle, in cycles per revolution.

    The rows are `typical_step` apart. The result is infinite if no angle of the runs changes.
    """
    step = typical_step(runs)
    return 1 / (rows_per_cycle * step) if step > 0 else np.inf


def typical_step(runs: Sequence[Stretch]) -> float:
    """Return the travel-weighted median of the distance between successive rows, in revolutions.

    Half of the total travel consists of steps up to this size.
    """
    steps = np.sort(np.concatenate([np.abs(np.diff(run.angle)) for run in runs])) / REV
    path = np.cumsum(steps)
    return float(steps[np.searchsorted(path, 0.5 * path[-1])]) if len(steps) and path[-1] else 0.0


def _averaged(run: Stretch, block: int) -> tuple[Stretch, Float[np.ndarray, " m"]]:
    """Return the run averaged over blocks of rows, and the width of each block in revolutions.

    A block has at most `block` rows, and all have nearly equal size.
    """
    count = -(-len(run.value) // block)
    if count == len(run.value):
        return run, np.zeros(count)
    first = np.arange(count) * len(run.value) // count
    size = np.diff(np.append(first, len(run.value)))
    angle, value, nuisance = (
        np.add.reduceat(part, first, axis=0) / size.reshape(-1, *[1] * (part.ndim - 1))
        for part in (run.angle, run.value, run.nuisance)
    )
    travel = np.abs(run.angle[first + size - 1] - run.angle[first]) / REV
    width = travel * size / np.maximum(size - 1, 1)
    return Stretch(angle, value, nuisance, run.group), width
