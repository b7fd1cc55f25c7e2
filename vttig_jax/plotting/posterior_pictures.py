"""Pictures of a posterior: every pair of coordinates with the ellipses of the fit, and the steps.

The trace shows the draws over the steps of each ensemble.
"""

from collections.abc import Sequence
from pathlib import PurePath
from textwrap import wrap

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from ..base.units import DEG
from ..posterior.summary.draws import GAPS
from ..posterior.summary.posterior import Posterior
from .style import COLOURS, MODEL_COLOUR, figure_legend, grid, heading, new_figure, with_margin

_BINS, _CELLS = 40, 30  # of the histograms in one and two dimensions; chosen values
_LABEL_WIDTH = 11  # letters in a line of a label, without the unit; chosen value
_MAX_DRAWS = 50_000  # draws used; a chosen value
_MARGINS_IN = (0.88, 0.44)  # below and above the panels, for labels and heading; chosen values

Limits = tuple[float, float]

_LEVELS = (0.68, 0.95)
"""Probability inside the ellipses."""


def plot_corner(posterior: Posterior, *, names: Sequence[str] | None = None) -> Figure:
    """Plot the draws of every pair of coordinates, and of each coordinate on the diagonal.

    Shades are densities of the draws. The lines are the Gaussian approximation of the fit
    (Laplace): ellipses that contain 68 % and 95 %, and its density on the diagonal. Lengths are in
    µm, encoder errors in arcsec, the backlash in degrees.

    **Arguments**
    - `posterior`: the draws.
    - `names`: coordinates to show; by default all physical ones.
    """
    names = posterior.physical if names is None else tuple(names)
    if not names:
        raise ValueError("Argument `names` must hold at least one coordinate, but is empty.")
    units = [picture_unit(posterior, name) for name in names]
    sizes, count = np.array([size for _, size in units]), len(names)
    draws = np.stack([posterior.values(name) for name in names], axis=1) / sizes
    draws = draws[:: max(1, len(draws) // _MAX_DRAWS)]
    value, covariance = _laplace(posterior, names, sizes)
    figure = new_figure(8.0 if count > 3 else 2.4 * count + 0.6)
    figure.set_layout_engine("none")  # one that measures the labels of all panels takes seconds
    below, above = (inch / figure.get_figheight() for inch in _MARGINS_IN)
    margins = {"left": 0.115, "right": 0.985, "bottom": below, "top": 1 - above}
    places = figure.add_gridspec(count, count, **margins, wspace=0.16, hspace=0.16)
    axes = np.full((count, count), None)
    ends = np.quantile(draws, [0.0005, 0.9995], axis=0).T.tolist()  # an axis has 99.9 % of them
    limits = [with_margin(low, high, 0.08) for low, high in ends]
    for row in range(count):
        for column in range(row + 1):
            shared = axes[row - 1, column] if row > column else None
            ax = axes[row, column] = figure.add_subplot(places[row, column], sharex=shared)
            if column == row:
                _draw_histogram(ax, draws[:, row], value[row], np.sqrt(covariance[row, row]))
                ax.set_xlim(*limits[row])
            else:
                pair = [column, row]
                _draw_density(ax, draws[:, pair], [limits[column], limits[row]])
                _draw_ellipses(ax, value[pair], covariance[np.ix_(pair, pair)])
            _ticks(ax, column == 0 and row > 0, row == count - 1, count)
    size = "small" if count <= 6 else "x-small"
    for index, (name, (unit, _)) in enumerate(zip(names, units, strict=True)):
        label = "\n".join(wrap(name.replace("_", " "), _LABEL_WIDTH)) + f" [{unit}]" * bool(unit)
        axes[count - 1, index].set_xlabel(label, fontsize=size)
        if index:
            axes[index, 0].set_ylabel(label, fontsize=size)
    name, source = posterior.fit.pair.name, PurePath(posterior.fit.source).name
    heading(figure, "posterior: the draws beside the fit", name, source)
    figure.align_ylabels(axes[1:, 0])
    figure.align_xlabels(axes[-1])
    keys = [
        Patch(color=COLOURS[0], alpha=0.45, label="draws"),
        Line2D([], [], color=MODEL_COLOUR, linewidth=0.9, label="fit (Laplace): 68 % and 95 %"),
        Line2D([], [], linestyle="none", label="x = e cos θ, y = e sin θ of size e, phase θ"),
    ]
    figure_legend(figure, keys, 1, loc="upper right", bbox_to_anchor=(0.98, 0.93))
    return figure


def picture_unit(posterior: Posterior, name: str) -> tuple[str, float]:
    """Return the unit of a coordinate in pictures, and the size of this unit in internal units."""
    unit = posterior.units[posterior.place(name)]
    if name in GAPS:
        return "°", DEG
    display = {"mm": ("µm", 1e-3), "rad": ("″", DEG / 3600), "s": ("µs", 1e-6)}
    return display.get(unit, ("" if unit in ("1", "log rad") else unit, 1.0))


def _laplace(
    posterior: Posterior, names: Sequence[str], sizes: Float[np.ndarray, " n"]
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, "n n"]]:
    """Return values and covariance of coordinates in the fit, in units of `sizes`.

    They are NaN for a coordinate that the fit does not have.
    """
    fit, value, covariance = posterior.fit, 0 * sizes + np.nan, np.full([len(sizes)] * 2, np.nan)
    own = [k for k, name in enumerate(names) if name in fit.covariance_names]
    there = [fit.covariance_names.index(names[k]) for k in own]
    value[own] = fit.values[there]
    covariance[np.ix_(own, own)] = fit.covariance[np.ix_(there, there)]
    return value / sizes, covariance / np.outer(sizes, sizes)


def _draw_histogram(ax: Axes, draws: Float[np.ndarray, " n"], value: float, std: float) -> None:
    heights, edges = np.histogram(draws, _BINS, density=True)
    ax.stairs(heights, edges, fill=True, color=COLOURS[0], alpha=0.45, linewidth=0)
    if std > 0:
        x = np.linspace(value - 4 * std, value + 4 * std, 121)
        y = np.exp(-0.5 * ((x - value) / std) ** 2) / (std * np.sqrt(2 * np.pi))
        ax.plot(x, y, color=MODEL_COLOUR, linewidth=0.9)
    ax.set_yticks([])
    ax.spines[["top", "right", "left"]].set_visible(False)


def _draw_density(ax: Axes, draws: Float[np.ndarray, "n 2"], limits: Sequence[Limits]) -> None:
    counts, across, up = np.histogram2d(draws[:, 0], draws[:, 1], _CELLS, limits)
    masked = np.ma.masked_equal(counts.T, 0)
    lowest = -0.15 * counts.max()
    ax.pcolormesh(across, up, masked, cmap="Blues", vmin=lowest, rasterized=True)
    ax.set(xlim=limits[0], ylim=limits[1])
    ax.spines[["top", "right"]].set_visible(False)


def _draw_ellipses(
    ax: Axes, value: Float[np.ndarray, "2"], covariance: Float[np.ndarray, "2 2"]
) -> None:
    if np.isnan(covariance).any():
        return
    values, vectors = np.linalg.eigh(covariance)
    turn = np.linspace(0, 2 * np.pi, 121)
    for level in _LEVELS:
        half = np.sqrt(-2 * np.log(1 - level)) * np.sqrt(np.maximum(values, 0.0))
        ring = vectors @ (half[:, None] * np.stack([np.cos(turn), np.sin(turn)]))
        ax.plot(value[0] + ring[0], value[1] + ring[1], color=MODEL_COLOUR, linewidth=0.9)


def _ticks(ax: Axes, left: bool, bottom: bool, count: int) -> None:
    intervals = 2 if count > 5 else 3
    ax.xaxis.set_major_locator(MaxNLocator(intervals))
    ax.tick_params(labelsize=6.5 if count > 5 else 8, length=2.5)
    ax.tick_params(axis="x", labelbottom=bottom, labelrotation=45 if count > 5 else 0)
    if ax.get_yticks().size:
        ax.yaxis.set_major_locator(MaxNLocator(intervals))
        ax.tick_params(axis="y", labelleft=left)
    for axis in (ax.xaxis, ax.yaxis):
        axis.get_offset_text().set_visible(False)
    ax.ticklabel_format(useOffset=False, style="plain")


_MAX_STEPS = 1000  # steps drawn; a chosen value
_MAX_WALKERS = 12  # walkers drawn per ensemble; a chosen value
_KEYS_PER_ROW = 5  # ensembles in one row of the legend; a chosen value

_PANEL_IN, _AROUND_IN = 1.1, 0.9
"""Height of a panel with its name, and of heading, label and legend; chosen values."""


def plot_trace(posterior: Posterior, *, names: Sequence[str] | None = None) -> Figure:
    """Plot every coordinate and the log density over the steps, one colour per ensemble.

    Thin lines are walkers, at most twelve per ensemble; a thick line is the mean over all walkers
    of an ensemble. Ensembles of the same posterior overlap and do not drift.

    **Arguments**
    - `posterior`: the draws.
    - `names`: coordinates of emcee to show; by default all.
    """
    chains = posterior.chains
    names = chains.header.names if names is None else tuple(names)
    if unknown := sorted(set(names) - set(chains.header.names)):
        raise ValueError(
            f"Argument `names` must hold coordinates of emcee, {', '.join(chains.header.names)},"
            f" but has {', '.join(unknown)}."
        )
    rows = [(*picture_unit(posterior, name), name) for name in names]
    panels = -(-(len(rows) + 1) // 2)
    figure = new_figure(_AROUND_IN + _PANEL_IN * panels)
    axes = figure.subplots(panels, 2, sharex=True, squeeze=False).T.ravel()
    for ax, (unit, size, name) in zip(axes, rows, strict=False):
        _draw_ensembles(ax, chains.draws[..., chains.header.names.index(name)] / size)
        # A reader knows the memory of noise by its partial autocorrelation, of which this is atanh.
        words = name.replace("partial", "partial autocorrelation").replace("_", " ")
        ax.set_title(f"{words} [{unit}]" if unit else words, loc="left", fontsize="small")
    _draw_ensembles(axes[len(rows)], chains.log_density)
    axes[len(rows)].set_title("log density", loc="left", fontsize="small")
    for ax in axes[len(rows) + 1 :]:
        ax.set_axis_off()
    for column in (axes[:panels], axes[panels : len(rows) + 1]):
        if len(column):
            column[-1].tick_params(labelbottom=True)
    axes[panels - 1].set_xlabel("stored step after burn-in", fontsize="small")
    name, source = posterior.fit.pair.name, PurePath(posterior.fit.source).name
    heading(figure, "draws: the ensembles should overlap and not drift", name, source)
    ensembles = range(min(len(posterior.draws), len(COLOURS)))
    keys = [
        Line2D([], [], color=COLOURS[k], linewidth=1.4, label=f"ensemble {k + 1}")
        for k in ensembles
    ]
    figure_legend(figure, keys, min(len(keys), _KEYS_PER_ROW))
    return figure


def _draw_ensembles(ax: Axes, draws: Float[np.ndarray, "ensembles steps walkers"]) -> None:
    stride = max(1, draws.shape[1] // _MAX_STEPS)
    thinning = max(1, draws.shape[2] // _MAX_WALKERS)
    step = np.arange(0, draws.shape[1], stride)
    low, high = np.inf, -np.inf
    for ensemble, samples in enumerate(draws):
        colour = COLOURS[ensemble % len(COLOURS)]
        walkers = samples[::stride, ::thinning][:, :_MAX_WALKERS]
        lines = np.stack([np.broadcast_to(step, walkers.T.shape), walkers.T], axis=2)
        thin = LineCollection(list(lines), colors=[colour], lw=0.3, alpha=0.25, zorder=1)
        ax.add_collection(thin, autolim=False)
        low, high = min(low, float(walkers.min())), max(high, float(walkers.max()))
        ax.plot(step, samples[::stride].mean(axis=1), color=colour, linewidth=1.4, zorder=2)
    ax.set_ylim(*with_margin(low, high, 0.05))
    grid(ax)
    ax.tick_params(labelsize=7)
    ax.ticklabel_format(axis="y", useOffset=False, style="plain")  # no factor where the name is
