"""Pictures of a fit and of a single curve of the transmission error."""

from pathlib import PurePath

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from ..base.numerics.quantiles import NORMAL_95
from ..base.units import ARCSEC, DEG
from ..identify.result import Fit
from ..kinematics.te_curve import TECurve
from .curves import MOST_POINTS, thinned
from .style import (
    FLANK_COLOURS,
    MODEL_COLOUR,
    SIGNS,
    Unit,
    driving_axis,
    figure_of,
    grid,
    heading,
    legend,
    new_figure,
    title,
    unit_size,
)

_BREAK = 2.5
"""The fitted line breaks where samples are left out over more than this many steps (chosen)."""

_FAR_DEG = 30.0
"""It breaks too between points that are farther apart, because a chord is not the fit (chosen)."""

CurveAndResidual = tuple[TECurve, Float[np.ndarray, " _"]]
"""A curve with its residual, rad."""


def plot_fit(
    fit: Fit, *, unit: Unit = "arcsec", span_deg: tuple[float, float] | None = None
) -> Figure:
    """Plot measured and fitted transmission error in one panel per flank, and the residual below.

    If the log has several speeds, a last panel shows the gap at each of them. Points are rows,
    averages of some consecutive samples. The line is the fitted value at these points, including
    drift and encoder errors: measured value minus residual. All panels over the driving angle
    have the same axis.

    **Arguments**
    - `fit`: result of a fit.
    - `unit`: unit of the transmission error, "arcsec" or "deg"; the residual is always in arcsec.
    - `span_deg`: first and last driving angle to show, deg.
    """
    size = unit_size(unit)
    runs = _runs_in_span(fit, span_deg)
    flanks = [flank for flank in ("A", "B") if any(curve.flank == flank for curve, _ in runs)]
    gaps, panels = fit.checks.gap_by_speed, len(flanks) + 1
    figure = new_figure(2.3 * (panels + bool(gaps)))
    places = figure.add_gridspec(panels + bool(gaps), 1)
    axes = [figure.add_subplot(places[0])]
    axes += [figure.add_subplot(places[row], sharex=axes[0]) for row in range(1, panels)]
    for ax in axes[:-1]:
        ax.tick_params(labelbottom=False)
    if gaps:
        _draw_gaps(figure.add_subplot(places[panels]), fit)
    for ax, flank in zip(axes[:-1], flanks, strict=True):
        _draw_flank(ax, [run for run in runs if run[0].flank == flank], size)
        ax.set_ylabel(f"TE, flank {flank} [{SIGNS[unit]}]")
    heading(figure, "transmission error and its fit", fit.pair.name, PurePath(fit.source).name)
    _draw_residuals(axes[-1], runs, flanks)
    title(axes[-1], f"residual ({fit.residual_rms_deg * DEG / ARCSEC:.3g}″ rms of averaged rows)")
    for ax in axes:
        grid(ax)
    if span_deg is not None:
        axes[-1].set_xlim(*span_deg)
    driving_axis(axes[-1])
    return figure


def _draw_gaps(ax: Axes, fit: Fit) -> None:
    """Draw the gap at each speed of the log with 95 % intervals, and the gap of the whole log."""
    gaps, whole = fit.checks.gap_by_speed, fit.checks.gap_over_angles_covered.value
    bars = ax.errorbar(
        [one.speed_rpm for one in gaps],
        [one.value for one in gaps],
        yerr=[NORMAL_95 * one.std for one in gaps],
        fmt="o",
        color=MODEL_COLOUR,
        markersize=4,
        capsize=3,
    )
    bars[0].set_label("at speeds of the log, 95 % interval")
    handles: list[Line2D] = [bars[0]]
    if whole is not None:
        label = f"over the angles covered: {whole:.4f}°"
        handles.append(ax.axhline(whole, color="0.5", linewidth=0.8, label=label))
    ax.set_ylabel("gap [° driven]")
    ax.set_xlabel("speed of the driving shaft [rpm]")
    title(ax, "gap by speed, beside the delay")
    grid(ax)
    legend(ax, handles)


