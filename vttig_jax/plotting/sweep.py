"""Picture of a sweep: residual backlash and interference over one axis, with bands."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ..control.sweeps.table import SweepTable
from .style import COLOURS, grid, heading, legend, new_figure

_ROWS = (
    ("residual_gap_deg", "backlash left\nat the turn [°]"),
    ("interference_mm", "closed too\nfar by [mm]"),
)
_OUTPUT = ("output_error_deg", "error of the\noutput [°]")
"""Metric that only a feedforward controller can reduce. It is drawn if the sweep has one."""

_LINES = ("-", "--", "-.", ":")
"""Line styles that keep coinciding curves visible."""

_BAND = (0.025, 0.975)  # quantiles at the edges of a band
_MAX_POSITIONS = 400
"""Largest number of positions on the axis; if there are more, neighbours are merged into groups; a
chosen value."""

_MAX_COLOURS = 8  # colours of one picture; a chosen value
_MAX_MARKERS = 40  # positions that have a marker each; a chosen value

_NAMES = {
    "motion.reversal_deg": "driving angle of the turn [°]",
    "motion.speed_rpm": "speed [rpm]",
    "draw": "draw of the posterior",
}


def plot_sweep(table: SweepTable, *, axis: str | None = None, by: str | None = None) -> Figure:
    """Plot residual backlash and interference over one axis of a sweep, a colour per controller.

    At every value of the axis, the picture shows the median of all cases with that value and the
    band that contains 95 % of them; a single case has no band.

    **Arguments**
    - `table`: table of a sweep.
    - `axis`: a numeric axis; by default the one with the most values except draws.
    - `by`: axis with a colour for each value; by default all text axes, such as the controller,
      or else the numeric one with the fewest values, at most eight.

    **Raises** `ValueError` for an unknown axis, and for an axis without numbers.
    """
    name = _axis(table, axis)
    groups = _groups(table, name, by)
    controllers = table.columns.get("controller", np.array([table.spec.controller]))
    metrics = (*_ROWS, _OUTPUT) if "feedforward" in controllers else _ROWS
    figure = new_figure(2.8 * len(metrics))
    rows = figure.subplots(len(metrics), 1, sharex=True)
    handles = []
    for ax, (metric, label) in zip(rows, metrics, strict=True):
        handles = [
            _draw_band(ax, table.columns[name][mask], table.columns[metric][mask], number, group)
            for number, (group, mask) in enumerate(groups)
        ]
        ax.set_ylabel(label)
        low, high = ax.get_ylim()
        ax.set_ylim(max(low, -0.04 * high), high)  # no metric is negative
        grid(ax)
    legend(rows[0], handles)
    rows[-1].set_xlabel(_NAMES.get(name, name))
    cases = len(table.columns["case"])
    heading(figure, table.pair or "sweep", f"{cases} cases", "median and 95 % of them")
    return figure


def _groups(table: SweepTable, axis: str, by: str | None) -> list[tuple[str, np.ndarray]]:
    """Return, for each colour, the name of its group and the mask of the cases in this group."""
    if by is None:
        if any(table.columns[name].dtype.kind == "U" for name in table.axes):
            return table.groups()
        counts = {name: len(np.unique(table.columns[name])) for name in table.axes if name != axis}
        few = [name for name, count in counts.items() if name != "draw" and count <= _MAX_COLOURS]
        if not few:
            return table.groups()
        by = min(few, key=lambda name: counts[name])
    elif by not in table.axes:
        raise ValueError(f"Argument `by` must be one of {', '.join(table.axes)}, but is {by!r}.")
    column = table.columns[by]
    return [(f"{by} = {value}", column == value) for value in np.unique(column)]


def numeric_axes(table: SweepTable) -> list[str]:
    """Return the axes whose values are numbers."""
    return [axis for axis in table.axes if table.columns[axis].dtype.kind != "U"]


def _axis(table: SweepTable, axis: str | None) -> str:
    numeric = numeric_axes(table)
    if axis is not None and axis not in numeric:
        raise ValueError(
            f"Argument `axis` must be one of {', '.join(numeric) or 'no axis here'}, but is"
            f" {axis!r}."
        )
    if not numeric:
        raise ValueError("Argument `table` must have an axis of numbers for a picture.")
    counts = {name: len(np.unique(table.columns[name])) for name in numeric}
    without_draws = {name: count for name, count in counts.items() if name != "draw"} or counts
    return axis or max(without_draws, key=lambda name: without_draws[name])


def _draw_band(ax: Axes, positions: np.ndarray, values: np.ndarray, number: int, name: str):
    """Draw median and band of the values at every position; return the line for the legend."""
    colour, dashes = COLOURS[number % len(COLOURS)], _LINES[number % len(_LINES)]
    valid = ~np.isnan(values)
    positions, values = positions[valid], values[valid]
    if not len(positions):
        return ax.plot([], [], dashes, color=colour, label=name)[0]
    unique, inverse = np.unique(positions, return_inverse=True)
    if len(unique) > _MAX_POSITIONS:
        bins = np.arange(len(unique)) * _MAX_POSITIONS // len(unique)
        inverse = bins[inverse]
        unique = np.bincount(bins, unique) / np.bincount(bins)
    order = np.argsort(inverse, kind="stable")
    groups = np.split(values[order], np.cumsum(np.bincount(inverse))[:-1])
    low, middle, high = np.array([np.quantile(g, (_BAND[0], 0.5, _BAND[1])) for g in groups]).T
    if max(len(group) for group in groups) > 1:
        ax.fill_between(unique, low, high, color=colour, alpha=0.3, linewidth=0)
    look = {"color": colour, "marker": "." if len(unique) <= _MAX_MARKERS else ""}
    (line,) = ax.plot(unique, middle, dashes, linewidth=1.1, label=name, **look)
    return line
