"""Picture of a backlash map."""

import math

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from ..base.errors import NoAnswerError
from ..base.units import DEG, REV
from ..kinematics.backlash_map import BacklashMap, Extreme
from ..pair.gears import Drive
from .style import COLOURS, MODEL_COLOUR, driving_axis, figure_of, grid, legend, new_figure, title
from .thinning import thinned

_PER_PERIOD = 24


def plot_map(backlash: BacklashMap, *, ax: Axes | None = None, turns: int = 16) -> Figure:
    """Backlash over the hunting period, the first-order map beside it, both extremes marked.

    The axis at the right reads millimetres: of axial displacement where the pair has taper, else
    at the reference circle; a drive has none.

    **Arguments**
    - `backlash`: the map.
    - `ax`: axes to draw on; a new figure when absent.
    - `turns`: driving turns shown at most. The title says so where the hunting period is longer;
      the extremes are those of the whole period.

    **Raises** `NoAnswerError` where the backlash is not a number: one flank was not measured.
    """
    if turns < 1:
        raise ValueError(f"Argument `turns` must be at least 1, but is {turns}.")
    period = backlash.pair.hunting_turns
    shown = min(turns, period)
    per_turn = _PER_PERIOD * math.ceil(max(backlash.model.highest_order, 1.0))
    angle = np.linspace(0.0, shown * REV, shown * per_turn + 1)
    gap = backlash.over(angle)
    if not np.isfinite(gap).all():
        raise NoAnswerError(
            "the backlash map is not a number: one of its flanks was not measured; record both"
            " directions."
        )
    if ax is None:
        ax = new_figure(4.2).add_subplot()
    x, y = thinned(angle / DEG, gap / DEG)
    lines = ax.plot(x, y, color=COLOURS[0], linewidth=0.8, label="backlash map")
    if backlash.first_order is not None:
        first = backlash.first_order_over(angle)
        x, y = thinned(angle / DEG, first / DEG)
        lines += ax.plot(x, y, "--", color=COLOURS[1], linewidth=1.3, label="first order only")
    marks = _mark(ax, backlash.smallest, "v", "smallest", shown)
    marks += _mark(ax, backlash.largest, "^", "largest", shown)
    ax.set_ylabel("backlash, angle of the driven gear [°]")
    ax.set_xlim(0.0, 360.0 * shown)
    _millimetres(ax, backlash)
    title(ax, "backlash", backlash.pair.name, _span(shown, period), legend_rows=2)
    grid(ax)
    driving_axis(ax)
    legend(ax, marks + lines)
    return figure_of(ax)


def _span(shown: int, period: int) -> str:
    if shown < period:
        return f"first {shown} of the {period} turns of the hunting period"
    return f"hunting period of {period} turn{'s' if period > 1 else ''}"


def _mark(ax: Axes, extreme: Extreme, marker: str, word: str, shown: int) -> list[Line2D]:
    """Mark an extreme; one outside the turns shown stands in the legend alone."""
    seen = extreme.driving_angle <= shown * REV
    place = ([extreme.driving_angle / DEG], [extreme.backlash / DEG]) if seen else ([], [])
    return ax.plot(
        *place,
        marker,
        color=MODEL_COLOUR,
        markersize=7,
        markerfacecolor="none",
        label=f"{word}: {extreme}" + ("" if seen else ", not shown"),
    )


def _millimetres(ax: Axes, backlash: BacklashMap) -> None:
    """Axis at the right: j_mm = j R₂, or s = j R₂/(tan β_L + tan β_R)."""
    pair = backlash.pair
    if isinstance(pair, Drive):
        return
    size, label = float(pair.reference_radii[1]) * DEG, "at the reference circle [mm]"
    if thinning := float(pair.thinning):
        size, label = size / thinning, "axial displacement that closes it [mm]"
    right = ax.secondary_yaxis(
        "right",
        functions=(lambda deg: np.asarray(deg) * size, lambda mm: np.asarray(mm) / size),
    )
    right.set_ylabel(label)