def _draw_flank(ax: Axes, runs: list[CurveAndResidual], size: float) -> None:
    points = MOST_POINTS // len(runs)
    steps = np.concatenate([np.diff(curve.time) for curve, _ in runs])
    longest = _BREAK * float(np.median(steps)) if len(steps) else np.inf
    handles = []
    for curve, residual in runs:
        angle, error = curve.driving_angle / DEG, curve.transmission_error / size
        handles = _dots(ax, *thinned(angle, error, points), curve.flank, "measured")
        fitted, far = error - residual / size, np.abs(np.diff(angle)) > _FAR_DEG
        breaks = np.flatnonzero(far | (np.diff(curve.time) > longest)) + 1
        line = np.insert(angle, breaks, angle[breaks]), np.insert(fitted, breaks, np.nan)
        handles += ax.plot(
            *thinned(*line, points), color=MODEL_COLOUR, linewidth=0.5, marker=",", label="fitted"
        )
    legend(ax, handles)


def _draw_residuals(ax: Axes, runs: list[CurveAndResidual], flanks: list[str]) -> None:
    points = MOST_POINTS // len(runs)
    handles = []
    for flank in flanks:
        flank_runs = [run for run in runs if run[0].flank == flank]
        rms = np.sqrt(np.mean(np.concatenate([residual for _, residual in flank_runs]) ** 2))
        label = f"flank {flank}: {rms / ARCSEC:.3g}″ rms"
        lines = [
            _dots(ax, *thinned(curve.driving_angle / DEG, residual / ARCSEC, points), flank, label)
            for curve, residual in flank_runs
        ]
        handles += lines[0]
    ax.set_ylabel("residual [arcsec]")
    legend(ax, handles)


def _dots(
    ax: Axes, x: Float[np.ndarray, " n"], y: Float[np.ndarray, " n"], flank: str, label: str
) -> list[Line2D]:
    style = {"color": FLANK_COLOURS[flank], "markersize": 4, "markeredgewidth": 0, "alpha": 0.6}
    return ax.plot(x, y, ".", label=label, **style)


def _runs_in_span(fit: Fit, span_deg: tuple[float, float] | None) -> list[CurveAndResidual]:
    """Return all runs with their residuals, or their parts between two driving angles in deg."""
    runs = list(zip(fit.curves, fit.residuals, strict=True))
    if span_deg is None:
        return runs
    low, high = span_deg
    parts = []
    for curve, residual in runs:
        inside = (curve.driving_angle >= low * DEG) & (curve.driving_angle <= high * DEG)
        if inside.any():
            part = TECurve(
                curve.flank,
                curve.driving_angle[inside],
                curve.transmission_error[inside],
                curve.time[inside],
            )
            parts.append((part, residual[inside]))
    if not parts:
        angles = np.concatenate([curve.driving_angle for curve, _ in runs]) / DEG
        raise ValueError(
            f"Argument `span_deg` must overlap the fitted {angles.min():.6g}° …"
            f" {angles.max():.6g}°, but is {low:g}° … {high:g}°."
        )
    return parts


def plot_te(curve: TECurve, *, ax: Axes | None = None, unit: Unit = "arcsec") -> Figure:
    """Plot the transmission error over the driving angle.

    **Arguments**
    - `curve`: one run on one flank.
    - `ax`: axes to draw on; by default a new figure.
    - `unit`: unit of the transmission error, "arcsec" or "deg".
    """
    size = unit_size(unit)
    if ax is None:
        ax = new_figure(3.6).add_subplot()
    x, y = thinned(curve.driving_angle / DEG, curve.transmission_error / size)
    ax.plot(x, y, color=FLANK_COLOURS[curve.flank], linewidth=0.8, label=f"flank {curve.flank}")
    ax.set_ylabel(f"transmission error [{SIGNS[unit]}]")
    title(ax, f"transmission error, flank {curve.flank}")
    grid(ax)
    driving_axis(ax)
    return figure_of(ax)
