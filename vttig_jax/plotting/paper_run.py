"""Picture of a run of the paper like its Figs. 16–20: without and with its controller."""

from collections.abc import Mapping
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ..base.units import DEG
from ..control.simulation.result import Simulation
from .simulation import Lines, Rows, draw, draw_row, rows_of, within
from .style import COLOURS, MODEL_COLOUR, figure_legend, heading, new_figure, panel, title

_ERROR: Lines = {
    "open gap": (("lower", "upper"), "0.92", 1.0),
    "without control": ("none", MODEL_COLOUR, 1.6),
    "the paper's controller": ("acceleration", COLOURS[1], 2.4),
    "predictive": ("predictive", COLOURS[4], 1.1),
}
_SHIFT: Lines = {
    "closes the gap": ("closed", COLOURS[0], 1.2),
    "the paper's controller": ("acceleration_mm", COLOURS[1], 2.4),
    "predictive": ("predictive_mm", COLOURS[4], 1.1),
    "commanded too far": (("closed", "command"), COLOURS[2], 0.45),
}
_ENLARGED = (("braking", (-0.15, 0.65)), ("the turn", (-0.03, 0.22)))
"""Event that an enlarged view shows, and the first and last time of the view from it on, s."""


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
    rows = _rows(runs)
    figure = new_figure(9.2)
    cells = figure.add_gridspec(4, 2, height_ratios=[1.0, 1.0, 1.25, 1.0])
    source, printed_rows = next(iter(printed.items()))
    upper: list[Axes] = []
    for words, of in zip(list(_ERROR)[1:3], printed_rows.values(), strict=True):
        ax = figure.add_subplot(cells[len(upper), :], sharey=upper[0] if upper else None)
        span, label = (of["te_min_deg"], of["te_max_deg"]), f"Table 3, {source}: min to max"
        band = ax.axhspan(*span, color="0.92", linewidth=0, zorder=0, label=label)
        column, colour, _ = _ERROR[words]
        line = draw(ax, {words: (column, colour, 0.9)}, rows)[words]
        ax.set_xlim(0.0, rows["time"][-1])
        ax.tick_params(labelbottom=bool(upper))
        words = "with the paper's controller" if upper else "without control"
        panel(ax, words, y="transmission\nerror [°]", keys=[line, band])
        upper.append(ax)
    upper[-1].set_xlabel("time [s]")
    motion = runs["none"].case.motion
    events = (float(motion.braking_s), float(motion.turn_s))
    views = [
        within(rows | {"time": rows["time"] - event}, span)
        for event, (_, span) in zip(events, _ENLARGED, strict=True)
    ]
    above, below = ([figure.add_subplot(cells[row, column]) for column in (0, 1)] for row in (2, 3))
    keys = draw_row(above, _ERROR, "transmission\nerror [°]", views)
    keys |= draw_row(below, _SHIFT, "axial\nshift [mm]", views)
    for column, (label, span) in enumerate(_ENLARGED):
        for ax in (above[column], below[column]):
            ax.axvline(0.0, linestyle="--", color="0.5", linewidth=0.8, zorder=1.5)
            ax.set_xlim(*span)
            ax.tick_params(labelleft=not column, labelbottom=ax is below[column])
        title(above[column], "the motor turns" if column else "the motor brakes")
        below[column].set_xlabel(f"time from {label} [s]")
    figure_legend(figure, list(keys.values()), 3)
    heading(figure, name, "simulated")
    return figure


def _rows(runs: Mapping[str, Simulation]) -> Rows:
    """Return TE and shift of every controller beside the flanks and the gap without control.

    Angles are counted from the first TE on, as Table 3 counts them.
    """
    own = {name: rows_of(found, DEG) for name, found in runs.items()}
    rows = own["none"] | {"command": own["acceleration"]["command"]}
    rows |= {name: rows[name] - rows["error"][0] for name in ("lower", "upper")}
    rows |= {name: table["error"] - table["error"][0] for name, table in own.items()}
    return rows | {f"{name}_mm": table["reached"] for name, table in own.items()}
