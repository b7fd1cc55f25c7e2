"""Pictures of a residual, and of a log before any fit: values over the angle and spectrum."""

from collections.abc import Sequence
from pathlib import PurePath
from typing import Any

import numpy as np
from jaxtyping import Complex, Float, Int
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ..base.errors import NoAnswerError
from ..base.units import ARCSEC, DEG, REV
from ..identify.records import FoundLine
from ..identify.result import Fit
from ..logs.encoder_log import EncoderLog
from ..logs.lines.search import Line
from ..logs.motion.flank_assignment import assigned_segments
from .curves import MOST_POINTS, mean_spectrum, thinned
from .style import COLOURS, FLANK_COLOURS, driving_axis, grid, heading, legend, new_figure, title

_LAGS = 60  # lags shown; a chosen value
_MAX_FREQUENCIES = 20_000  # of the spectrum; a chosen value
_CHUNK = 64  # frequencies evaluated together; a chosen value

Runs = Sequence[Float[np.ndarray, " _"]]
"""One array per run, of any length."""

Spectrum = Float[np.ndarray, " f"]


def plot_residual(fit: Fit) -> Figure:
    """Plot the residual block means of a fit with their spectrum and autocorrelation.

    The autocorrelation is that of the residual whitened by the noise model of the fit.
    """
    angles = [curve.driving_angle for curve in fit.curves]
    turns = [max(float(np.ptp(angle)) / REV, 1e-9) for angle in angles]
    rows = min(len(angle) / span for angle, span in zip(angles, turns, strict=True))
    return residual_picture(
        angles,
        fit.residuals,
        highest=float(np.clip(rows / 3, 1.5, max(20.0, 1.2 * fit.model.highest_order))),
        whitened=[
            fit.noise.whitened(residual)
            for residual in fit.residuals
            if len(residual) > len(fit.noise.coefficients)
        ],
        order=len(fit.noise.coefficients),
        lines=[one for one in fit.checks.lines if not one.joined],
        labels=[curve.flank for curve in fit.curves],
        name=fit.pair.name,
        source=PurePath(fit.source.split(", ")[0]).name,
    )


def plot_log(log: EncoderLog) -> Figure:
    """Plot the transmission error of a log as it was read, before any fit, and its spectrum.

    The upper panel has both flanks as the direction, the torque or the motion assigns them; gap,
    drift and delay are in it. The lower one is the mean spectrum of the runs, each less its mean.

    **Raises** `NoAnswerError` for a log without a run of 16 samples.
    """
    runs = [one for one in assigned_segments(log).segments if one.stop - one.start >= 16]
    if not runs:
        raise NoAnswerError("no run of this log has 16 samples; record a longer motion.")
    angles = [log.driving_angle[one.start : one.stop] for one in runs]
    errors = [log.transmission_error[one.start : one.stop] for one in runs]
    figure = new_figure(5.6)
    top, bottom = figure.subplots(2, 1)
    heading(figure, "transmission error before any fit", PurePath(log.source).name)
    _draw_residual(top, angles, errors, [one.flank for one in runs])
    title(top, "as it was read, with gap, drift and delay")
    top.set_ylabel("transmission error [arcsec]")
    pairs = zip(angles, errors, strict=True)
    cycles, size = mean_spectrum([(a / REV, (e - e.mean()) / ARCSEC) for a, e in pairs])
    _draw_amplitudes(bottom, cycles, size)
    title(bottom, "its spectrum: a peak is a wave that turn after turn repeats")
    bottom.set_yscale("log")
    bottom.set_xlim(0.0, min(float(cycles[-1]), 200.0))
    return figure


