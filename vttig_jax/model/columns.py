"""Columns of the model over all logs and both flanks, and the prior of every coefficient.

A column belongs to some logs or to all, has the same values on both flanks (their mean) or s = ∓½
times these (their difference), and has a prior:

| column | prior of its coefficient |
|---|---|
| offset of a log, gap, torque | flat |
| delay | N(−d₀, max(Δt/2, |d₀|)²): half a sampling interval, or what it showed before |
| ratio of a drive | N(0, (3·10⁻³ i)²): a ratio is misstated by a rounded number of teeth |
| first orders, tooth mesh, lines | N(0, (3 u)²), u: robust deviation of the transmission error |
| order k > 1 of each shaft, difference between the flanks | N(0, (τ/k)²), one τ each |
| rounding that repeats, beside every harmonic and the gap | N(0, r²) |
| one rounding error of a steady driving shaft, an offset of a segment | N(0, q²/12) |
| start angles of a log | N(0, (360°)²/12) |
| drift: a random walk of each log in K ramps | N(0, τ²/K) |
| delay of a part of a log; bends of the gap over the speed | N(0, τ²) |
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from ..pair.schema import Flank
from .rows import BENDS, KNOTS, ONE, PARTS, READINGS, SHAFTS, UNTOLD, RowName, S, Start, Wave

GROUPS = ("driving", "driven", "difference", "drift", "delay_parts", "gap_by_speed")
"""Groups of columns that share a prior width τ."""

FLAT, KNOWN, ROUNDING = "flat", "known", "rounding"
"""Priors of columns beside those of `GROUPS`: flat, or of known width, also that of rounding."""


@dataclass(frozen=True)
class Assumptions:
    """What is assumed before the logs are read: physics, not estimates.

    **Arguments**
    - `delay`: "fitted", or "known" where the delay is given and no column is fitted.
    - `delay_within_s`: prior standard deviation of the delay; by default half a sampling interval,
      and at least the delay itself.
    - `ratio`: prior standard deviation of the relative error of the ratio of a drive: a ratio is
      misstated by a rounded number of teeth. 0 for an exact one.
    - `orders`: prior standard deviation of first orders, mesh orders and lines, in robust
      deviations u of the transmission error.
    - `widths`: scale of the width τ of every group, in standard errors of a harmonic in the noise.
    """

    delay: Literal["fitted", "known"] = "fitted"
    delay_within_s: float | None = None
    ratio: float = 3e-3
    orders: float = 3.0
    widths: float = 1.0


class ColumnName(NamedTuple):
    """Name of a column of the model, and of its coefficient.

    **Arguments**
    - `row`: its column of the rows. - `log`: number of the first log that has it, None for all.
    - `differs`: whether it is the difference between the flanks.
    """

    row: RowName
    log: int | None = None
    differs: bool = False

    def __str__(self) -> str:
        kind, which, part = self.row
        if part is not None:
            return f"{kind} {which} {part} {self.differs} {self.log}"
        if self.row == ONE:
            return "gap" if self.differs else f"offset {self.log}"
        return " ".join(str(one) for one in (kind, self.log, which) if one is not None)


GAP = ColumnName(ONE, differs=True)
DELAY, RATIO, TORQUE = (ColumnName(RowName(kind)) for kind in ("delay", "ratio", "torque"))


@dataclass(frozen=True)
class Column:
    """Column of the model: the row column `row`, of some logs or of all (None).

    `differs`: whether it is multiplied by s. `prior`: a group, "flat", "known" or "rounding".
    `width`: prior standard deviation, in a group a multiple of τ.
    """

    row: RowName
    logs: tuple[int, ...] | None = None
    differs: bool = False
    prior: str = FLAT
    width: float = 1.0

    @property
    def name(self) -> ColumnName:
        """Name of the column; rounding has that of the column beside which it stands."""
        return ColumnName(self.row, None if self.logs is None else self.logs[0], self.differs)


@dataclass(frozen=True)
class Shape:
    """What decides which columns a model has.

    **Arguments**
    - `starts`: start of every log, which tells the harmonics that it shares with the first one.
    - `both`: whether both flanks have runs.
    - `torque`: whether every log has a torque. - `ratio`: i.
    - `drive`: whether it is a drive, whose error of the ratio is a column. The first orders of
      gears follow from eccentricities and have a flat prior.
    - `interval_s`: longest sampling interval. - `usual`: u, rad.
    - `clear`: higher orders that stand out, with the prior of first orders.
    - `still`: whether all logs are readings at standstill, without speed.
    - `drift`: whether the logs tell a drift: a table that has every place once does not.
    - `rounding`: r of every log on one flank, rad, 0 where rounding does not repeat.
    - `offsets`: standard deviations of the rounding errors of every log that are offsets, rad.
    """

    starts: tuple[Start, ...]
    both: bool
    torque: bool
    ratio: float
    drive: bool
    interval_s: float
    usual: float
    clear: frozenset[RowName] = frozenset()
    still: bool = False
    drift: bool = True
    rounding: tuple[float, ...] = ()
    offsets: tuple[tuple[float, ...], ...] = ()


def columns_of(waves: Sequence[Wave], shape: Shape, assumed: Assumptions) -> Iterator[Column]:
    """Yield the columns of the model."""

    def rounded(row: RowName, logs: Sequence[int], *, differs: bool) -> Iterator[Column]:
        for log in [k for k in logs if any(shape.rounding) and shape.rounding[k] > 0]:
            width = shape.rounding[log] * (1 + differs) ** 0.5
            yield Column(row, (log,), differs, ROUNDING, width)

    for log, start in enumerate(shape.starts):
        yield Column(ONE, (log,))
        for shaft, std in zip(SHAFTS, start.spread, strict=True):
            if 0 < std < np.inf:
                yield Column(RowName("start", shaft), (log,), prior=KNOWN, width=2 * UNTOLD)
    if shape.both:
        yield Column(ONE, differs=True)
        yield from rounded(ONE, range(len(shape.starts)), differs=True)
    if assumed.delay == "fitted":
        yield Column(DELAY.row, prior=KNOWN)
    if shape.drive and assumed.ratio > 0:
        yield Column(RATIO.row, prior=KNOWN, width=assumed.ratio * abs(shape.ratio))
    if shape.torque:
        yield Column(TORQUE.row)
    for log, start in enumerate(shape.starts):
        for wave in waves:
            if log and start.tells(wave):
                continue
            told = (k for k, one in enumerate(shape.starts) if one.tells(wave))
            logs = (log,) if log else tuple(told)
            for differs in (False, True) if shape.both else (False,):
                prior, width = ("difference" if differs else wave.shaft), 1.0 / wave.order
                if wave.shaft == "both" or (not shape.drive and wave.is_first):
                    prior, width = FLAT, 1.0
                elif wave.is_first or wave.shaft not in GROUPS or wave.row("cos") in shape.clear:
                    prior, width = KNOWN, assumed.orders * shape.usual
                for row in (wave.row("cos"), wave.row("sin")):
                    yield Column(row, logs, differs, prior, width)
                    yield from rounded(row, logs, differs=differs)
    for log in range(len(shape.starts)):
        for k, width in enumerate(shape.offsets[log] if shape.offsets else ()):
            yield Column(RowName("offset", k), (log,), prior=KNOWN, width=width)
        for k in range(KNOTS if shape.drift else 0):
            yield Column(RowName("drift", k), (log,), prior="drift", width=KNOTS**-0.5)
        if assumed.delay == "fitted" and shape.both:  # on one flank it is a drift
            for k in range(PARTS):
                yield Column(RowName("part", k), (log,), prior="delay_parts")
    if shape.both and not shape.still:
        for k in range(BENDS):
            yield Column(RowName("bend", k), differs=True, prior="gap_by_speed")


def embedding(
    columns: Sequence[Column], names: dict[RowName, int], log: int, flank: Flank
) -> np.ndarray:
    """Return the matrix (row columns, model columns and y) of the runs of a log on one flank."""
    matrix = np.zeros((len(names), len(columns) + 1))
    for place, column in enumerate(columns):
        if (column.logs is None or log in column.logs) and column.row in names:
            matrix[names[column.row], place] = S[flank] if column.differs else 1.0
    matrix[names[READINGS], -1] = 1.0
    return matrix
