"""Accuracy of a drive in the terms of standards, from the measured transmission error of a fit.

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
from jaxtyping import Float

from ..base.errors import NoAnswerError
from ..base.files.text_tables import key_values, listed, text_table
from ..base.results import TextResult
from ..base.units import ARCSEC, REV
from ..kinematics.accuracy import (
    AXIS,
    SINGLE_FLANK,
    axis_numbers,
    perfect_axis,
    single_flank_numbers,
)
from ..kinematics.flank_model import flank_index
from ..logs.channel.speed import SAME, usual_step
from ..model.mixed_fit import MixedFit, residuals
from ..model.rows import SHAFTS, RowName, S, Shafts
from ..pair.gear_pair import Drive, GearPair
from ..pair.schema import Flank
from .orders import Order

STATEMENT = "a pair in its machine, no master gear: not a conformity statement"

_PER_PITCH, _PER_TURN, _HIGHEST, _MOST_ORDERS = (4, 16), (64, 720), 0.4, 1024
"""Fewest and most cells in a pitch, or in a turn without teeth; highest order in cells in a turn;
most orders of a shaft (chosen)."""

_TURNS, _ROUNDS, _LOW = 2.0, 8, 12
"""Turns of a shaft that tell its average; rounds that separate the shafts; orders below which the
noise is resolved order by order (chosen)."""

_PASSES, _TARGETS, _MOST_PASSES, _MOST_TURNS, _SPREAD = 5, 8, 100, 100, 12
"""Passes each way and targets in a turn that ISO 230-2 asks for; most passes and turns of the axis
that are kept, and targets in a turn of the axis while it runs (chosen)."""

_POINTS, _MOST_POINTS = 16, 2**18
"""Points in a pitch, and in a period, at which curves are looked at (chosen)."""


class Run(NamedTuple):
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


class Orders(NamedTuple):
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
    teeth, ends = (pair.driving.teeth, _PER_PITCH) if isinstance(pair, GearPair) else (1, _PER_TURN)
    running = [np.abs(first.speed[run.start : run.stop]) for run in first.runs]
    speed = float(np.median(np.concatenate(running)))
    cells = teeth * int(np.clip(REV / (speed * first.interval_s) / teeth / 2, *ends))
    most = np.minimum(_HIGHEST * cells / np.array([1.0, ratio]), _MOST_ORDERS) * (turns >= _TURNS)
    driving, driven = (np.arange(1, int(one) + 1) for one in most)
    if len(driving):  # what both shafts repeat counts with the driving shaft
        driven = driven[driven * ratio.numerator % ratio.denominator != 0]
    shaft = np.repeat([0, 1], [len(driving), len(driven)])
    orders = Orders(shaft, np.concatenate([driving, driven]), cells, {})
    for wave in core.waves:
        cycles = wave.driving + wave.driven * ratio if wave.shaft in (*SHAFTS, "mesh") else 0
        own = (0, cycles) if cycles == int(cycles) and len(driving) else (1, wave.driven)
        for place in np.flatnonzero((shaft == own[0]) & (orders.order == float(own[1]))):
            factor = np.exp(1j * wave.driven * first.nominal[1])
            orders.fitted[wave.row("cos")] = int(place), factor
            orders.fitted[wave.row("sin")] = int(place), -1j * factor
    runs = list(_runs(core, orders))
    sides = [own for own in ([r for r in runs if r.flank == flank] for flank in "AB") if own]
    parts = [_harmonics(core, abs(pair.ratio), told, own, orders) for own in sides]
    places, readings = _passes(runs, float(ratio), ratio.numerator)
    scatter = float(np.std(np.concatenate([left for _, left in parts])))
    return Measured(np.concatenate([h for h, _ in parts]), readings, places, scatter, turns)


def _runs(core: MixedFit, orders: Orders) -> Iterator[Run]:
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
            yield Run(flank, angles, shown, steady, variance)


def _harmonics(
    core: MixedFit, ratio: Fraction, told: Sequence[Order], runs: list[Run], orders: Orders
) -> tuple[np.ndarray, np.ndarray]:
    """Return the rows of `Measured.harmonics` of the flank of `runs`, and what they leave."""
    posterior, side = core.posterior, "AB".index(runs[0].flank)
    phases = [np.concatenate([one.angles[k] for one in runs]) / REV for k in (0, 1)]
    rest, speeds = np.concatenate([one.steady for one in runs]), np.array([1.0, float(ratio)])
    sizes = np.rint(orders.cells / speeds).astype(int)
    spots = [np.mod(phase, 1.0) * size for phase, size in zip(phases, sizes, strict=True)]
    bins = [np.minimum(one.astype(int), size - 1) for one, size in zip(spots, sizes, strict=True)]
    own, share = [orders.order[orders.shaft == k] for k in (0, 1)], (np.arange(16) + 0.5) / 16
    gains = []
    for spot, bin_, order, size in zip(spots, bins, own, sizes, strict=True):
        off = np.histogram(spot - bin_, 16, (0, 1))[0]
        gains.append(np.exp(2j * np.pi * np.outer(order, share) / size) @ (off / off.sum()))

    def curve(place: int, waves: np.ndarray) -> np.ndarray:
        size, fine = sizes[place], 8 if sizes[place] < 2**14 else 2
        whole = np.zeros(size // 2 + 1, complex)
        whole[own[place]] = waves * (fine * size / 2)
        dense = np.fft.irfft(whole, fine * size)
        return np.interp(fine * spots[place], np.arange(len(dense)), dense, period=len(dense))

    value: Any = np.zeros(len(orders.order), complex)
    for name, column in posterior.problem.index.items():
        if name.row in orders.fitted:
            place, factor = orders.fitted[name.row]
            factor *= S[runs[0].flank] if name.differs else 1.0
            value[place] += factor * posterior.coefficients[column]
    rest = rest - sum(curve(k, value[orders.shaft == k]) for k in (0, 1))
    seen = np.flatnonzero(np.isfinite(rest))  # a chord of the whole error would flatten its waves
    rest = np.interp(np.arange(len(rest)), seen, rest[seen])
    for _ in range(_ROUNDS):
        for k, size in enumerate(sizes):
            count = np.maximum(np.bincount(bins[k], minlength=size), 1)
            waves = np.fft.rfft(np.bincount(bins[k], rest, size) / count) * 2 / size
            added = waves[own[k]] / gains[k]
            rest = rest - curve(k, added)
            value[orders.shaft == k] += added
    at, std = orders.order * speeds[orders.shaft], _noise(runs, rest, orders, speeds)
    if all(map(len, own)):  # a run of few turns hardly tells orders of both shafts that are near
        apart = np.abs(at[orders.shaft == 0][:, None] - at[orders.shaft == 1])
        apart = np.round(np.concatenate([apart.min(axis=1), apart.min(axis=0)]), 6)
        delta, which = np.unique(apart, return_inverse=True)
        waves = np.exp(2j * np.pi * np.outer(delta, phases[0][:: -(-len(rest) // 2000)]))
        std /= np.sqrt(np.maximum(1 - np.abs(waves.mean(axis=1)) ** 2, 0.05))[which]
    for one in told:
        name = RowName(one.shaft, one.order, "cos")
        if one.flank == runs[0].flank and name in orders.fitted:
            place = orders.fitted[name][0]
            std[place] = max(std[place], one.std_arcsec * ARCSEC)
    both = orders.order * ratio.denominator % ratio.numerator == 0
    driven = np.where(both, orders.order * ratio.denominator // ratio.numerator, 0)
    driven = np.where(orders.shaft, orders.order, driven)
    window = np.sqrt(12 * np.mean([one.variance for one in runs])) / orders.cells
    parts = np.stack([value.real, value.imag, std], axis=1) / np.sinc(at * window)[:, None]
    names = np.stack([np.full(len(at), side), orders.order * (orders.shaft == 0), driven], axis=1)
    return np.concatenate([names, parts], axis=1), rest


def _noise(runs: list[Run], rest: np.ndarray, orders: Orders, speeds: np.ndarray) -> np.ndarray:
    """Return the standard errors of the parts of all orders, from the spectrum of what is left."""
    from scipy.signal import welch  # imported here because it is slow and seldom needed

    at, cells, length = orders.order * speeds[orders.shaft], orders.cells, len(rest)
    density = np.zeros(len(at))
    for piece in np.split(rest, np.cumsum([len(one.error) for one in runs])[:-1]):
        # Low orders need long segments, high ones many.
        sizes = (min(2 * cells, len(piece)), min(cells // 4, len(piece)))
        fine, coarse = (np.interp(at, *welch(piece, cells, nperseg=one)) for one in sizes)
        density += np.where(at < _LOW, fine, coarse) * len(piece) / length
    kept = 1 - cells / length * np.sum(1 / speeds[np.unique(orders.shaft)])
    return np.sqrt(density * cells / length / max(kept, 0.1))


def _passes(runs: list[Run], ratio: float, turns: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the targets of the axis and the deviations there in all passes of runs.

    The targets are unequally spaced, since teeth are not: each is moved by up to half its distance.
    """
    number = np.arange(_SPREAD * min(turns, _MOST_TURNS))
    places = (number + 0.5 * np.mod(number * 0.618034, 1.0)) / _SPREAD
    found, seen = np.full((len(places), 2, _MOST_PASSES), np.nan), [0, 0]
    for run in runs:
        place, way = ratio * run.angles[0] / REV, "AB".index(run.flank)
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


