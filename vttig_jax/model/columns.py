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

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ..base.units import REV
from ..logs.motion.segments import CLEAR, told_orders
from ..pair.gear_pair import Drive, GearPair
from ..pair.schema import Flank, HarmonicOrders
from .density import LAGS, MEMORY
from .rows import (
    BENDS,
    KNOTS,
    ONE,
    PARTS,
    READINGS,
    SHAFTS,
    UNTOLD,
    Extra,
    RowName,
    Rows,
    S,
    Shafts,
    Wave,
    rows_of,
)

GROUPS = ("driving", "driven", "difference", "drift", "delay_parts", "gap_by_speed")
"""Groups of columns that share a prior width τ."""

_TABLE, _FORGETFUL = 1.5, 0.05
"""Turns below which a log is a table of one turn; the prior widths of atanh π_k, k > 1, there."""

FLAT, KNOWN, ROUNDING = "flat", "known", "rounding"
"""Priors of columns beside those of `GROUPS`: flat, or of known width, also that of rounding."""


@dataclass(frozen=True)
class Assumptions:
    """What is assumed before the logs are read: physics, not estimates.

    **Arguments**
    - `delay_s`: known delay, for which no column is fitted; None where it is fitted.
    - `delay_within_s`: prior standard deviation of the delay; by default half a sampling interval,
      and at least the delay itself.
    - `ratio`: prior standard deviation of the relative error of the ratio of a drive: a ratio is
      misstated by a rounded number of teeth. 0 for an exact one.
    - `orders`: prior standard deviation of first orders, mesh orders and lines, in robust
      deviations u of the transmission error.
    - `widths`: scale of the width τ of every group, in standard errors of a harmonic in the noise.
    """

    delay_s: float | None = None
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


