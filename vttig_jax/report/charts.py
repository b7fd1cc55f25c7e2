"""What the charts of a report show: lines, bands, bars and marks as numbers."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from ..base.units import ARCSEC, DEG, REV
from ..identify.result import Fit
from ..pair.gear_pair import Flank
from ..plotting.curves import folded_turns, residual_spectrum, thinned
from ..runs.map_table import RunTable
from .content import RunContent

# The settings of the charts are chosen values.
_POINTS = 3000  # most points of a line, about three times the pixels of its width
_ROWS = 24  # of the table behind a line
_NEAR_DEG = 180.0  # shown on each side of the smallest gap

Values = Float[np.ndarray, " n"]
Runs = list[tuple[Values, Values, Values]]
"""Driving turns, transmission error and residual in arcsec of every run of a flank."""

_TURNS = "driving shaft [turns]"


@dataclass(frozen=True)
class Series:
    """One line, band (`y` to `upper`), mark or row of bars of a chart.

    `colour` is "A", "B", "fit", "band" or "mark", which a page makes a colour. `more` is label →
    values that a reading shows beside x and y.
    """

    name: str
    x: Values
    y: Values
    colour: str
    kind: str = "line"
    upper: Values | None = None
    more: dict[str, Any] = field(default_factory=dict)

    @property
    def rows(self) -> list[list[str]]:
        """Texts of x, y and `more` at 24 places at equal distances, or of every bar."""
        number = len(self.x) if self.kind == "bars" else min(len(self.x), _ROWS)
        picked = np.linspace(0, len(self.x) - 1, number).astype(int)
        cells = [[c[k] for c in (self.x, self.y, *self.more.values())] for k in picked]
        return [[v if isinstance(v, str) else f"{v:.6g}" for v in row] for row in cells]


@dataclass(frozen=True)
class Chart:
    """A chart: what the eye should see as its title, labels of the axes, and series.

    `ticks` names places of the x axis; without it, the axis has numbers.
    """

    title: str
    x: str
    y: str
    series: list[Series]
    remark: str = ""
    ticks: dict[int, str] | None = None

    @property
    def ends(self) -> tuple[float, float]:
        """Lowest and highest value; bars begin at zero."""
        tops = [one.y if one.upper is None else one.upper for one in self.series]
        lows = [one.y * (one.kind != "bars") for one in self.series]
        return float(np.nanmin(np.concatenate(lows))), float(np.nanmax(np.concatenate(tops)))


def charts_of(content: RunContent) -> dict[str, list[Chart]]:
    """Return the charts of a run by the section in which they stand."""
    fit, found = content.run.fit, content.map
    flanks: dict[Flank, Runs] = {}
    for curve, left in zip(fit.curves, fit.residuals, strict=True):
        run = curve.driving_angle / REV, curve.transmission_error / ARCSEC, left / ARCSEC
        flanks.setdefault(curve.flank, []).append(run)
    return {
        "error": [_over_log(fit, flanks), *_folded(fit)] if flanks else [],
        "backlash": [*_backlash(found)] if isinstance(found, RunTable) else [],
        "orders": [_orders(fit)] if fit.orders else [],
        "residual": [*_residual(fit, flanks)] if flanks else [],
    }


def _line(name: str, runs: Runs, value: Callable[[Values, Values], Values], colour: str) -> Series:
    """Return a line of all runs that breaks between them; each piece keeps its extremes."""
    points = max(_POINTS // len(runs), 4)
    parts = [thinned(turn, value(error, left), points) for turn, error, left in runs]
    x, y = (np.concatenate([np.append(part[k], np.nan) for part in parts])[:-1] for k in (0, 1))
    return Series(name, x, y, colour)


def _over_log(fit: Fit, flanks: dict[Flank, Runs]) -> Chart:
    """Return the transmission error of both flanks over the log, with the fit."""
    series = []
    for flank, runs in flanks.items():
        series.append(_line(f"flank {flank}, measured", runs, lambda error, left: error, flank))
        series.append(_line("fit", runs, lambda error, left: error - left, "fit"))
    errors = fit.flank_errors.values()
    sizes = " and ".join(f"{error.peak_to_peak_deg * DEG / ARCSEC:.4g}″" for error in errors)
    title = f"The fitted orders let the driven shaft lead and lag by {sizes}, peak to peak"
    told = any(error.significant for error in errors)
    title += "" if told else ", not above their noise"
    title += "; the distance between the flanks is the gap" if len(flanks) == 2 else ""
    return Chart(title, _TURNS, "transmission error [″]", series)


def _residual(fit: Fit, flanks: dict[Flank, Runs]) -> Iterator[Chart]:
    """Yield what the fit leaves over the log, and its spectrum beside that of noise alone."""
    rms, slow = fit.residual_rms_deg * DEG / ARCSEC, fit.noise.slow_share
    title = f"The fit leaves {rms:.3g}″ (rms of averaged rows)"
    remark = f"The fit takes it for noise. {100 * slow:.0f} % of its variance is slow, which means"
    remark += " that the rows before tell it; the intervals contain this."
    series = [_line(f"flank {f}", runs, lambda error, left: left, f) for f, runs in flanks.items()]
    yield Chart(title, _TURNS, "measured less fitted [″]", series, remark)
    found = residual_spectrum(fit)
    if found is not None:
        level = Series(
            "noise alone reaches this in 1 of 1000 logs", found.cycles, found.level, "fit"
        )
        series = [Series("residual", *thinned(found.cycles, found.size, _POINTS), "A"), level]
        title = found.words.capitalize()
        yield Chart(title, "cycles per turn of the driving shaft", "amplitude [″]", series)


def _folded(fit: Fit) -> Iterator[Chart]:
    """Yield the charts of the error over one turn of each shaft that made a whole turn."""
    for fold in folded_turns(fit):
        series = []
        for flank, mean in fold.measured.items():
            own = fold.fitted[flank]
            series.append(Series(f"flank {flank}, mean of all turns", fold.middle, mean, flank))
            series.append(Series(f"fitted orders of the {fold.shaft} shaft", fold.fine, own, "fit"))
        remark = f"Folded over {fold.turns:.3g} turns. Gap, drift, delay and what the other shafts"
        remark += " make are taken off as the fit has them."
        title = fold.words.capitalize()
        yield Chart(title, f"angle of the {fold.shaft} shaft [°]", "error [″]", series, remark)


def _backlash(found: RunTable) -> Iterator[Chart]:
    """Yield the gap over the hunting period, and around its smallest value."""
    angle, record = found.columns["driving_deg"], found.record
    title = "The gap as the fitted orders have it; the log does not tell where it is smallest"
    axes, least, marks = (_TURNS, "gap, angle of the driven shaft [°]"), record["smallest"], []
    if least:
        title = f"The gap is smallest, {least['backlash_deg']:.4f}°, at turn"
        title += f" {least['driving_deg'] / 360:.3f} of the hunting period"
        for end in ("smallest", "largest"):
            x, y = np.array([[record[end]["driving_deg"] / 360.0], [record[end]["backlash_deg"]]])
            marks.append(Series(f"{end} gap", x, y, "mark", "mark"))
    remark = "" if "critical" in record else "Draws of `vttig sample` add the band of this map."
    yield Chart(title, *axes, [*_gap(found, angle >= 0), *marks], remark)
    if least and record["span_turns"] * 360 > 4 * _NEAR_DEG:
        near = np.abs(angle - least["driving_deg"]) <= _NEAR_DEG
        yield Chart("One turn around the smallest gap", *axes, [*_gap(found, near), marks[0]])


def _gap(found: RunTable, shown: Bool[np.ndarray, " n"]) -> Iterator[Series]:
    """Yield the band and the line of a part of a map; each piece keeps its extremes."""
    columns = {name: values[shown] for name, values in found.columns.items()}
    turn, gap = columns["driving_deg"] / 360.0, columns["backlash_deg"]
    ends = [n for n in columns if n.startswith(("low", "high")) and n.endswith("_deg")][-2:]
    if ends:
        pieces = np.arange(0, len(turn), -(-len(turn) // (_POINTS // 3)))
        low = np.minimum.reduceat(columns[ends[0]], pieces)
        high = np.maximum.reduceat(columns[ends[1]], pieces)
        percent = f"{100 * found.record.get('probability', 0.95):.6g} %"
        name = f"{percent} {'band of the whole map' if 'critical' in found.record else 'interval'}"
        yield Series(name, turn[pieces], low, "band", "band", high)
    x, y = thinned(turn, gap, _POINTS)
    lengths = {"µm of arc": 1e3 * columns["backlash_mm"], "mm axial": columns["axial_mm"]}
    kept = np.searchsorted(turn, x)
    more = {label: v[kept] for label, v in lengths.items() if np.isfinite(v).all()}
    yield Series("gap, all fitted orders", x, y, "A", more=more)


def _orders(fit: Fit) -> Chart:
    """Return the amplitudes of all fitted orders of both flanks."""
    name = "{0.shaft} {0.order:.5g}".format
    names = list(dict.fromkeys(name(one) for one in fit.orders))
    series = []
    for flank, shift in (("A", -0.2), ("B", 0.2)):
        own = [one for one in fit.orders if one.flank == flank]
        more = {"order": [name(one) + " (noise)" * (not one.significant) for one in own]}
        more["standard error [″]"] = [f"{one.std_arcsec:.2g}" for one in own]
        place = np.array([names.index(name(one)) + shift * (len(fit.flanks) - 1) for one in own])
        size = np.array([one.amplitude_arcsec for one in own])
        series += [Series(f"flank {flank}", place, size, flank, "bars", more=more)] if own else []
    top = max(fit.orders, key=lambda one: one.amplitude_arcsec)
    title = f"The largest order is {name(top)}: {top.amplitude_arcsec:.3g}″"
    axes = "order: cycles in a turn of the shaft", "amplitude [″]"
    return Chart(title, *axes, series, ticks=dict(enumerate(names)))