@dataclass(frozen=True, eq=False)
class Accuracy(TextResult):
    """Accuracy of a drive: the object of schema `vttig.accuracy/1`."""

    record: dict[str, Any]
    headers = ("number", "as read [″]", "value [″]", "95 % interval [″]", "beside")

    def to_json(self) -> dict[str, Any]:
        """Return the object of schema `vttig.accuracy/1`."""
        return self.record

    @property
    def rows(self) -> list[list[str]]:
        """Cells of the table under `headers`: single flank, then the axis."""
        single, axis = self.record["single_flank"], self.record["axis"]["numbers"] or {}
        name = "{0[period]}, flank {0[flank]}, {1}".format
        found = {name(row, key): row[key] for row in single for key in SINGLE_FLANK}
        found |= {f"axis, {key}": axis[key] for key in AXIS if axis}
        return [[name, *_cells(one)] for name, one in found.items() if one is not None]

    @property
    def remarks(self) -> list[str]:
        """What the numbers are, and what is not told."""
        record, axis = self.record, self.record["axis"]
        said = [f"Single flank: {record['definition']}"] if record["single_flank"] else []
        return [*said, *filter(None, [axis["definition"]]), *record["open"]]

    def __str__(self) -> str:
        head = key_values([("log", self.record["source"])], title="accuracy")
        table = text_table(self.rows, self.headers)
        return "\n\n".join([head, table, *listed("notes", self.remarks)])