@dataclass(frozen=True, eq=False)
class Design:
    """Columns and rows that the model gives to logs, before their readings count.

    **Arguments**
    - `shafts`: the logs as the fit found them. - `waves`: harmonics of the model.
    - `both`: whether both flanks have runs.
    - `drive`: whether it is a drive, whose error of the ratio is a column. The first orders of
      gears follow from eccentricities and have a flat prior.
    - `row_s`: duration of a row. - `bends`: speeds (rad/s) at which the gap may bend.
    - `table`: whether the log is a table of one turn.
    - `assumed`, `given`: assumptions and further columns, see `mixed_fit`.
    - `clear`: higher orders that stand out, with the prior of first orders.
    - `usual`: u, rad. - `delay_s`: d₀, by which the driving angle is taken earlier.
    """

    shafts: tuple[Shafts, ...]
    waves: tuple[Wave, ...]
    both: bool
    drive: bool
    row_s: float
    bends: Float[np.ndarray, " bends"]
    table: bool
    assumed: Assumptions = Assumptions()
    given: Extra | None = None
    clear: frozenset[RowName] = frozenset()
    usual: float = 1.0
    delay_s: float = 0.0

    @property
    def still(self) -> bool:
        """Whether all logs are readings at standstill, without speed."""
        return all(one.still for one in self.shafts)

    @property
    def drift(self) -> bool:
        """Whether the logs tell a drift: a table that has every place once does not."""
        return any(one.tells_drift for one in self.shafts)

    @property
    def memory(self) -> Float[np.ndarray, " lags"]:
        """Prior widths of atanh π_k: in a table longer memory and orders look the same.

        So does any memory where every place was read once.
        """
        if not (self.table or self.still):
            return MEMORY
        return np.where(np.arange(LAGS) >= self.drift, _FORGETFUL, MEMORY)

    def rows(self, shafts: Sequence[Shafts]) -> tuple[Rows, ...]:
        """Return the rows of every log, whose driving angle is taken `delay_s` earlier."""
        ratio = self.drive and self.assumed.ratio > 0
        found = tuple(
            rows_of(one, self.waves, self.row_s, self.delay_s, self.bends, ratio=ratio)
            for one in shafts
        )
        if self.given is None:
            return found
        return tuple(
            self.given.with_derivatives(one, rows, self.delay_s)
            for one, rows in zip(shafts, found, strict=True)
        )

    @cached_property
    def columns(self) -> tuple[Column, ...]:
        """Columns of the model."""
        return tuple(self._columns())

    def _columns(self) -> Iterator[Column]:
        shafts, assumed = self.shafts, self.assumed

        def rounded(row: RowName, logs: Iterable[int], *, differs: bool) -> Iterator[Column]:
            for log in logs:
                if (rounding := shafts[log].rounding) > 0:
                    yield Column(row, (log,), differs, ROUNDING, rounding * (1 + differs) ** 0.5)

        for log, one in enumerate(shafts):
            yield Column(ONE, (log,))
            for shaft, std in zip(SHAFTS, one.start.spread, strict=True):
                if 0 < std < np.inf:
                    yield Column(RowName("start", shaft), (log,), prior=KNOWN, width=2 * UNTOLD)
        if self.both:
            yield Column(ONE, differs=True)
            yield from rounded(ONE, range(len(shafts)), differs=True)
        if assumed.delay_s is None:
            half = 0.5 * max(one.interval_s for one in shafts)
            width = assumed.delay_within_s or max(half, abs(self.delay_s))
            yield Column(DELAY.row, prior=KNOWN, width=width)
        if self.drive and assumed.ratio > 0:
            yield Column(RATIO.row, prior=KNOWN, width=assumed.ratio * abs(shafts[0].ratio))
        if all(one.torque is not None for one in shafts):
            yield Column(TORQUE.row)
        for log, one in enumerate(shafts):
            for wave in self.waves:
                if log and one.start.tells(wave):
                    continue
                told = (k for k, each in enumerate(shafts) if each.start.tells(wave))
                logs = (log,) if log else tuple(told)
                for differs in (False, True) if self.both else (False,):
                    prior, width = ("difference" if differs else wave.shaft), 1.0 / wave.order
                    if wave.shaft == "both" or (not self.drive and wave.is_first):
                        prior, width = FLAT, 1.0
                    elif wave.is_first or wave.shaft not in GROUPS or wave.row("cos") in self.clear:
                        prior, width = KNOWN, assumed.orders * self.usual
                    for row in (wave.row("cos"), wave.row("sin")):
                        yield Column(row, logs, differs, prior, width)
                        yield from rounded(row, logs, differs=differs)
        for log, one in enumerate(shafts):
            for k, (_, _, width) in enumerate(one.offsets):
                yield Column(RowName("offset", k), (log,), prior=KNOWN, width=width)
            for k in range(KNOTS if self.drift else 0):
                yield Column(RowName("drift", k), (log,), prior="drift", width=KNOTS**-0.5)
            if assumed.delay_s is None and self.both:  # on one flank it is a drift
                for k in range(PARTS):
                    yield Column(RowName("part", k), (log,), prior="delay_parts")
        if self.both and not self.still:
            for k in range(BENDS):
                yield Column(RowName("bend", k), differs=True, prior="gap_by_speed")
        if self.given is not None:
            yield from (Column(RowName("given", name)) for name in self.given.told)

    def scales(self, noise: float, rows: int) -> dict[str, float]:
        """Return the usual width τ of every group, where each of the rows has this noise, rad.

        It is the standard error of a harmonic in white noise: what a log does not ask for stays
        smaller than what it can tell. A larger one lets slow noise pass for orders or a drift. What
        changes with the speed may be as large as the noise at the highest speed. The orders of a
        table of one turn may be as large as what it shows: nothing else tells them from noise.
        """
        noise = self.assumed.widths * max(noise, 1e-4 * self.usual)
        speed = max(float(self.bends[-1]), 1e-300)
        usual: dict[str, float] = dict.fromkeys(GROUPS, noise * math.sqrt(2 / rows))
        if self.table:
            usual |= dict.fromkeys(("driving", "driven"), self.assumed.widths * self.usual)
        if self.still:
            return usual
        late = abs(self.shafts[0].ratio) * speed
        return usual | {"delay_parts": noise / late, "gap_by_speed": noise / speed}


