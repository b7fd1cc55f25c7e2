"""Pictures of a residual, and of a log before any fit: values over the angle and spectrum."""

from collections.abc import Sequence
from pathlib import PurePath

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ..base.errors import NoAnswerError
from ..base.units import ARCSEC, DEG, REV
from ..identify.records import FoundLine
from ..identify.result import Fit
from ..logs.encoder_log import EncoderLog
from ..logs.motion.flank_assignment import assigned_segments
from .curves import MOST_POINTS, ResidualSpectrum, mean_spectrum, residual_spectrum, thinned
from .style import FLANK_COLOURS, dots, driving_axis, heading, labelled, new_figure, panel, title

_LAGS = 60  # lags shown; a chosen value

Runs = Sequence[Float[np.ndarray, " _"]]
"""One array per run, of any length."""

Part = tuple[str, Float[np.ndarray, " _"], Float[np.ndarray, " _"]]
"""Flank of a run, its driving angles and its values, both in rad; runs have any length."""


def plot_residual(fit: Fit) -> Figure:
    """Plot the residual block means of a fit, and whether they are noise.

    The panels show the residual over the driving angle; the autocorrelation of the residual
    whitened by the noise model of the fit, with the band that contains 95 % of white noise at each
    lag; and the amplitude spectrum in cycles per driving revolution with the lines marked that the
    fit has left, and the level that noise alone would reach anywhere in 1 of 1000 logs.
    """
    figure, order = new_figure(7.6), len(fit.noise.coefficients)
    top, middle, bottom = figure.subplots(3, 1)
    source = PurePath(fit.source.split(", ")[0]).name
    heading(figure, "residual: what the fit leaves", fit.pair.name, source)
    pairs = zip(fit.curves, fit.residuals, strict=True)
    parts = [(curve.flank, curve.driving_angle, left) for curve, left in pairs]
    words = f"{fit.residual_rms_deg * DEG / ARCSEC:.3g}″ rms of averaged rows"
    draw_runs(top, parts, words, "residual [arcsec]")
    driving_axis(top)
    white = [fit.noise.whitened(left) for left in fit.residuals if len(left) > order]
    _draw_correlation(middle, white, order)
    spectrum = residual_spectrum(fit)
    if spectrum is None:
        bottom.set_axis_off()
        title(bottom, "no spectrum: the runs are too short")
    else:
        _draw_spectrum(bottom, spectrum, [one for one in fit.checks.lines if not one.joined])
    return figure


def plot_log(log: EncoderLog) -> Figure:
    """Plot the transmission error of a log as it was read, before any fit, and its spectrum.

    The upper panel has both flanks as the direction, the torque or the motion assigns them; gap,
    drift and delay are in it. The lower one is the mean spectrum of the runs, each less its mean.

    **Raises** `NoAnswerError` for a log without a run of 16 samples.
    """
    runs = [one for one in assigned_segments(log).segments if one.stop - one.start >= 16]
    if not runs:
        raise NoAnswerError("no run of this log has 16 samples; record a longer motion.")
    places = [(one.flank, slice(one.start, one.stop)) for one in runs]
    parts = [(f, log.driving_angle[rows], log.transmission_error[rows]) for f, rows in places]
    figure = new_figure(5.6)
    top, bottom = figure.subplots(2, 1)
    heading(figure, "transmission error before any fit", PurePath(log.source).name)
    words = "as it was read, with gap, drift and delay"
    draw_runs(top, parts, words, "transmission error [arcsec]")
    driving_axis(top)
    cycles, size = mean_spectrum([(angle / REV, error / ARCSEC) for _, angle, error in parts])
    _draw_amplitudes(bottom, cycles, size)
    title(bottom, "its spectrum: a peak is a wave that turn after turn repeats")
    bottom.set(yscale="log", xlim=(0.0, min(float(cycles[-1]), 200.0)))
    return figure