def _cells(one: dict[str, Any]) -> list[str]:
    read, value, low, high = (f"{one[f'{k}_arcsec']:.4g}" for k in _ENDS)
    beside = "" if one["value_um"] is None else f"{one['value_um']:.3g} µm"
    if one["noise_arcsec"] is not None:
        beside = f"noise {one['noise_arcsec']:.3g}″, {100 * one['noise_share']:.0f} %"
    return [read, value, f"{low} … {high}", beside]


def accuracy_of(found: Measured | None, pair: GearPair | Drive, name: str) -> Accuracy:
    """Return the accuracy of a drive, from the log `name`; see `vttig_jax.kinematics.accuracy`.

    **Raises** `NoAnswerError` if neither a shaft made enough turns nor an axis enough passes, and
    for a fit of a given model or of an older version, which has no averages of turns.
    """
    if found is None:
        said = "the run keeps no averages of turns: an older version made it, or it is the fit of"
        raise NoAnswerError(f"{said} a given flank model; fit the log anew.", where=name)
    radius = float(pair.reference_radii[1]) if isinstance(pair, GearPair) else None
    single = [row for flank in "AB" for row in _single_flank(pair, found, flank, radius)]
    axis, open_ = _axis(found)
    short = "Single flank: no shaft made {:g} turns while it ran, as an average needs."
    open_ += [] if len(found.harmonics) else [short.format(_TURNS)]
    if not single and not axis["numbers"]:
        raise NoAnswerError(" ".join(open_), where=name)
    head = {"schema": "vttig.accuracy/1", "source": name, "pair": pair.name}
    head |= {"statement": STATEMENT, "definition": _definition(pair, radius), "circle_mm": radius}
    return Accuracy(head | {"single_flank": single, "axis": axis, "open": open_})


def _definition(pair: Any, radius: float | None) -> str:
    text = (
        f"{STATEMENT}. F_is is the range of the transmission error averaged synchronously over the"
        " turns of a shaft; of the pair, of the sum of both averages over the hunting period."
    )
    return text + (
        " Without teeth there is no f_is."
        if radius is None
        else " f_is is the largest range within one pitch, of it all (1995) or without its long"
        " waves (2013), which are the short-wave part; f_l is the range of the long waves. Filter:"
        f" long waves are the harmonics below half a cycle in a pitch, {pair.driving.teeth / 2:g}"
        " cycles in a turn of the driving shaft. Lengths are arcs at the reference circle of the"
        f" driven gear, radius {radius:g} mm."
    )