def design_of(
    shafts: Sequence[Shafts],
    pair: GearPair | Drive,
    orders: HarmonicOrders,
    *,
    lines: Sequence[float] = (),
    assumed: Assumptions = Assumptions(),
    given: Extra | None = None,
) -> Design:
    """Return the design of logs; the arguments are those of `mixed_fit`."""
    ratio = float(pair.ratio)
    waves = waves_of(pair, orders, lines)
    found = [one for one in shafts if one.runs]
    if all(one.still for one in shafts):
        angles = np.concatenate([one.in_runs(one.driving) for one in found])
        firsts = [wave for wave in waves if wave.is_first]
        waves = told_waves(angles, waves, ratio)
        if not tells_ratio(angles, {*waves, *firsts}, ratio):
            assumed = replace(assumed, ratio=0.0)
    cycles = [wave.cycles(ratio) for wave in waves]
    cycles += [] if given is None else [given.highest_order]
    speeds = np.concatenate([np.abs(one.in_runs(one.speed)) for one in found])
    ends = [one.driving[[[run.start, run.stop - 1] for run in one.runs]] for one in shafts]
    return Design(
        shafts=tuple(shafts),
        waves=waves,
        both=len({run.flank for one in shafts for run in one.runs}) == 2,
        drive=isinstance(pair, Drive),
        row_s=row_duration(shafts, max(cycles, default=1.0)),
        bends=np.quantile(speeds, np.linspace(0, 1, BENDS + 2)[1:-1]),
        table=max(float(np.ptp(angles)) for angles in ends) / REV < _TABLE,
        assumed=assumed,
        given=given,
    )


def waves_of(
    pair: GearPair | Drive, orders: HarmonicOrders, lines: Sequence[float] = ()
) -> tuple[Wave, ...]:
    """Return the harmonics of both shafts and of the mesh, each frequency once, and lines.

    Of two orders of one frequency that of the driving shaft is kept.
    """
    ratio = pair.ratio
    found: dict[float | Fraction, Wave] = {}
    for k in orders.driving_orders:
        found.setdefault(k, Wave("driving", k, k, 0))
    for k in orders.driven_orders:
        found.setdefault(k * ratio, Wave("driven", k, 0, k))
    if isinstance(pair, GearPair):
        teeth = pair.driving.teeth
        for k in range(1, orders.mesh_orders + 1):
            found.setdefault(k * teeth, Wave("mesh", k, k * teeth, 0))
        for sign in (1, -1):
            found.setdefault(abs(1 + sign * ratio), Wave("both", sign, 1, sign))
    return (*found.values(), *(Wave("line", c, c, 0) for c in lines))


def told_waves(
    angle: Float[np.ndarray, " n"], waves: Sequence[Wave], ratio: float
) -> tuple[Wave, ...]:
    """Return the harmonics that readings at driving angles, rad, tell from one another.

    Of harmonics that look alike there the lower one of its own shaft is kept: a first order of the
    driving shaft is likelier than a fifth one of the driven shaft.
    """
    own = lambda wave: max(abs(wave.driving), abs(wave.driven)) + (wave.shaft == "both")  # noqa: E731
    likely = sorted(waves, key=own)
    told = told_orders(angle, [w.cycles(ratio) for w in likely], sum(w.is_first for w in waves))
    return tuple(wave for wave in waves if told[likely.index(wave)])


def tells_ratio(angle: Float[np.ndarray, " n"], waves: Iterable[Wave], ratio: float) -> bool:
    """Return whether readings at driving angles, rad, tell an error of the ratio from harmonics.

    At few places a slope has the values of many harmonics together, and would take what is in none
    of them, such as a first order that is +1 and −1 in turn.
    """
    phase = np.outer(angle, [0.0, *(wave.cycles(ratio) for wave in waves)])
    columns = np.concatenate([np.cos(phase), np.sin(phase)], axis=1)
    x = angle - angle.mean()
    rest = x - columns @ np.linalg.lstsq(columns, x, rcond=CLEAR**3)[0]
    return float(rest @ rest) > CLEAR**9 * float(x @ x)


def row_duration(shafts: Sequence[Shafts], highest: float) -> float:
    """Return the duration of a row: a quarter of the shortest cycle, and enough rows in a run."""
    found = [one.interval_s for one in shafts if one.still]
    for one in (one for one in shafts if not one.still):
        speed = np.abs(one.in_runs(one.speed))
        lengths = [run.stop - run.start for run in one.runs]
        cycle = REV / max(float(np.quantile(speed, 0.9)), 1e-9) / highest / one.interval_s
        size = min(cycle / 4, float(np.median(lengths)) / (2 * LAGS), sum(lengths) / 250)
        found.append(one.interval_s * max(1, int(size)))
    return min(found)


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