def draw_runs(ax: Axes, parts: Sequence[Part], words: str, y: str, *, rms: bool = False) -> None:
    """Draw values over driving angles as dots; the legend has their `rms` if wanted."""
    most, labels = max(MOST_POINTS // len(parts), 4), {f: f"flank {f}" for f, _, _ in parts}
    for flank in labels if rms else ():
        own = np.concatenate([values for other, _, values in parts if other == flank])
        labels[flank] += f": {np.sqrt(np.mean(own**2)) / ARCSEC:.3g}″ rms"
    for flank, angle, values in parts:
        dots(ax, *thinned(angle / DEG, values / ARCSEC, most), flank, labels[flank])
    panel(ax, words, y=y, keys=labelled(ax))


def _draw_correlation(ax: Axes, whitened: Runs, order: int) -> None:
    correlation, pairs = autocorrelation(whitened, _LAGS)
    lags = np.arange(1, len(correlation))
    band = 1.96 / np.sqrt(np.maximum(pairs[1:], 1))
    ax.fill_between(lags, -band, band, color="0.85", linewidth=0, label="95 % of white noise")
    ax.vlines(lags, 0.0, correlation[1:], color=FLANK_COLOURS["A"], linewidth=1.2)
    ax.axhline(0.0, color="0.1", linewidth=0.6)
    outside = int(np.count_nonzero(np.abs(correlation[1:]) > band))
    share = f"{outside} of {len(lags)} lags outside"
    reach = max(0.1, 1.15 * float(np.max(np.abs(correlation[1:]), initial=0.0)))
    ax.set(ylim=(-reach, reach), xlim=(0.0, len(lags) + 1.0))
    words = f"whitened by an autoregression of order {order}: {share}"
    panel(ax, words, x="lag [rows]", y="autocorrelation", keys=labelled(ax))


def _draw_spectrum(ax: Axes, spectrum: ResidualSpectrum, lines: Sequence[FoundLine]) -> None:
    _draw_amplitudes(ax, spectrum.cycles, spectrum.size)
    label = "noise alone reaches this in 1 of 1000 logs"
    ax.plot(spectrum.cycles, spectrum.level, "--", color="0.4", lw=1.0, label=label)
    top = float(max(spectrum.size.max(), spectrum.level.max()))
    for line in lines:
        point = (line.cycles_per_rev, line.amplitude_arcsec)
        style = {"color": FLANK_COLOURS["B"], "markerfacecolor": "none", "elinewidth": 0.9}
        ax.errorbar(*point, line.amplitude_std_arcsec, fmt="o", markersize=5, capsize=2, **style)
        words = f"{line.cycles_per_rev:.4g}"
        ax.annotate(words, point, (0, 7), textcoords="offset points", ha="center", fontsize="small")
        top = max(top, line.amplitude_arcsec)
    panel(ax, spectrum.words, keys=labelled(ax), legend_rows=1)
    ax.set(xlim=(0.0, float(spectrum.cycles[-1])), ylim=(0.0, 1.25 * top))


def _draw_amplitudes(
    ax: Axes, cycles: Float[np.ndarray, " f"], arcsec: Float[np.ndarray, " f"]
) -> None:
    ax.plot(*thinned(cycles, arcsec), color=FLANK_COLOURS["A"], linewidth=0.8)
    panel(ax, x="cycles per driving revolution", y="amplitude [arcsec]")


def autocorrelation(
    white: Runs, lags: int
) -> tuple[Float[np.ndarray, " lags"], Float[np.ndarray, " lags"]]:
    """Return the autocorrelation at lags 0 … `lags`, and the number of pairs at each lag.

    A pair of values is always from one run; the products of all runs are averaged.
    """
    lags = min(lags, max((len(run) for run in white), default=1) - 1)
    products, pairs = np.zeros(lags + 1), np.zeros(lags + 1)
    for run in filter(len, white):
        products += np.correlate(np.pad(run, (0, lags)), run, "valid")
        pairs += np.maximum(len(run) - np.arange(lags + 1), 0)
    mean = products / np.maximum(pairs, 1)
    return (mean / mean[0] if mean[0] > 0 else mean), pairs
