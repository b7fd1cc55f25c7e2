"""What the samples of a fit tell beside its numbers: averages over turns, and passes of the axis.

The samples are averaged in cells of equal driving angle. What the fit attributes to drift, delay
and speed is taken off. The synchronous average of a shaft is the mean of a cell's place over all
its turns; the averages of both shafts are separated by taking off each in turn. Their harmonics
are divided by the response of the cell, and their standard errors come from the spectrum of what
is left.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Complex, Float, Int

from ..base.units import ARCSEC, REV
from ..kinematics.flank_model import flank_index
from ..logs.channel.speed import SAME, usual_step
from ..model.mixed_fit import MixedFit, residuals
from ..model.rows import SHAFTS, RowName, S, Shafts
from ..pair.gear_pair import Drive, GearPair
from ..pair.schema import Flank
from .orders import Order

_PER_PITCH, _PER_TURN, _HIGHEST, _MOST_ORDERS = (4, 16), (64, 720), 0.4, 1024
"""Fewest and most cells in a pitch, or in a turn without teeth; highest order in cells in a turn;
most orders of a shaft (chosen)."""

ENOUGH_TURNS = 2.0
"""Turns of a shaft that tell its average (chosen)."""

_ROUNDS, _LOW = 8, 12
"""Rounds that separate the shafts; orders below which the noise is resolved order by order
(chosen)."""

_MOST_PASSES, _MOST_TURNS, _SPREAD = 100, 100, 12
"""Most passes and turns of the axis that are kept, and targets in a turn of the axis while it runs
(chosen)."""


class CellRun(NamedTuple):
    """One run in cells: flank, angles of both shafts, transmission error, and this without drift
    and delay (NaN in a cell without a sample), rad; and the variance of places in a cell, cells².
    """

    flank: Flank
    angles: tuple[np.ndarray, np.ndarray]
    error: np.ndarray
    steady: np.ndarray
    variance: float


@dataclass(frozen=True, eq=False)
class Measured:
    """What a run folder keeps of the samples for `accuracy_of`.

    **Arguments**
    - `harmonics`: of every flank and order: 0 for A or 1 for B; cycles in a turn of the driving and
      of the driven shaft, 0 if not whole; real and imaginary part, and standard error of both, rad.
    - `readings`: deviation of the axis at each target, upwards and downwards, in each pass, rad;
      NaN where a pass is missing. - `scatter`: rms of what the fit leaves of each reading, rad.
    - `places`: the targets, turns of the driven shaft. - `turns`: turns of both shafts.
    """

    harmonics: Float[np.ndarray, "n 6"]
    readings: Float[np.ndarray, "targets 2 passes"]
    places: Float[np.ndarray, " targets"]
    scatter: Float[np.ndarray, ""] | float
    turns: Float[np.ndarray, " shafts=2"]


class Averaged(NamedTuple):
    """Orders that are averaged: shaft (0 or 1) and order of each, cells in a turn of the driving
    shaft, and column of the fit → place of its order and factor of its phase."""

    shaft: np.ndarray
    order: np.ndarray
    cells: int
    fitted: dict[RowName, tuple[int, complex]]


def measured(core: MixedFit, pair: GearPair | Drive, told: Sequence[Order]) -> Measured | None:
    """Return what the samples of a fit with the orders `told` tell; None for a fit without them."""
    if not core.shafts:
        return None
    first, ratio = core.shafts[0], abs(pair.ratio)
    turns = np.array([core.scope.turns[shaft] for shaft in SHAFTS])
    if first.still:
        places, readings = _approaches(first)
        return Measured(np.empty((0, 6)), readings, places, float(np.std(core.residual)), turns)
    orders = _averaged(core, pair, turns)
    runs = list(_runs(core, orders))
    by_flank = [own for own in ([r for r in runs if r.flank == flank] for flank in S) if own]
    parts = [_harmonics(core, ratio, told, own, orders) for own in by_flank]
    places, readings = _passes(runs, float(ratio), ratio.numerator)
    scatter = float(np.std(np.concatenate([left for _, left in parts])))
    return Measured(np.concatenate([h for h, _ in parts]), readings, places, scatter, turns)


def _averaged(core: MixedFit, pair: GearPair | Drive, turns: np.ndarray) -> Averaged:
    """Return the orders that are averaged over these `turns` of both shafts."""
    first, ratio = core.shafts[0], abs(pair.ratio)
    teeth, ends = (pair.driving.teeth, _PER_PITCH) if isinstance(pair, GearPair) else (1, _PER_TURN)
    speed = float(np.median(np.abs(first.in_runs(first.speed))))
    cells = teeth * int(np.clip(REV / (speed * first.interval_s) / teeth / 2, *ends))
    most = np.minimum(_HIGHEST * cells / np.array([1.0, ratio]), _MOST_ORDERS)
    driving, driven = (np.arange(1, int(one) + 1) for one in most * (turns >= ENOUGH_TURNS))
    if len(driving):  # what both shafts repeat counts with the driving shaft
        driven = driven[driven * ratio.numerator % ratio.denominator != 0]
    shaft = np.repeat([0, 1], [len(driving), len(driven)])
    orders = Averaged(shaft, np.concatenate([driving, driven]), cells, {})
    for wave in core.waves:
        cycles = wave.driving + wave.driven * ratio if wave.shaft in (*SHAFTS, "mesh") else 0
        own = (0, cycles) if cycles == int(cycles) and len(driving) else (1, wave.driven)
        for place in np.flatnonzero((shaft == own[0]) & (orders.order == float(own[1]))):
            factor = np.exp(1j * wave.driven * first.nominal[1])
            orders.fitted[wave.row("cos")] = int(place), factor
            orders.fitted[wave.row("sin")] = int(place), -1j * factor
    return orders


def _runs(core: MixedFit, orders: Averaged) -> Iterator[CellRun]:
    """Yield the runs of the logs that share one zero."""
    problem, coefficients = core.posterior.problem, core.posterior.coefficients
    others = np.ones(len(coefficients), bool)
    others[[at for name, at in problem.index.items() if name.row in orders.fitted]] = False
    both = (residuals(problem.columns, core.rows, coefficients * part) for part in (0.0, others))
    for shafts, rows, whole, left in zip(core.shafts, core.rows, *both, strict=True):
        if any(shafts.start.spread):
            continue
        (slope, level), start = shafts.nominal, shafts.start.angles
        moved, error = shafts.on_time(core.delay_s)
        for first, last, flank in zip(rows.first, rows.last, rows.flanks, strict=True):
            own = np.arange(rows.samples[first, 0], rows.samples[last, -1] + 1)
            own = own if shafts.good is None else own[shafts.good[own]]
            place = moved[own] * (orders.cells / REV)
            cell = np.floor(place).astype(int)
            lowest, off = cell.min(), place - cell
            count = np.bincount(cell - lowest)
            seen, every = np.flatnonzero(count), np.arange(len(count))
            terms = off, off**2, error[own], shafts.time[own]
            mean = [np.bincount(cell - lowest, one)[seen] / count[seen] for one in terms]
            middle, _, shown, time = (np.interp(every, seen, one) for one in mean)
            angle, part = (every + middle + lowest) * (REV / orders.cells), slice(first, last + 1)
            slow = np.interp(time, rows.time[part], (whole - left)[part]) + shafts.level
            variance = float(np.mean(mean[1] - mean[0] ** 2))
            angles = angle + start[0], slope * angle + level - core.shafts[0].nominal[1] + start[1]
            steady = np.where(count > 0, shown - slow, np.nan)
            yield CellRun(flank, angles, shown, steady, variance)


@dataclass(frozen=True, eq=False)
class _Turn:
    """Where the cells of a flank lie in a turn of one shaft, which has `size` cells.

    `spot` is the place of every cell, in cells; `order` are the orders that are averaged, and
    `gain` is the response of the mean over a cell to each of them.
    """

    size: int
    spot: Float[np.ndarray, " n"]
    order: Int[np.ndarray, " orders"]
    gain: Complex[np.ndarray, " orders"]

    @classmethod
    def of(
        cls, turns: Float[np.ndarray, " n"], order: Int[np.ndarray, " orders"], size: int
    ) -> "_Turn":
        """Return the places of cells at an angle of `turns`."""
        spot, share = np.mod(turns, 1.0) * size, (np.arange(16) + 0.5) / 16
        off = np.histogram(spot - np.minimum(spot.astype(int), size - 1), 16, (0, 1))[0]
        gain = np.exp(2j * np.pi * np.outer(order, share) / size) @ (off / off.sum())
        return cls(size, spot, order, gain)

    def curve(self, waves: Complex[np.ndarray, " orders"]) -> Float[np.ndarray, " n"]:
        """Return the sum of waves at all cells."""
        fine = 8 if self.size < 2**14 else 2
        whole = np.zeros(self.size // 2 + 1, complex)
        whole[self.order] = waves * (fine * self.size / 2)
        dense = np.fft.irfft(whole, fine * self.size)
        return np.interp(fine * self.spot, np.arange(len(dense)), dense, period=len(dense))

    def average(self, error: Float[np.ndarray, " n"]) -> Complex[np.ndarray, " orders"]:
        """Return the waves of the synchronous average of an error."""
        cell = np.minimum(self.spot.astype(int), self.size - 1)
        count = np.maximum(np.bincount(cell, minlength=self.size), 1)
        waves = np.fft.rfft(np.bincount(cell, error, self.size) / count) * 2 / self.size
        return waves[self.order] / self.gain


def _harmonics(
    core: MixedFit, ratio: Fraction, told: Sequence[Order], runs: list[CellRun], orders: Averaged
) -> tuple[np.ndarray, np.ndarray]:
    """Return the rows of `Measured.harmonics` of the flank of `runs`, and what they leave."""
    flank, speeds = runs[0].flank, np.array([1.0, float(ratio)])
    of_shaft = [orders.shaft == k for k in (0, 1)]
    phases = [np.concatenate([one.angles[k] for one in runs]) / REV for k in (0, 1)]
    sizes = np.rint(orders.cells / speeds).astype(int)
    turns = [_Turn.of(phases[k], orders.order[of_shaft[k]], int(sizes[k])) for k in (0, 1)]
    value: Any = np.zeros(len(orders.order), complex)
    for name, column in core.posterior.problem.index.items():
        if name.row in orders.fitted:
            place, factor = orders.fitted[name.row]
            factor *= S[flank] if name.differs else 1.0
            value[place] += factor * core.posterior.coefficients[column]
    error = np.concatenate([one.steady for one in runs])
    left = error - sum(turns[k].curve(value[of_shaft[k]]) for k in (0, 1))
    seen = np.flatnonzero(np.isfinite(left))  # a chord of the whole error would flatten its waves
    left = np.interp(np.arange(len(left)), seen, left[seen])
    for _ in range(_ROUNDS):
        for k, turn in enumerate(turns):
            added = turn.average(left)
            left = left - turn.curve(added)
            value[of_shaft[k]] += added
    cycles, std = orders.order * speeds[orders.shaft], _noise(runs, left, orders, speeds)
    if all(map(np.any, of_shaft)):
        std /= np.sqrt(_told_apart(cycles, of_shaft, phases[0]))
    for one in told:
        name = RowName(one.shaft, one.order, "cos")
        if one.flank == flank and name in orders.fitted:
            place = orders.fitted[name][0]
            std[place] = max(std[place], one.std_arcsec * ARCSEC)
    both = orders.order * ratio.denominator % ratio.numerator == 0
    driven = np.where(both, orders.order * ratio.denominator // ratio.numerator, 0)
    driven = np.where(orders.shaft, orders.order, driven)
    window = np.sqrt(12 * np.mean([one.variance for one in runs])) / orders.cells
    parts = np.stack([value.real, value.imag, std], axis=1) / np.sinc(cycles * window)[:, None]
    side, driving = np.full(len(cycles), flank_index(flank)), orders.order * of_shaft[0]
    return np.concatenate([np.stack([side, driving, driven], axis=1), parts], axis=1), left


def _told_apart(
    cycles: Float[np.ndarray, " orders"], of_shaft: Sequence[np.ndarray], turns: np.ndarray
) -> Float[np.ndarray, " orders"]:
    """Return the share of its variance that tells each order from the nearest of the other shaft.

    A run of few turns hardly tells orders of both shafts that are near.
    """
    apart = np.abs(cycles[of_shaft[0]][:, None] - cycles[of_shaft[1]])
    apart = np.round(np.concatenate([apart.min(axis=1), apart.min(axis=0)]), 6)
    different, which = np.unique(apart, return_inverse=True)
    waves = np.exp(2j * np.pi * np.outer(different, turns[:: -(-len(turns) // 2000)]))
    return np.maximum(1 - np.abs(waves.mean(axis=1)) ** 2, 0.05)[which]


def _noise(
    runs: list[CellRun], left: np.ndarray, orders: Averaged, speeds: np.ndarray
) -> np.ndarray:
    """Return the standard errors of the parts of all orders, from the spectrum of what is left."""
    from scipy.signal import welch  # imported here because it is slow and seldom needed

    at, cells, length = orders.order * speeds[orders.shaft], orders.cells, len(left)
    density = np.zeros(len(at))
    for piece in np.split(left, np.cumsum([len(one.error) for one in runs])[:-1]):
        # Low orders need long segments, high ones many.
        sizes = (min(2 * cells, len(piece)), min(cells // 4, len(piece)))
        fine, coarse = (np.interp(at, *welch(piece, cells, nperseg=one)) for one in sizes)
        density += np.where(at < _LOW, fine, coarse) * len(piece) / length
    kept = 1 - cells / length * np.sum(1 / speeds[np.unique(orders.shaft)])
    return np.sqrt(density * cells / length / max(kept, 0.1))


def _passes(runs: list[CellRun], ratio: float, turns: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the targets of the axis and the deviations there in all passes of runs.

    The targets are unequally spaced, since teeth are not: each is moved by up to half its distance.
    """
    number = np.arange(_SPREAD * min(turns, _MOST_TURNS))
    places = (number + 0.5 * np.mod(number * 0.618034, 1.0)) / _SPREAD
    found, seen = np.full((len(places), 2, _MOST_PASSES), np.nan), [0, 0]
    for run in runs:
        place, way = ratio * run.angles[0] / REV, flank_index(run.flank)
        up = np.argsort(place)
        first, last = place[up[[0, -1]]] // turns
        for period in np.arange(first, last + 1)[: _MOST_PASSES - seen[way]] * turns:
            value = np.interp(places + period, place[up], run.error[up], np.nan, np.nan)
            found[:, way, seen[way]] = value
            seen[way] += 1
    return places, found[..., : max(seen)]


def _approaches(shafts: Shafts) -> tuple[np.ndarray, np.ndarray]:
    """Return the places of a table and its deviations; readings of one approach count once."""
    up = np.sort(shafts.driving)
    edges = up[np.diff(up, prepend=-np.inf) > SAME * usual_step(shafts.driving)]
    found, seen = np.full((len(edges), 2, _MOST_PASSES), np.nan), np.zeros((len(edges), 2), int)
    for start, stop, flank in shafts.runs:
        target = np.searchsorted(edges, shafts.driving[start:stop], side="right") - 1
        first, way = np.flatnonzero(np.diff(target, prepend=-1)), flank_index(flank)
        total = np.add.reduceat(shafts.error[start:stop], first)
        means = total / np.diff(first, append=len(target))
        for place, mean in zip(target[first], means, strict=True):
            found[place, way, min(seen[place, way], _MOST_PASSES - 1)] = mean
            seen[place, way] += 1
    return abs(shafts.ratio) * edges / REV, found[..., : seen.max()]
