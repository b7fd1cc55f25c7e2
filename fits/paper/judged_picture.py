"""Picture of the backlash that the paper's controller closes by, and of that where it turns."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from reversal_pictures import (
    BEYOND_COLOUR,
    CONTROLLER_COLOURS,
    MAP_COLOUR,
    legend_below,
    line,
)

from vttig_jax.plotting.style import (
    COLOURS,
    MODEL_COLOUR,
    driving_axis,
    grid,
    heading,
    new_figure,
    title,
)

Backlash = Callable[[Float[np.ndarray, " n"]], Float[np.ndarray, " n"]]

_LEFT = COLOURS[8]


def plot_judged(
    backlash: Backlash,
    runs: Sequence[tuple[str, float, float]],
    period_deg: float,
    margin_deg: float,
) -> Figure:
    """The backlash map with every turn, and with where the paper's controller closes and by what.

    **Arguments**
    - `backlash`: driving angles → backlash, both in degrees.
    - `runs`: name, driving angle of the turn, and how far before it the controller closes, degrees.
    - `period_deg`: driving angle of the hunting period. - `margin_deg`: what is left on purpose.
    """
    figure = new_figure(6.0)
    cells = figure.add_gridspec(2, len(runs))
    whole = figure.add_subplot(cells[0, :])
    angle = np.arange(0.0, period_deg + 1.0, 2.0)
    whole.plot(angle, backlash(angle), color=MAP_COLOUR, linewidth=1.0)
    _mark_turns(whole, backlash, sorted({turn for _, turn, _ in runs}), period_deg)
    whole.set_xlim(0.0, period_deg)
    driving_axis(whole)
    whole.set_ylabel("backlash [°]")
    title(whole, f"hunting period of {period_deg:g}°, turns beyond it shown a period earlier")
    grid(whole)
    axes: list[Axes] = []
    keys: dict[str, Artist] = {}
    for column, (name, turn, ahead) in enumerate(runs):
        ax = figure.add_subplot(cells[1, column], sharey=axes[0] if axes else None)
        keys |= _judged(ax, backlash, turn, ahead, margin_deg)
        title(ax, name.replace(" to ", "\nto "))
        ax.tick_params(labelleft=not axes)
        axes.append(ax)
    axes[0].set_ylabel("backlash [°]")
    axes[len(axes) // 2].set_xlabel("driving angle from the turn [°]")
    heading(figure, "what the paper's controller closes, and the backlash where the motor turns")
    legend_below(figure, keys)
    return figure


def _mark_turns(ax: Axes, backlash: Backlash, turns: Sequence[float], period: float) -> None:
    """Dots with their driving angles: left of a dot, below two that are close to each other."""
    places = np.array(turns) % period
    gaps = backlash(places)
    ax.plot(places, gaps, "o", color=MODEL_COLOUR, markersize=5)
    for place in np.unique(np.round(places, -2)):
        near = np.flatnonzero(np.round(places, -2) == place)
        words = "\n".join(f"{turns[int(one)]:g}°" for one in reversed(near))
        side: Any = (
            {"ha": "right", "va": "center"} if len(near) == 1 else {"ha": "center", "va": "top"}
        )
        offset = (-7, 0) if len(near) == 1 else (0, -12)
        spot = (places[near].mean(), gaps[near].min())
        ax.annotate(words, spot, offset, textcoords="offset points", fontsize="small", **side)


def _judged(
    ax: Axes, backlash: Backlash, turn: float, ahead: float, margin: float
) -> dict[str, Artist]:
    """One run around its turn."""
    angle = np.linspace(-180.0, 60.0, 241)
    keys: dict[str, Artist] = {
        "map": line(ax, angle, backlash(turn + angle), MAP_COLOUR, "backlash map", 1.0)
    }
    way = np.linspace(-ahead, 0.0, 200)
    gap = backlash(turn + way)
    closed = gap[0] - margin
    keys["closed"] = line(
        ax, way[[0, -1]], np.full(2, closed), CONTROLLER_COLOURS["acceleration"], "what it closes"
    )
    [keys["closes"]] = ax.plot(
        [-ahead],
        [gap[0]],
        "v",
        color=CONTROLLER_COLOURS["acceleration"],
        markersize=6,
        label="the controller closes",
    )
    [keys["turns"]] = ax.plot(
        [0.0], [gap[-1]], "o", color=MODEL_COLOUR, markersize=5, label="the motor turns"
    )
    if closed < gap[-1]:
        keys["left"] = line(ax, np.zeros(2), np.array([closed, gap[-1]]), _LEFT, "left", 3.0)
    if (closed > gap).any():
        keys["beyond"] = ax.fill_between(
            way,
            gap,
            closed,
            where=(closed > gap).tolist(),
            color=BEYOND_COLOUR,
            alpha=0.45,
            linewidth=0,
            label="closed too far",
        )
    ax.set_xlim(-180.0, 60.0)
    ax.set_xticks([-120.0, 0.0])
    grid(ax)
    return keys