def residual_picture(
    angles: Runs,
    residuals: Runs,
    *,
    highest: float,
    whitened: Runs,
    order: int,
    lines: Sequence[Line | FoundLine] = (),
    labels: Sequence[str] | None = None,
    name: str = "",
    source: str = "",
) -> Figure:
    """Plot a residual, which should have no structure, no autocorrelation and no lines.

    The panels show the residual over the driving angle; the autocorrelation of the whitened
    residual with the band that contains 95 % of white noise at each lag; and the amplitude spectrum
    in cycles per driving revolution with the lines marked. The angle steps are unequal, so the
    spectrum is a least-squares fit of a sine, a cosine and the means of the runs at each frequency.

    **Arguments**
    - `angles`, `residuals`: arrays in rad for each run, rows in time order.
    - `highest`: highest frequency of the spectrum, cycles per revolution.
    - `whitened`: residuals of each run, whitened by an autoregression of this `order`.
    - `lines`: lines to mark, from `find_lines`.
    - `labels`: labels of the runs; the flanks "A" and "B" have colours of their own.
    - `name`, `source`: parts of the heading.
    """
    labels = [""] * len(angles) if labels is None else labels
    if not angles or not len(angles) == len(residuals) == len(labels):
        raise ValueError(
            "Argument `residuals` must hold one array for each of at least one run, but there are"
            f" {len(angles)} angles, {len(residuals)} residuals and {len(labels)} labels."
        )
    figure = new_figure(7.6)
    top, middle, bottom = figure.subplots(3, 1)
    heading(figure, "residual, which should look like noise", name, source)
    _draw_residual(top, angles, residuals, labels)
    _draw_correlation(middle, whitened, order)
    _draw_spectrum(bottom, angles, residuals, highest, lines)
    return figure


