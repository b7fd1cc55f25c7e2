"""Picture of a sweep: what is left and what is closed too far, over one axis, with bands."""

from itertools import cycle

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ..control.sweeps.table import SweepTable
from .style import COLOURS, grid, heading, legend, new_figure

_ROWS = (
    ("residual_gap_deg", "backlash left\nat the turn [°]"),
    ("interference_mm", "closed too\nfar by [mm]"),
)
_LOST = ("lost_motion_deg", "motion lost\nin the turn [°]")
"""What a feedforward controller makes up for, and no other."""

_LINES = ("-", "--", "-.", ":")
"""So that a curve on another one is seen."""

_BAND = (0.025, 0.975)
_MOST_POINTS = 400
"""Places along the axis; more of them are taken together."""

_MOST_COLOURS = 8

_MARKED = 40
"""Places that are few enough to mark each."""

_NAMES = {
    "motion.reversal_deg": "driving angle of the turn [°]",
    "motion.speed_rpm": "speed [rpm]",
    "draw": "draw of the posterior",
}


def plot_sweep(table: SweepTable, *, axis: str | None = None, by: str | None = None) -> Figure:
    """Backlash left and interference over one axis of a sweep, a colour for each controller.

    At every value of the axis stand the median of all cases with that value, whatever their other
    axes, and the band that holds 95 % of them; where there is one case, its value alone.

    **Arguments**
    - `table`: of a sweep.
    - `axis`: a numeric axis; by default the one with the most values, draws left out.
    - `by`: the axis that has a colour for each value; by default those of texts, such as the
      controller, else the numeric one with the fewest values, eight at most.

    **Raises** `ValueError` for an axis that is none, or no numbers.
    """
    name = _axis(table, axis)
    groups = _groups(table, name, by)
    metrics = (*_ROWS, _LOST) if _feeds_forward(table) else _ROWS
    figure = new_figure(2.8 * len(metrics))
    rows = figure.subplots(len(metrics), 1, sharex=True)
    handles = []
    for ax, (metric, label) in zip(rows, metrics, strict=True):
        handles = [
            _banded(ax, table.columns[name][mask], table.columns[metric][mask], style, group)
            for (group, mask), style in zip(
                groups, zip(cycle(COLOURS), cycle(_LINES), strict=False), strict=False
            )
        ]
        ax.set_ylabel(label)
        low, high = ax.get_ylim()
        ax.set_ylim(max(low, -0.04 * high), high)  # none of these is below 0
        grid(ax)
    legend(rows[0], handles)
    rows[-1].set_xlabel(_NAMES.get(name, name))
    cases = len(table.columns["case"])
    heading(figure, table.pair or "sweep", f"{cases} cases", "median and 95 % of them")
    return figure


def _groups(table: SweepTable, axis: str, by: str | None) -> list[tuple[str, np.ndarray]]:
    """Names and cases of the colours."""
    if by is None:
        if any(table.columns[one].dtype.kind == "U" for one in table.axes):
            return table.groups()
        counts = {one: len(np.unique(table.columns[one])) for one in table.axes if one != axis}
        few = [one for one, count in counts.items() if one != "draw" and count <= _MOST_COLOURS]
        if not few:
            return table.groups()
        by = min(few, key=lambda one: counts[one])
    elif by not in table.axes:
        raise ValueError(f"Argument `by` must be one of {', '.join(table.axes)}, but is {by!r}.")
    column = table.columns[by]
    return [(f"{by} = {value}", column == value) for value in np.unique(column)]


def numeric_axes(table: SweepTable) -> list[str]:
    """Axes whose values are numbers."""
    return [axis for axis in table.axes if table.columns[axis].dtype.kind != "U"]


def _axis(table: SweepTable, asked: str | None) -> str:
    numeric = numeric_axes(table)
    if asked is not None and asked not in numeric:
        raise ValueError(
            f"Argument `axis` must be one of {', '.join(numeric) or 'no axis here'}, but is"
            f" {asked!r}."
        )
    if not numeric:
        raise ValueError("Argument `table` must have an axis of numbers for a picture.")
    counts = {axis: len(np.unique(table.columns[axis])) for axis in numeric}
    rigless = {axis: count for axis, count in counts.items() if axis != "draw"} or counts
    return asked or max(rigless, key=lambda one: rigless[one])


def _feeds_forward(table: SweepTable) -> bool:
    """Whether a case has this controller."""
    chosen = table.columns.get("controller", np.array([table.spec.controller]))
    return "feedforward" in chosen


def _banded(ax: Axes, places: np.ndarray, values: np.ndarray, style: tuple, name: str):
    """Median and band of the values at every place, drawn."""
    colour, dashes = style
    there = ~np.isnan(values)
    places, values = places[there], values[there]
    if not len(places):
        return ax.plot([], [], dashes, color=colour, label=name)[0]
    known, inverse = np.unique(places, return_inverse=True)
    if len(known) > _MOST_POINTS:
        together = np.arange(len(known)) * _MOST_POINTS // len(known)
        inverse = together[inverse]
        known = np.bincount(together, known) / np.bincount(together)
    order = np.argsort(inverse, kind="stable")
    groups = np.split(values[order], np.cumsum(np.bincount(inverse))[:-1])
    low, middle, high = np.array([np.quantile(g, (_BAND[0], 0.5, _BAND[1])) for g in groups]).T
    if max(len(group) for group in groups) > 1:
        ax.fill_between(known, low, high, color=colour, alpha=0.3, linewidth=0)
    marker = "." if len(known) <= _MARKED else ""
    (line,) = ax.plot(known, middle, dashes, color=colour, linewidth=1.1, marker=marker, label=name)
    return line