def _single_flank(
    pair: GearPair | Drive, found: Measured, flank: str, radius: float | None
) -> Iterator[dict[str, Any]]:
    own = found.harmonics[found.harmonics[:, 0] == "AB".index(flank)]
    ratio, hunting = abs(pair.ratio), pair.hunting_turns
    driving, driven = own[:, 1:3].T.astype(int)
    whole = np.where(driving > 0, driving * hunting, driven * ratio.numerator)
    teeth = (pair.driving.teeth, pair.driven.teeth) if isinstance(pair, GearPair) else (0, 0)
    told = np.append(found.turns >= _TURNS, np.all(found.turns >= _TURNS))
    counts = (driving, driven, whole), (*teeth, teeth[0] * hunting), told
    for name, cycles, pitches, enough in zip(_PERIODS, *counts, strict=True):
        parts = pitches or 1
        each = max(2 * int(cycles.max(initial=0)) // parts + 2, _POINTS)
        if enough and parts * each <= _MOST_POINTS and len(own):
            value, short = own[:, 3] + 1j * own[:, 4], whole >= (teeth[0] or np.inf) * hunting
            points = parts * (each + each % 2)
            terms = single_flank_numbers(value, own[:, 5], cycles, pitches, points, short)
            numbers = {k: _number(v, radius) for k, v in zip(SINGLE_FLANK, terms.T, strict=True)}
            yield {"flank": flank, "period": name, **numbers}


_PERIODS, _ENDS = ("driving shaft", "driven shaft", "pair"), ("read", "value", "low95", "high95")


def _number(
    terms: Float[np.ndarray, "4"], radius: float | None = None, noise: float | None = None
) -> dict[str, Any] | None:
    """Return the object of a number as read, its value and interval, rad; None if undefined."""
    if np.isnan(terms).any():
        return None
    found = {f"{k}_arcsec": float(v) / ARCSEC for k, v in zip(_ENDS, terms, strict=True)}
    return found | {
        "value_um": None if radius is None else 1e3 * float(terms[1]) * radius,
        "noise_arcsec": None if noise is None else float(noise) / ARCSEC,
        "noise_share": None if noise is None else float(noise / max(terms[0], 1e-300)),
    }


def _axis(found: Measured) -> tuple[dict[str, Any], list[str]]:
    """Return the object `axis` of schema `vttig.accuracy/1`, and what is not told."""
    count = np.sum(np.isfinite(found.readings), axis=2)
    enough = np.all(count >= _PASSES, axis=1)
    wide = np.ptp(found.places[enough]) if enough.any() else np.inf
    full = enough.sum() >= max(3.0, _TARGETS * wide)
    used = enough if full else np.all(count >= 1, axis=1)
    record = {"numbers": None, "targets": int(used.sum()), "passes": 0, "definition": ""}
    if used.sum() < 3:
        return record, ["Axis: fewer than three targets were approached in both directions."]
    readings, count = found.readings[used], count[used]
    free, mean = np.maximum(count - 1, 0), np.nanmean(readings, axis=2)
    off = np.nansum((readings - mean[..., None]) ** 2, axis=2)
    if not full:  # one noise for all, of repeats if there are enough
        told = free.sum() >= _TARGETS
        noise = np.sqrt(off.sum() / free.sum()) if told else float(found.scatter)
        free, off = np.full(count.shape, 100), np.full(count.shape, 100 * noise**2)
    std = np.sqrt(off / free)
    terms = axis_numbers(mean, std, count, free)
    perfect = perfect_axis(count, free).mean(axis=0) * np.sqrt(np.mean(std**2))
    numbers = {k: _number(v, None, n) for k, v, n in zip(AXIS, terms.T, perfect, strict=True)}
    record |= {"numbers": numbers, "passes": int(count.min())}
    record["definition"] = (
        f"Axis, after ISO 230-2: {len(count)} targets of the driven shaft against the driving one,"
        f" at least {count.min()} passes in each direction, standard deviations with n − 1. The"
        " noise is what an axis without error would show with this scatter."
    )
    if full:
        return record, []
    record["numbers"] = numbers | {"R": None, "A": None}
    said = f"Axis: R and A need {_PASSES} passes each way at {_TARGETS} targets or more in a turn."
    return record, [said]
