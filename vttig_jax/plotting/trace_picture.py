"""Trace picture of a posterior: the draws over the steps of each ensemble."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.typing import ColorType

from ..posterior.summary.posterior import Posterior
from .corner_picture import picture_unit
from .style import COLOURS, grid, heading, new_figure

_MAX_STEPS = 1000  # steps drawn; a chosen value
_MAX_WALKERS = 12  # walkers drawn per ensemble; a chosen value


def plot_trace(posterior: Posterior, *, names: Sequence[str] | None = None) -> Figure:
    """Plot every coordinate and the log density over the steps, one colour per ensemble.

    Thin lines are walkers, at most twelve per ensemble; a thick line is the mean over all walkers
    of an ensemble. Ensembles of the same posterior overlap and do not drift.

    **Arguments**
    - `posterior`: the draws.
    - `names`: coordinates to show; by default all, including the noise parameters.
    """
    names = posterior.names if names is None else tuple(names)
    rows = [(*picture_unit(posterior, name), name) for name in names]
    panels = -(-(len(rows) + 1) // 2)
    figure = new_figure(0.9 + 1.15 * panels)
    axes = figure.subplots(panels, 2, sharex=True, squeeze=False).T.ravel()
    for ax, (unit, size, name) in zip(axes, rows, strict=False):
        _draw(ax, posterior.values(name).reshape(posterior.draws.shape[:3]) / size)
        words = name.replace("_", " ")
        ax.set_title(f"{words} [{unit}]" if unit else words, loc="left", fontsize="small")
    _draw(axes[len(rows)], posterior.log_density)
    axes[len(rows)].set_title("log density", loc="left", fontsize="small")
    for ax in axes[len(rows) + 1 :]:
        ax.set_axis_off()
    for column in (axes[:panels], axes[panels : len(rows) + 1]):
        if len(column):
            column[-1].tick_params(labelbottom=True)
    axes[panels - 1].set_xlabel("kept step after burn-in", fontsize="small")
    heading(figure, "draws", posterior.fit.pair.name, posterior.fit.source)
    _add_legend(figure, posterior.draws.shape[0])
    return figure


def _draw(ax: Axes, draws: Float[np.ndarray, "ensembles steps walkers"]) -> None:
    stride = max(1, draws.shape[1] // _MAX_STEPS)
    thinning = max(1, draws.shape[2] // _MAX_WALKERS)
    step = np.arange(0, draws.shape[1], stride)
    for ensemble, samples in enumerate(draws):
        colour = _colour(ensemble)
        walkers = samples[::stride, ::thinning][:, :_MAX_WALKERS]
        ax.plot(step, walkers, color=colour, linewidth=0.3, alpha=0.25, zorder=1)
        ax.plot(step, samples[::stride].mean(axis=1), color=colour, linewidth=1.4, zorder=2)
    grid(ax)
    ax.tick_params(labelsize=7)
    ax.ticklabel_format(axis="y", useOffset=False)


def _colour(ensemble: int) -> ColorType:
    return COLOURS[ensemble % len(COLOURS)]


def _add_legend(figure: Figure, ensembles: int) -> None:
    keys = [
        Line2D([], [], color=_colour(k), linewidth=1.4, label=f"ensemble {k + 1}")
        for k in range(min(ensembles, len(COLOURS)))
    ]
    figure.legend(
        handles=keys,
        loc="outside lower center",
        ncols=min(len(keys), 5),
        frameon=False,
        fontsize="small",
    )
