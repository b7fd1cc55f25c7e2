"""Rows of the model: what both encoders showed, averaged over short pieces of the runs.

A row is the mean of some consecutive samples of one run. The columns are computed at every sample
and averaged like the readings, so that averaging costs no exactness. In a run on one flank the
columns of the difference of both flanks are those of their mean times s = −½ (A) or ½ (B);
therefore a row has each column only once, and `columns.py` says how the model uses it.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Complex, Float, Int
from scipy.interpolate import CubicHermiteSpline
from scipy.ndimage import uniform_filter1d

from ..base.numerics.counting import pieces
from ..base.units import DEG, REV
from ..logs.channel.speed import cubic_noise, smooth_speed
from ..pair.schema import Flank
from .density import LAGS

KNOTS, PARTS, BENDS = 14, 8, 5
"""Ramps of the drift, parts of the log with a delay of their own, and bends of the gap in speed."""

_PIECE = 1 << 14

SHAFTS = ("driving", "driven")

UNTOLD = 0.5 * REV / math.sqrt(12.0)
"""Standard deviation of an angle that is told: half that of an angle of which nothing is known."""

S: dict[Flank, float] = {"A": -0.5, "B": 0.5}
"""s of every flank, by which a difference between the flanks counts on it."""


class RowName(NamedTuple):
    """Name of a column of the rows: `RowName("drift", 3)`, `RowName("driving", 2, "cos")`.

    **Arguments**
    - `kind`: "one", "delay", "late", "ratio", "torque", "drift", "part", "bend", "start", "given",
      "y"; for a harmonic the `shaft` of its `Wave`.
    - `which`: order of the harmonic; number of the ramp, part or bend; shaft of the start; name of
      the parameter of a flank model.
    - `part`: "cos" or "sin" of a harmonic, else None.
    """

    kind: str
    which: int | float | str | None = None
    part: str | None = None


ONE, LATE, READINGS = RowName("one"), RowName("late"), RowName("y")


class Run(NamedTuple):
    """Samples [`start`, `stop`) of a log on one flank."""

    start: int
    stop: int
    flank: Flank


@dataclass(frozen=True)
class Wave:
    """Harmonic exp(j (n₁ φ₁ + n₂ φ₂)) of the shaft angles; `shaft` and `order` name it."""

    shaft: str
    order: int | float
    driving: int | float
    driven: int | float

    @property
    def is_first(self) -> bool:
        """Whether it is the first order of a shaft."""
        return self.order == 1 and self.shaft in ("driving", "driven")

    def row(self, part: str) -> RowName:
        """Return the name of the column of its part "cos" or "sin"."""
        return RowName(self.shaft, self.order, part)

    def cycles(self, ratio: float) -> float:
        """Return its cycles per driving turn."""
        return abs(self.driving + self.driven * ratio)


@dataclass(frozen=True)
class Start:
    """Angles of both shafts, in those of the first log, at which the angles of a log are zero, rad.

    `spread`: their standard deviations, 0 for one zero of both logs, and infinite if nothing tells
    the angle.
    """

    angles: tuple[float, float] = (0.0, 0.0)
    spread: tuple[float, float] = (0.0, 0.0)

    def tells(self, wave: Wave) -> bool:
        """Return whether the start tells the phase of a harmonic, so that both logs share it.

        The phase of a fractional order depends on whole turns too, which no start angle tells.
        """
        if not any(self.spread):
            return True
        counts = wave.driving, wave.driven
        off = [n * std for n, std in zip(counts, self.spread, strict=True) if n]
        return all(n == int(n) for n in counts) and math.hypot(*off) < UNTOLD


@dataclass(frozen=True, eq=False)
class Shafts:
    """One log as the model sees it: angles (rad), transmission error, speed, and runs.

    `error` is φ₂ − i φ₁, exact to rounding also after many turns. `good` marks the samples that are
    no outliers. `ramps` are runs that may leave their flank. `steady` is the speed that tells the
    delay, smoother than `speed`.
    `nominal` are slope and level of the driven over the driving angle: harmonics of
    the driven shaft are taken there, since the measured angle contains the gap. Harmonics count
    from the `start`, all other angles from the zero of the log. `still`: whether the samples are
    readings at standstill, which have no speed and no delay. `tells_drift`: whether a drift does
    not look like orders, as it does where a table has about every place once. `rounding`: standard
    deviation, on one flank, of what rounding that repeats adds to a coefficient of a harmonic, rad.
    `offsets`: samples [start, stop) with one rounding error, and its standard deviation, rad.
    """

    time: Float[np.ndarray, " n"]
    driving: Float[np.ndarray, " n"]
    error: Float[np.ndarray, " n"]
    speed: Float[np.ndarray, " n"]
    steady: Float[np.ndarray, " n"]
    ratio: float
    interval_s: float
    runs: tuple[Run, ...]
    ramps: tuple[Run, ...]
    nominal: tuple[float, float]
    resolution: float
    torque: Float[np.ndarray, " n"] | None = None
    axial_mm: Float[np.ndarray, " n"] | None = None
    good: np.ndarray | None = None
    start: Start = Start()
    still: bool = False
    tells_drift: bool = True
    rounding: float = 0.0
    offsets: tuple[tuple[int, int, float], ...] = ()

    def in_runs(self, values: Float[np.ndarray, " n"]) -> Float[np.ndarray, " k"]:
        """Return the values of the samples of all runs."""
        return np.concatenate([values[run.start : run.stop] for run in self.runs])

    @property
    def level(self) -> float:
        """Whole degrees near the transmission error, which readings of the rows leave out, rad."""
        return float(np.rint(np.median(self.error) / DEG) * DEG)

    def without(self, outliers: Int[np.ndarray, " k"]) -> "Shafts":
        """Return the log with these samples left out of the interpolation and of the speed."""
        good = np.ones(len(self.time), bool)
        good[outliers] = False
        if self.still:
            return replace(self, good=good)
        clean = np.interp(self.time, self.time[good], self.driving[good])
        speed = smooth_speed(self.time, clean, self.resolution).value
        runs = (*self.runs, *self.ramps)
        return replace(self, good=good, speed=speed).steadied(clean, runs)

    def steadied(self, driving: Float[np.ndarray, " n"], runs: Sequence[Run]) -> "Shafts":
        """Return the log with its steady speed in `runs`, from φ₁ without outliers.

        It is that of the means of the h samples before and after each one in its run. Noise v of
        the angle gives it a variance of 2 v/(h³ Δt²), as if the speed changed and told the delay.
        Beside a noise e of the error, n samples then tell the delay a tenth as well as half a
        sampling interval does if h³ = 5 n i² v/e. A change beside a run says nothing about the run.
        """
        time, found = self.time, self.speed.copy()
        noise, whole = abs(self.ratio) * cubic_noise(time, driving), cubic_noise(time, self.error)
        share = min(noise / max(whole, 1e-300), 1.0) ** 2
        for run in runs:
            own = slice(run.start, run.stop)
            place = np.arange(count := run.stop - run.start)
            half = np.ceil((5 * len(time) * share) ** (1 / 3))
            half = int(np.clip(half, 1, max(1, count // 4)))
            before, after = np.maximum(place - half, 0), np.minimum(place + 1, max(count - half, 0))
            means = (uniform_filter1d(x[own], half, origin=-(half // 2)) for x in (driving, time))
            rise, past = (mean[after] - mean[before] for mean in means)
            found[own] = rise / np.maximum(past, 1e-300)
        return replace(self, steady=found)

    def delayed(self, delay_s: float) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
        """Return φ₁ and its steady speed at t − d.

        φ₁ is a cubic through the samples that are no outliers. Its noise does not change the mean
        product of angle and steady speed, so that it does not move the delay.
        """
        if delay_s == 0:
            return self.driving, self.steady
        good = np.diff(self.time, prepend=-np.inf) > 0  # a log may have a time stamp twice
        good &= True if self.good is None else self.good
        curve = CubicHermiteSpline(self.time[good], self.driving[good], self.speed[good])
        earlier = np.clip(self.time - delay_s, self.time[0], self.time[-1])
        moved = self.driving + curve(earlier) - curve(self.time)
        return moved, np.interp(earlier, self.time, self.steady)

    def on_time(self, delay_s: float) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
        """Return φ₁ at t − d, and the transmission error there, rad."""
        moved, _ = self.delayed(delay_s)
        return moved, self.error + self.ratio * (self.driving - moved)


@dataclass(frozen=True, eq=False)
class Rows:
    """Rows of one log: columns by name, the last one the readings y, rad.

    `first`, `last`, `flanks`: rows at the ends of every run, and its flank.
    `samples`: the samples of every row. `speed`, `angle`, `time`: their means.
    """

    names: dict[RowName, int]
    table: Float[np.ndarray, "n q"]
    first: Int[np.ndarray, " runs"]
    last: Int[np.ndarray, " runs"]
    flanks: tuple[Flank, ...]
    samples: Int[np.ndarray, "n size"]
    speed: Float[np.ndarray, " n"]
    angle: Float[np.ndarray, " n"]
    time: Float[np.ndarray, " n"]

    @property
    def flank(self) -> np.ndarray:
        """Flank of every row, "A" or "B"."""
        return np.repeat(np.array(self.flanks, "<U1"), self.last - self.first + 1)

    def column(self, name: RowName) -> Float[np.ndarray, " n"]:
        """Return one column."""
        return self.table[:, self.names[name]]

    def with_columns(self, columns: Mapping[RowName, Float[np.ndarray, " n"]]) -> "Rows":
        """Return the rows with further columns."""
        names = (*(name for name in self.names if name != READINGS), *columns, READINGS)
        return replace(
            self,
            names={name: place for place, name in enumerate(names)},
            table=np.column_stack([self.table[:, :-1], *columns.values(), self.table[:, -1]]),
        )


class Extra:
    """Further columns of the rows: derivatives of a flank model, whose value leaves the readings.

    The columns are `RowName("given", name)` for every name that is `told`. `highest_order` is that
    of the flank model, cycles per driving turn.
    """

    highest_order: float = 0.0

    @property
    def told(self) -> tuple[str, ...]:
        """Names of the parameters that have a column."""
        return ()

    def with_derivatives(self, shafts: Shafts, rows: Rows, delay_s: float) -> Rows:
        """Return the rows with the columns of the flank model, less its transmission error."""
        raise NotImplementedError


def merged(runs: Sequence[Run]) -> tuple[Run, ...]:
    """Return the runs in order, where those that follow one another on one flank are one run.

    The noise goes on from one to the next.
    """
    found: list[Run] = []
    for run in sorted(runs):
        if found and (found[-1].stop, found[-1].flank) == (run.start, run.flank):
            run = run._replace(start=found.pop().start)
        found.append(run)
    return tuple(found)


def rows_of(
    shafts: Shafts,
    waves: Sequence[Wave],
    row_s: float,
    delay_s: float,
    bends: Float[np.ndarray, " bends"],
    *,
    ratio: bool,
) -> Rows:
    """Return the rows of a log, whose driving angle is taken `delay_s` earlier.

    `row_s`: duration of a row. `bends`: speeds (rad/s) at which the gap may bend. A run of fewer
    than `LAGS` + 2 rows is left out.
    """
    size = max(1, round(row_s / shafts.interval_s))
    lost = int(np.ceil(abs(delay_s) / shafts.interval_s))
    parts, first, last, flanks = [], [], [], []
    for start, stop, flank in shafts.runs:
        start, stop = (start + lost, stop) if delay_s > 0 else (start, stop - lost)
        count = (stop - start) // size
        if count > LAGS + 1:
            parts.append(np.arange(start, start + count * size))
            first.append(sum(map(len, parts[:-1])) // size)
            last.append(first[-1] + count - 1)
            flanks.append(flank)
    samples = (np.concatenate(parts) if parts else np.arange(0)).reshape(-1, size)
    moved, moved_speed = shafts.delayed(delay_s)
    span, level = np.ptp(shafts.time), shafts.level
    centre = moved[samples].mean() if len(samples) else 0.0
    mean = lambda values: values.mean(1)  # noqa: E731

    def columns(index: Int[np.ndarray, "k size"]) -> Iterator[tuple[RowName, np.ndarray]]:
        """Yield the columns of rows with the samples `index`."""
        angle, speed = moved[index], mean(moved_speed[index])
        late = -shafts.ratio * speed
        yield ONE, np.ones(len(index))
        yield RowName("delay"), late
        yield LATE, -shafts.ratio * mean(shafts.speed[index])
        if ratio:
            yield RowName("ratio"), mean(angle) - centre
        if shafts.torque is not None:
            yield RowName("torque"), mean(shafts.torque[index])
        for wave, values in zip(waves, _waves(waves, angle, shafts), strict=True):
            averaged = mean(values)
            yield wave.row("cos"), averaged.real
            yield wave.row("sin"), averaged.imag
        x = (mean(shafts.time[index]) - shafts.time.min()) / span
        for k in range(KNOTS):
            yield RowName("drift", k), np.clip(x * KNOTS - k, 0, 1)
        for k in range(PARTS):
            yield RowName("part", k), late * np.clip(1 - np.abs(x * (PARTS - 1) - k), 0, None)
        for k, (start, stop, _) in enumerate(shafts.offsets):
            yield RowName("offset", k), mean((index >= start) & (index < stop))
        for k, bend in enumerate(bends):
            yield RowName("bend", k), np.clip(np.abs(speed) - bend, 0, None)
        error = shafts.error[index] - level
        yield READINGS, mean(error + shafts.ratio * (shafts.driving[index] - angle))

    names = {name: place for place, (name, _) in enumerate(columns(samples[:0]))}
    table = np.empty((len(samples), len(names)))
    for own in pieces(len(samples), max(1, _PIECE // size)):
        for name, values in columns(samples[own]):
            table[own, names[name]] = values
    if shafts.torque is not None and len(table):
        table[:, names[RowName("torque")]] -= table[:, names[RowName("torque")]].mean()
    return Rows(
        names=names,
        table=table,
        first=np.array(first, int),
        last=np.array(last, int),
        flanks=tuple(flanks),
        samples=samples,
        speed=np.abs(shafts.speed)[samples].mean(1),
        angle=moved[samples].mean(1),
        time=shafts.time[samples].mean(1),
    )


def _waves(
    waves: Sequence[Wave], angle: Float[np.ndarray, "n size"], shafts: Shafts
) -> Iterator[Complex[np.ndarray, "n size"]]:
    """Yield every wave at the samples; whole orders by multiplication of the first ones."""
    (slope, level), start = shafts.nominal, shafts.start.angles
    angles = angle + start[0], slope * angle + level + start[1]
    powers: list[dict[float, np.ndarray]]  # of each shaft, by its order
    powers = [{1: np.exp(1j * angle)} for angle in angles]

    def power(shaft: int, order: int | float) -> np.ndarray:
        own, size = powers[shaft], abs(order)
        if size not in own:
            whole = size == int(size) and size - 1 in own
            own[size] = own[size - 1] * own[1] if whole else np.exp(1j * size * angles[shaft])
        return own[size] if order > 0 else own[size].conj()

    for wave in waves:
        parts = [power(k, n) for k, n in enumerate((wave.driving, wave.driven)) if n]
        yield parts[0] if len(parts) == 1 else parts[0] * parts[1]
