"""Picture of a log with its posterior predictive intervals."""

from pathlib import PurePath

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ..base.units import ARCSEC
from ..posterior.summary.predictive import Predictive
from .style import (
    COLOURS,
    FLANK_COLOURS,
    MODEL_COLOUR,
    MOST_POINTS,
    SIGNS,
    Unit,
    driving_axis,
    grid,
    heading,
    legend,
    new_figure,
    thinned,
    title,
    unit_size,
)

_TURNS = 2.0  # driving turns shown by default; a chosen value


def plot_predictive(found: Predictive, *, unit: Unit = "arcsec", turns: float = _TURNS) -> Figure:
    """Plot block means with their 95 % predictive interval, and the residual's autocorrelation.

    The upper panels, one per flank, show the first turns of the longest run and mark block means
    outside the interval. The next panel shows the differences between measured and expected block
    means of all runs, with the interval. The last panel shows the autocorrelation of the residual,
    with the band that contains 95 % of the replicates at each lag.

    **Arguments**
    - `found`: predictive comparison.
    - `unit`: unit of the transmission error, "arcsec" or "deg".
    - `turns`: driving turns shown in the panels of the flanks.
    """
    size = unit_size(unit)
    if not turns > 0:
        raise ValueError(f"Argument `turns` must be positive, but is {turns:g}.")
    flanks = [f for f in ("A", "B") if any(curve.flank == f for curve in found.curves)]
    figure = new_figure(2.1 * (len(flanks) + 2))
    axes = figure.subplots(len(flanks) + 2, 1)
    for ax, flank in zip(axes, flanks, strict=False):
        _draw_flank(ax, found, flank, size, turns)
        ax.set_ylabel(f"TE, flank {flank} [{SIGNS[unit]}]")
        driving_axis(ax)
    _draw_difference(axes[-2], found, flanks)
    _draw_correlation(axes[-1], found)
    source = PurePath(found.posterior.fit.source.split(", ")[0]).name
    heading(figure, "posterior predictive", found.posterior.fit.pair.name, source)
    for ax in axes:
        grid(ax)
    return figure


def _draw_flank(ax: Axes, predictive: Predictive, flank: str, size: float, turns: float) -> None:
    runs = [k for k, curve in enumerate(predictive.curves) if curve.flank == flank]
    longest = max(runs, key=lambda k: len(predictive.curves[k]))
    curve = predictive.curves[longest]
    order = np.argsort(curve.driving_angle)
    angle = np.degrees(curve.driving_angle[order])
    whole = (angle[-1] - angle[0]) / 360.0
    if whole > turns:
        title(ax, f"first {turns:g} of {whole:.3g} turns of the longest run")
    order = order[angle <= angle[0] + 360.0 * turns]
    angle = angle[: len(order)]
    low, high, error = (
        values[order] / size
        for values in (predictive.low[longest], predictive.high[longest], curve.transmission_error)
    )
    colour = FLANK_COLOURS[flank]
    handles = [
        ax.fill_between(
            angle, low, high, color=colour, alpha=0.25, linewidth=0, label="95 % interval"
        ),
        *ax.plot(angle, error, ".", color=colour, markersize=3, label="measured"),
    ]
    outside = (error < low) | (error > high)
    if outside.any():
        style = {"color": MODEL_COLOUR, "markersize": 5, "markerfacecolor": "none"}
        handles += ax.plot(angle[outside], error[outside], "o", label="outside", **style)
    legend(ax, handles)


def _draw_difference(ax: Axes, predictive: Predictive, flanks: list[str]) -> None:
    count = max(4, MOST_POINTS // len(predictive.curves))
    handles, lines, runs = {}, [], (predictive.curves, predictive.centre, predictive.high)
    for curve, centre, high in zip(*runs, strict=True):
        order = np.argsort(curve.driving_angle)
        angle = np.degrees(curve.driving_angle[order])
        half = (high - centre)[order] / ARCSEC
        residual = (curve.transmission_error - centre)[order] / ARCSEC
        points = thinned(angle, residual, count)
        [dots] = ax.plot(
            *points, ".", color=FLANK_COLOURS[curve.flank], markersize=3, alpha=0.6, zorder=1
        )
        dots.set_label(f"flank {curve.flank}")
        handles[curve.flank] = dots
        for edge in (half, -half):
            lines = ax.plot(
                *thinned(angle, edge, count),
                color=MODEL_COLOUR,
                linewidth=0.8,
                label="95 % interval",
            )
    share = predictive.share
    measured, low, high = (100 * x for x in (share.measured, share.low, share.high))
    replicates = f"replicates {low:.1f} % … {high:.1f} %"
    title(ax, f"within 1.96 std of a draw: {measured:.1f} % ({replicates})")
    ax.set_ylabel("residual [arcsec]")
    driving_axis(ax)
    legend(ax, [*(handles[flank] for flank in flanks), *lines])


def _draw_correlation(ax: Axes, predictive: Predictive) -> None:
    correlation = predictive.correlation
    lags = np.arange(1, len(correlation) + 1)
    handles = [
        ax.fill_between(
            lags,
            predictive.correlation_low,
            predictive.correlation_high,
            color=COLOURS[1],
            alpha=0.4,
            linewidth=0,
            label="95 % of the replicates",
        ),
        *ax.plot(lags, correlation, ".-", color=COLOURS[0], linewidth=0.8, label="residual"),
    ]
    ax.axhline(0.0, color=MODEL_COLOUR, linewidth=0.6)
    title(ax, f"autocorrelation: {predictive.outside_lags} of {len(lags)} lags outside the band")
    ax.set_xlabel("lag [blocks]")
    ax.set_ylabel("autocorrelation")
    ax.set_xlim(0.5, len(lags) + 0.5)
    legend(ax, handles)
