"""Pictures of a fit and of a single curve of the transmission error."""

from pathlib import PurePath

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ..base.units import ARCSEC, DEG
from ..identify.result import Fit
from ..kinematics.te_curve import TECurve
from .curves import MOST_POINTS, Folded, driving_turns, folded_turns, thinned
from .residual import draw_runs
from .style import (
    FLANK_COLOURS,
    MANY_TURNS,
    MODEL_COLOUR,
    SIGNS,
    Unit,
    dots,
    driving_axis,
    figure_of,
    heading,
    labelled,
    new_figure,
    panel,
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

    From 25 driving turns on, the panels show instead the error over a turn of each shaft, the mean
    over all its turns: measured, less all that the fit does not attribute to it, and its orders.

    If the log has several speeds, a last panel shows the gap at each of them. Points are rows,
    averages of some consecutive samples. The line is the fitted value at these points, including
    drift and encoder errors: measured value minus residual. All panels over the driving angle
    have the same axis.

    **Arguments**
    - `fit`: result of a fit.
    - `unit`: unit of the transmission error, "arcsec" or "deg"; the residual is always in arcsec.
    - `span_deg`: first and last driving angle to show, deg.
    """
    size, runs = unit_size(unit), _runs_in_span(fit, span_deg)
    many = span_deg is None and driving_turns(fit) >= MANY_TURNS
    folds = list(folded_turns(fit)) if many else []
    flanks = [flank for flank in ("A", "B") if any(curve.flank == flank for curve, _ in runs)]
    gaps, above = fit.checks.gap_by_speed, len(folds or flanks)
    count = above + 1 + bool(gaps)
    figure = new_figure(2.3 * count)
    panels = figure.subplots(count, 1)
    axes = panels[: above + 1]
    if gaps:
        _draw_gaps(panels[-1], fit)
    if folds:
        for ax, fold in zip(axes[:-1], folds, strict=True):
            _draw_fold(ax, fold, unit)
    else:
        for ax, flank in zip(axes[:-1], flanks, strict=True):
            ax.sharex(axes[-1])
            _draw_flank(ax, [run for run in runs if run[0].flank == flank], size)
            panel(ax, y=f"TE, flank {flank} [{SIGNS[unit]}]", keys=labelled(ax))
            ax.tick_params(labelbottom=False)
    heading(figure, "transmission error and its fit", fit.pair.name, PurePath(fit.source).name)
    words = f"residual ({fit.residual_rms_deg * DEG / ARCSEC:.3g}″ rms of averaged rows)"
    parts = [(curve.flank, curve.driving_angle, residual) for curve, residual in runs]
    draw_runs(axes[-1], parts, words, "residual [arcsec]", rms=True)
    if span_deg is not None:
        axes[-1].set_xlim(*span_deg)
    driving_axis(axes[-1])
    return figure


def _draw_fold(ax: Axes, fold: Folded, unit: Unit) -> None:
    """Draw the error over a turn of a shaft."""
    size = unit_size(unit) / ARCSEC
    for flank, mean in fold.measured.items():
        dots(ax, fold.middle, mean / size, flank, f"flank {flank}")
        ax.plot(fold.fine, fold.fitted[flank] / size, color=MODEL_COLOUR, linewidth=0.8)
    dotted = f"dots: mean of {fold.turns:.3g} turns, line: its orders in the fit"
    angle = f"angle of the {fold.shaft} shaft [°]; {dotted}"
    label = f"error [{SIGNS[unit]}]"
    panel(ax, fold.words, x=angle, y=label, keys=labelled(ax), legend_rows=1)
    ax.set(xlim=(0.0, 360.0), xticks=range(0, 361, 45))


def _draw_gaps(ax: Axes, fit: Fit) -> None:
    """Draw the gap at each speed of the log with 95 % intervals, and the gap of the whole log."""
    gaps, whole = fit.checks.gap_by_speed, fit.checks.gap_over_angles_covered.value
    speeds, values = [one.speed_rpm for one in gaps], [one.value for one in gaps]
    look = {"fmt": "o", "color": MODEL_COLOUR, "markersize": 4, "capsize": 3}
    bars = ax.errorbar(speeds, values, [1.96 * one.std for one in gaps], **look)
    bars[0].set_label("at speeds of the log, 95 % interval")
    if whole is not None:
        label = f"over the angles covered: {whole:.4f}°"
        ax.axhline(whole, color="0.5", linewidth=0.8, label=label)
    words, speed = "gap by speed, beside the delay", "speed of the driving shaft [rpm]"
    panel(ax, words, x=speed, y="gap [° driven]", keys=labelled(ax))


def _draw_flank(ax: Axes, runs: list[CurveAndResidual], size: float) -> None:
    points = max(4, MOST_POINTS // len(runs))  # fewer do not show the extremes of a run
    steps = np.concatenate([np.diff(curve.time) for curve, _ in runs])
    longest = _BREAK * float(np.median(steps)) if len(steps) else np.inf
    for curve, residual in runs:
        angle, error = curve.driving_angle / DEG, curve.transmission_error / size
        dots(ax, *thinned(angle, error, points), curve.flank, "measured")
        fitted, far = error - residual / size, np.abs(np.diff(angle)) > _FAR_DEG
        breaks = np.flatnonzero(far | (np.diff(curve.time) > longest)) + 1
        line = np.insert(angle, breaks, angle[breaks]), np.insert(fitted, breaks, np.nan)
        look = {"color": MODEL_COLOUR, "linewidth": 0.5, "marker": ",", "label": "fitted"}
        ax.plot(*thinned(*line, points), **look)


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
            parts.append((curve.part(inside), residual[inside]))
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
    label = f"transmission error [{SIGNS[unit]}]"
    panel(ax, f"transmission error, flank {curve.flank}", y=label)
    driving_axis(ax)
    return figure_of(ax)
