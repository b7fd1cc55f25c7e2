"""Pictures of runs like the paper's Figs. 16–20."""

from collections.abc import Mapping, Sequence
from io import BytesIO

import numpy as np
from jaxtyping import Float
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MultipleLocator
from matplotlib.typing import ColorType
from PIL import Image

from vttig_jax.base.units import DEG
from vttig_jax.control.simulation.result import Simulation
from vttig_jax.plotting.save import png
from vttig_jax.plotting.style import (
    COLOURS,
    MODEL_COLOUR,
    figure_of,
    grid,
    heading,
    legend,
    new_figure,
    thinned,
    title,
)

CONTROLLER_COLOURS = {"none": MODEL_COLOUR, "acceleration": COLOURS[1], "predictive": COLOURS[4]}
_WIDTHS = {"none": 1.6, "acceleration": 2.4, "predictive": 1.1}
"""The later of them lie on top: what is below them stays to be seen."""

_WORDS = {
    "none": "without control",
    "acceleration": "the paper's controller",
    "predictive": "predictive",
}
_ORDER = (
    *("gap", "map", "closed", "none", "acceleration", "predictive"),
    *("closes", "turns", "closing", "beyond", "left"),
)
"""Of the entries of a legend."""

MAP_COLOUR, BEYOND_COLOUR = COLOURS[0], COLOURS[2]
_MOST_POINTS = 4000
_PALETTE = 256
"""Colours of a file: lines on white need no more, and it is a third of the size."""

_BRAKING_S, _TURNING_S = (-0.15, 0.65), (-0.03, 0.22)
"""Shown close up, from when the motor brakes, and from when it turns."""

Table = dict[str, Float[np.ndarray, " n"]]


def small_png(figure: Figure) -> bytes:
    """A figure as PNG with few colours: the same figure gives the same bytes."""
    buffer = BytesIO()
    drawn = Image.open(BytesIO(png(figure))).convert("RGB")
    drawn.quantize(_PALETTE, dither=Image.Dither.NONE).save(buffer, "PNG", optimize=True)
    return buffer.getvalue()


def plot_run(
    runs: Mapping[str, Simulation], name: str, spans: Mapping[str, Sequence[float]], words: str
) -> Figure:
    """One experiment: TE of the whole run without and with control, then its reversal close up.

    The grey area of the close views lies between both flanks with the gap open; below stand the
    axial shift of both controllers, and that which closes the gap.

    **Arguments**
    - `runs`: controller → simulated run with a trace. - `name`: of the experiment.
    - `spans`: controller → least and largest TE in degrees that are printed; named `words`.
    """
    tables = {controller: _columns(found) for controller, found in runs.items()}
    figure = new_figure(9.2)
    cells = figure.add_gridspec(4, 2, height_ratios=[1.0, 1.0, 1.25, 1.0], width_ratios=[1.0, 1.0])
    whole = figure.add_subplot(cells[0, :])
    _whole(whole, tables, "none", spans, words)
    title(whole, "a) without control")
    below = figure.add_subplot(cells[1, :], sharex=whole, sharey=whole)
    _whole(below, tables, "acceleration", spans, words)
    title(below, "b) with the paper's controller")
    whole.tick_params(labelbottom=False)
    below.set_xlabel("time [s]")
    case = runs["none"].case
    _close_up(
        [[figure.add_subplot(cells[row, column]) for column in (0, 1)] for row in (2, 3)],
        tables,
        {
            "time from braking [s]": (float(case.motion.braking_s), _BRAKING_S),
            "time from the turn [s]": (float(case.motion.turn_s), _TURNING_S),
        },
        float(case.bounds.closing_sum),
    )
    heading(figure, name, "simulated")
    return figure


def _columns(found: Simulation) -> Table:
    """The trace, with angles from the first TE on, as Table 3 counts them."""
    table = found.columns()
    zero = table["te_deg"][0]
    return table | {name: table[name] - zero for name in ("te_deg", "flank_a_deg", "flank_b_deg")}


