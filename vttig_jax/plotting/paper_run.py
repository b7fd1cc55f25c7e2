"""Picture of a run of the paper like its Figs. 16–20: without and with its controller."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from ..base.units import DEG
from ..control.simulation.result import Simulation
from .curves import thinned
from .style import COLOURS, MODEL_COLOUR, figure_legend, grid, heading, new_figure, panel, title

_LINES: dict[str, tuple[Any, ...]] = {
    "none": ("without control", MODEL_COLOUR, 1.6),
    "acceleration": ("the paper's controller", COLOURS[1], 2.4),
    "predictive": ("predictive", COLOURS[4], 1.1),
    "closing": ("closes the gap", COLOURS[0], 1.2),
}
"""Words, colour and width of each line; a later one lies on top of wider ones."""

Table = dict[str, Float[np.ndarray, " n"]]


def plot_paper_run(
    runs: Mapping[str, Simulation], name: str, printed: Mapping[str, Mapping[str, Any]]
) -> Figure:
    """Plot one run of the paper: the TE of the whole run, and enlarged views of its reversal.

    The upper rows show the TE without control and with the paper's controller, with a grey band
    from the smallest to the largest TE of Table 3. The enlarged views begin when the motor brakes
    and when it turns: TE of all controllers with the open gap in grey, and the axial shifts beside
    that which closes the gap.

    **Arguments**
    - `runs`: "none", "acceleration" and "predictive" → run with a trace. - `name`: of the run.
    - `printed`: rows of Table 3, as in `PaperRun`; the first one is shown.
    """
    tables = {controller: _columns(found) for controller, found in runs.items()}
    figure = new_figure(9.2)
    cells = figure.add_gridspec(4, 2, height_ratios=[1.0, 1.0, 1.25, 1.0])
    source, rows = next(iter(printed.items()))
    upper: list[Axes] = []
    for controller, of in zip(("none", "acceleration"), rows.values(), strict=True):
        ax = figure.add_subplot(cells[len(upper), :], sharey=upper[0] if upper else None)
        span, words = (of["te_min_deg"], of["te_max_deg"]), f"Table 3, {source}: min to max"
        band = ax.axhspan(*span, color="0.92", linewidth=0, zorder=0, label=words)
        line = _line(ax, tables[controller], "te_deg", controller)
        line.set_linewidth(0.9)
        ax.set_xlim(0.0, tables[controller]["time_s"][-1])
        ax.tick_params(labelbottom=bool(upper))
        words = "with the paper's controller" if upper else "without control"
        panel(ax, words, y="transmission\nerror [°]", keys=[line, band])
        upper.append(ax)
    upper[-1].set_xlabel("time [s]")
    case = runs["none"].case
    braking, turn = float(case.motion.braking_s), float(case.motion.turn_s)
    lower: list[tuple[Axes, Axes]] = []
    keys: dict[str, Artist] = {}
    for label, zero, span in (
        ("braking", braking, (-0.15, 0.65)),
        ("the turn", turn, (-0.03, 0.22)),
    ):
        places = [cells[row, len(lower)] for row in (2, 3)]
        above, below = (
            figure.add_subplot(place, sharey=lower[0][row] if lower else None)
            for row, place in enumerate(places)
        )
        cut = {name: _cut(table, zero, span) for name, table in tables.items()}
        keys |= _draw(above, below, cut, float(case.bounds.closing_sum))
        for ax in (above, below):
            ax.axvline(0.0, linestyle="--", color="0.5", linewidth=0.8, zorder=1.5)
            ax.set_xlim(*span)
            ax.tick_params(labelleft=not lower, labelbottom=ax is below)
            grid(ax)
        title(above, "the motor turns" if lower else "the motor brakes")
        below.set_xlabel(f"time from {label} [s]")
        lower.append((above, below))
    for ax, label in zip(lower[0], ("transmission\nerror [°]", "axial\nshift [mm]"), strict=True):
        ax.set_ylabel(label)
    figure_legend(figure, list(keys.values()), 3)
    heading(figure, name, "simulated")
    return figure


def _columns(found: Simulation) -> Table:
    """Return the trace with angles of the flanks from the first TE on, as Table 3 counts them."""
    table = found.columns()
    zero = table["te_deg"][0]
    return table | {name: table[name] - zero for name in ("te_deg", "flank_a_deg", "flank_b_deg")}


def _cut(table: Table, zero: float, span: tuple[float, float]) -> Table:
    """Return the rows within a span of the time since `zero`."""
    time = table["time_s"] - zero
    inside = (time >= span[0]) & (time <= span[1])
    return {name: values[inside] for name, values in (table | {"time_s": time}).items()}


def _draw(
    above: Axes, below: Axes, tables: Mapping[str, Table], closing: float
) -> dict[str, Artist]:
    """Draw TE and axial shifts of all controllers; `closing` is backlash per shift, rad/mm."""
    own, judged = tables["none"], tables["acceleration"]
    time, flanks = own["time_s"], (own["flank_a_deg"], own["flank_b_deg"])
    gap = (flanks[1] - flanks[0]) * DEG / closing
    drawn: dict[str, Artist] = {
        "gap": above.fill_between(time, *flanks, color="0.92", linewidth=0, label="open gap"),
        "closing": _line(below, own | {"closing": gap}, "closing", "closing"),
    }
    for name, table in tables.items():
        drawn[name] = _line(above, table, "te_deg", name)
        if name != "none":
            _line(below, table, "axial_mm", name)
    beyond = judged["command_mm"] > gap
    if beyond.any():
        look = {"color": COLOURS[2], "alpha": 0.45, "linewidth": 0, "label": "commanded too far"}
        shifts = gap, judged["command_mm"]
        drawn["beyond"] = below.fill_between(time, *shifts, where=beyond.tolist(), **look)
    return drawn


def _line(ax: Axes, table: Table, column: str, name: str) -> Line2D:
    label, colour, width = _LINES[name]
    points = thinned(table["time_s"], table[column], 4000)
    [line] = ax.plot(*points, color=colour, linewidth=width, label=label)
    return line
