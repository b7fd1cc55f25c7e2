"""Trace picture of a posterior: the draws over the steps of each ensemble."""

from collections.abc import Sequence
from pathlib import PurePath

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from ..posterior.summary.posterior import Posterior
from .corner_picture import picture_unit
from .style import COLOURS, figure_legend, grid, heading, new_figure, with_margin

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
        _draw(ax, chains.draws[..., chains.header.names.index(name)] / size)
        # A reader knows the memory of noise by its partial autocorrelation, of which this is atanh.
        words = name.replace("partial", "partial autocorrelation").replace("_", " ")
        ax.set_title(f"{words} [{unit}]" if unit else words, loc="left", fontsize="small")
    _draw(axes[len(rows)], chains.log_density)
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


def _draw(ax: Axes, draws: Float[np.ndarray, "ensembles steps walkers"]) -> None:
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