def _whole(
    ax: Axes,
    tables: Mapping[str, Table],
    controller: str,
    spans: Mapping[str, Sequence[float]],
    words: str,
) -> None:
    low, high = spans[controller]
    printed = ax.axhspan(low, high, color="0.92", linewidth=0, zorder=0, label=words)
    table = tables[controller]
    shown = line(
        ax, table["time_s"], table["te_deg"], CONTROLLER_COLOURS[controller], "simulated", 0.9
    )
    ax.set_xlim(0.0, table["time_s"][-1])
    ax.set_ylabel("transmission\nerror [°]")
    grid(ax)
    legend(ax, [shown, printed])


def _close_up(
    axes: list[list[Axes]],
    tables: Mapping[str, Table],
    spans: Mapping[str, tuple[float, tuple[float, float]]],
    closing: float,
) -> None:
    """Braking and turning, on common scales: TE above, axial shift below."""
    keys: dict[str, Artist] = {}
    for column, (label, (zero, span)) in enumerate(spans.items()):
        above, below = axes[0][column], axes[1][column]
        cut = {name: _cut(table, zero, span) for name, table in tables.items()}
        keys |= _draw_shift(below, cut, closing) | _draw_error(above, cut)
        for row, ax in enumerate((above, below)):
            if column:
                ax.sharey(axes[row][0])
            ax.axvline(0.0, linestyle="--", color="0.5", linewidth=0.8, zorder=1.5)
            ax.set_xlim(*span)
            ax.xaxis.set_major_locator(MultipleLocator(0.05 if column else 0.2))
            ax.tick_params(labelleft=not column, labelbottom=ax is below)
            grid(ax)
        below.set_xlabel(label)
    title(axes[0][0], "the motor brakes, close up")
    title(axes[0][1], "the motor turns, close up")
    axes[0][0].set_ylabel("transmission\nerror [°]")
    axes[1][0].set_ylabel("axial\nshift [mm]")
    legend_below(figure_of(axes[0][0]), keys)


def legend_below(figure: Figure, keys: Mapping[str, Artist]) -> None:
    """A legend of three columns, in an order of its own."""
    handles = [keys[name] for name in _ORDER if name in keys]
    figure.legend(
        handles=handles, loc="outside lower center", ncols=3, frameon=False, fontsize="small"
    )


def _cut(table: Table, zero: float, span: tuple[float, float]) -> Table:
    """The rows within a span of time around `zero`, which becomes 0."""
    time = table["time_s"] - zero
    inside = (time >= span[0]) & (time <= span[1])
    return {name: values[inside] for name, values in (table | {"time_s": time}).items()}


def _draw_error(ax: Axes, cut: Mapping[str, Table]) -> dict[str, Artist]:
    own = cut["none"]
    gap = ax.fill_between(
        own["time_s"],
        own["flank_a_deg"],
        own["flank_b_deg"],
        color="0.92",
        linewidth=0,
        label="open gap",
    )
    lines = {name: _controlled(ax, name, table, "te_deg") for name, table in cut.items()}
    return {"gap": gap} | lines


def _controlled(ax: Axes, name: str, table: Table, column: str) -> Artist:
    """One column of the run with one controller."""
    style = CONTROLLER_COLOURS[name], _WORDS[name], _WIDTHS[name]
    return line(ax, table["time_s"], table[column], *style)


def _draw_shift(ax: Axes, cut: Mapping[str, Table], closing: float) -> dict[str, Artist]:
    own, judged = cut["none"], cut["acceleration"]
    gap = (own["flank_b_deg"] - own["flank_a_deg"]) * DEG / closing
    keys: dict[str, Artist] = {
        "closing": line(ax, own["time_s"], gap, MAP_COLOUR, "closes the gap")
    }
    for name in ("acceleration", "predictive"):
        keys[name] = _controlled(ax, name, cut[name], "axial_mm")
    beyond = judged["command_mm"] > gap
    if beyond.any():
        keys["beyond"] = ax.fill_between(
            judged["time_s"],
            gap,
            judged["command_mm"],
            where=beyond.tolist(),
            color=BEYOND_COLOUR,
            alpha=0.45,
            linewidth=0,
            label="commanded too far",
        )
    return keys


def line(
    ax: Axes,
    x: Float[np.ndarray, " n"],
    y: Float[np.ndarray, " n"],
    colour: ColorType,
    label: str,
    width: float = 1.2,
) -> Artist:
    """A line of few points."""
    [drawn] = ax.plot(*thinned(x, y, _MOST_POINTS), color=colour, linewidth=width, label=label)
    return drawn