def _draw_residual(ax: Axes, angles: Runs, residuals: Runs, labels: Sequence[str]) -> None:
    handles = {}
    for angle, residual, label in zip(angles, residuals, labels, strict=True):
        points = thinned(angle / DEG, residual / ARCSEC, max(MOST_POINTS // len(angles), 4))
        style = {
            "color": FLANK_COLOURS.get(label, COLOURS[3]),
            "markersize": 3,
            "markeredgewidth": 0,
            "alpha": 0.6,
        }
        words = f"flank {label}" if label in FLANK_COLOURS else label
        [handles[label]] = ax.plot(*points, ".", label=words, **style)
    rms = np.sqrt(np.mean(np.concatenate(list(residuals)) ** 2)) / ARCSEC
    title(ax, f"{rms:.3g}″ rms of averaged rows")
    ax.set_ylabel("residual [arcsec]")
    driving_axis(ax)
    grid(ax)
    if any(handles):
        legend(ax, [handle for label, handle in handles.items() if label])


def _draw_correlation(ax: Axes, whitened: Runs, order: int) -> None:
    correlation, pairs = autocorrelation(whitened, _LAGS)
    lags = np.arange(1, len(correlation))
    band = 1.96 / np.sqrt(np.maximum(pairs[1:], 1))
    ax.fill_between(lags, -band, band, color="0.85", linewidth=0, label="95 % of white noise")
    ax.vlines(lags, 0.0, correlation[1:], color=FLANK_COLOURS["A"], linewidth=1.2)
    ax.axhline(0.0, color="0.1", linewidth=0.6)
    outside = int(np.count_nonzero(np.abs(correlation[1:]) > band))
    share = f"{outside} of {len(lags)} lags outside"
    title(ax, f"whitened by an autoregression of order {order}: {share}")
    reach = max(0.1, 1.15 * float(np.max(np.abs(correlation[1:]), initial=0.0)))
    ax.set_ylim(-reach, reach)
    ax.set_xlim(0.0, len(lags) + 1.0)
    ax.set_ylabel("autocorrelation")
    ax.set_xlabel("lag [rows]")
    grid(ax)
    legend(ax, ax.collections[:1])


def _draw_spectrum(
    ax: Axes, angles: Runs, residuals: Runs, highest: float, lines: Sequence[Line | FoundLine]
) -> None:
    cycles, amplitude = amplitude_spectrum(angles, residuals, highest)
    _draw_amplitudes(ax, cycles, amplitude / ARCSEC)
    top = float(np.max(amplitude / ARCSEC, initial=0.0))
    for line in lines:
        point = (line.cycles_per_rev, line.amplitude_arcsec)
        style = {"color": FLANK_COLOURS["B"], "markerfacecolor": "none", "elinewidth": 0.9}
        ax.errorbar(*point, line.amplitude_std_arcsec, fmt="o", markersize=5, capsize=2, **style)
        words = f"{line.cycles_per_rev:.4g}"
        ax.annotate(words, point, (0, 7), textcoords="offset points", ha="center", fontsize="small")
        top = max(top, line.amplitude_arcsec)
    count = f"{len(lines)} line{'' if len(lines) == 1 else 's'} found"
    title(ax, count if lines else "no line that the noise does not explain")
    ax.set_xlim(0.0, highest)
    ax.set_ylim(0.0, 1.25 * top if top > 0 else 1.0)


def _draw_amplitudes(ax: Axes, cycles: Spectrum, arcsec: Spectrum) -> None:
    ax.plot(*thinned(cycles, arcsec), color=FLANK_COLOURS["A"], linewidth=0.8)
    ax.set_ylabel("amplitude [arcsec]")
    ax.set_xlabel("cycles per driving revolution")
    grid(ax)


def autocorrelation(
    white: Runs, lags: int
) -> tuple[Float[np.ndarray, " lags"], Float[np.ndarray, " lags"]]:
    """Return the autocorrelation at lags 0 … `lags`, and the number of pairs at each lag.

    A pair of values is always from one run; the products of all runs are averaged.
    """
    lags = min(lags, max((len(run) for run in white), default=1) - 1)
    products, pairs = np.zeros(lags + 1), np.zeros(lags + 1)
    for run in white:
        for lag in range(min(lags + 1, len(run))):
            products[lag] += run[lag:] @ run[: len(run) - lag]
            pairs[lag] += len(run) - lag
    mean = products / np.maximum(pairs, 1)
    return (mean / mean[0] if mean[0] > 0 else mean), pairs


def amplitude_spectrum(
    angles: Runs, residuals: Runs, highest: float
) -> tuple[Float[np.ndarray, " f"], Float[np.ndarray, " f"]]:
    """Return frequencies (cycles per revolution) and their least-squares amplitudes (rad).

    The lowest frequency is one cycle over all revolutions, which is also the resolution. The
    frequencies go up to `highest` in steps of a quarter of the resolution, or in larger steps if
    there would be more than 20 000.
    """
    turns = np.concatenate(list(angles)) / REV
    span = float(np.ptp(turns))
    if span * highest <= 1:
        return np.zeros(0), np.zeros(0)
    cycles = np.linspace(1 / span, highest, min(int(4 * span * highest), _MAX_FREQUENCIES))
    turns = turns - turns.mean()
    value = np.concatenate([run - np.mean(run) for run in residuals])
    starts = np.cumsum([0, *(len(run) for run in residuals)])[:-1]
    counts = np.array([len(run) for run in residuals])
    # For the frequencies f₀ + d of a block, exp(2πj f t) = exp(2πj f₀ t) · exp(2πj d t). The
    # distances d are the same in every block, so that few exponentials are needed.
    distances = np.exp(2j * np.pi * (cycles[:_CHUNK, None] - cycles[0]) * turns)
    amplitude = []
    for block in np.split(cycles, range(_CHUNK, len(cycles), _CHUNK)):
        trial = np.exp(2j * np.pi * block[0] * turns) * distances[: len(block)]
        amplitude.append(_amplitudes(trial, value, starts, counts))
    return cycles, np.concatenate(amplitude)


def _amplitudes(
    trial: Complex[np.ndarray, "k n"],
    value: Float[np.ndarray, " n"],
    starts: Int[np.ndarray, " r"],
    counts: Int[np.ndarray, " r"],
) -> Float[np.ndarray, " k"]:
    """Return the amplitude at each trial frequency from 2×2 normal equations.

    `trial` is exp(2πj f t), with one row per frequency. `starts` and `counts` are first row and
    number of rows of each run; the means of the runs are eliminated from the equations.
    """
    sums = np.add.reduceat(trial, starts, axis=1)
    power = trial.shape[1] - np.sum(np.abs(sums) ** 2 / counts, axis=1)
    square: Any = np.einsum("kn,kn->k", trial, trial) - np.sum(sums**2 / counts, axis=1)
    right: Any = trial @ value
    cc, ss, cs = 0.5 * (power + square.real), 0.5 * (power - square.real), 0.5 * square.imag
    determinant = np.maximum(cc * ss - cs**2, 1e-6 * trial.shape[1] ** 2)
    cosine = (ss * right.real - cs * right.imag) / determinant
    sine = (cc * right.imag - cs * right.real) / determinant
    return np.hypot(cosine, sine)
