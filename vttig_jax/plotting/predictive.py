"""Picture of a log beside what its posterior predicts."""

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

_TURNS = 2.0


def plot_predictive(found: Predictive, *, unit: Unit = "arcsec", turns: float = _TURNS) -> Figure:
    """Measured block means in their 95 % predictive interval, and the memory of the residual.

    Above, one panel a flank: the first turns of the longest run with the interval, means outside it
    marked. Then every mean less the expected one with the width of the interval, and the
    autocorrelation of the residual with the band that 95 % of the replicates keep at each lag.

    **Arguments**
    - `found`: the comparison.
    - `unit`: of the transmission error, "arcsec" or "deg".
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


def _draw_flank(ax: Axes, found: Predictive, flank: str, size: float, turns: float) -> None:
    own = [k for k, curve in enumerate(found.curves) if curve.flank == flank]
    longest = max(own, key=lambda k: len(found.curves[k]))
    curve = found.curves[longest]
    order = np.argsort(curve.driving_angle)
    angle = np.degrees(curve.driving_angle[order])
    order = order[angle <= angle[0] + 360.0 * turns]
    angle = angle[: len(order)]
    low, high, error = (
        part[order] / size
        for part in (found.low[longest], found.high[longest], curve.transmission_error)
    )
    colour = FLANK_COLOURS[flank]
    keys = [
        ax.fill_between(
            angle, low, high, color=colour, alpha=0.25, linewidth=0, label="95 % interval"
        ),
        *ax.plot(angle, error, ".", color=colour, markersize=3, label="measured"),
    ]
    outside = (error < low) | (error > high)
    if outside.any():
        style = {"color": MODEL_COLOUR, "markersize": 5, "markerfacecolor": "none"}
        keys += ax.plot(angle[outside], error[outside], "o", label="outside", **style)
    legend(ax, keys)


def _draw_difference(ax: Axes, found: Predictive, flanks: list[str]) -> None:
    most = max(4, MOST_POINTS // len(found.curves))
    keys, lines = {}, []
    for curve, centre, high in zip(found.curves, found.centre, found.high, strict=True):
        order = np.argsort(curve.driving_angle)
        angle = np.degrees(curve.driving_angle[order])
        half = (high - centre)[order] / ARCSEC
        away = (curve.transmission_error - centre)[order] / ARCSEC
        points = thinned(angle, away, most)
        [dots] = ax.plot(
            *points, ".", color=FLANK_COLOURS[curve.flank], markersize=3, alpha=0.6, zorder=1
        )
        dots.set_label(f"flank {curve.flank}")
        keys[curve.flank] = dots
        for edge in (half, -half):
            lines = ax.plot(
                *thinned(angle, edge, most),
                color=MODEL_COLOUR,
                linewidth=0.8,
                label="95 % interval",
            )
    shares = [100 * x for x in (found.share.measured, found.share.low, found.share.high)]
    share = "within 1.96 std of a draw: {:.1f} % (replicates {:.1f} % … {:.1f} %)"
    title(ax, share.format(*shares))
    ax.set_ylabel("residual [arcsec]")
    driving_axis(ax)
    legend(ax, [*(keys[flank] for flank in flanks), *lines])


def _draw_correlation(ax: Axes, found: Predictive) -> None:
    lags = np.arange(1, len(found.correlation) + 1)
    keys = [
        ax.fill_between(
            lags,
            found.correlation_low,
            found.correlation_high,
            color=COLOURS[1],
            alpha=0.4,
            linewidth=0,
            label="95 % of the replicates",
        ),
        *ax.plot(lags, found.correlation, ".-", color=COLOURS[0], linewidth=0.8, label="residual"),
    ]
    ax.axhline(0.0, color=MODEL_COLOUR, linewidth=0.6)
    title(ax, f"memory: {found.outside_lags} of {len(lags)} lags outside")
    ax.set_xlabel("lag [blocks]")
    ax.set_ylabel("autocorrelation")
    ax.set_xlim(0.5, len(lags) + 0.5)
    legend(ax, keys)
