"""Picture of a simulated run: the whole run, and enlarged views of its braking and turning."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.typing import ColorType

from ..base.units import DEG, REV
from ..control.simulation.result import Simulation
from .curves import thinned
from .style import (
    COLOURS,
    FLANK_COLOURS,
    MODEL_COLOUR,
    SIGNS,
    Unit,
    grid,
    heading,
    legend,
    new_figure,
    panel,
    unit_size,
)

_BEFORE, _AFTER = 0.2, 0.3
"""Times shown before and after a speed ramp, as shares of its duration; chosen values."""

_SHORTEST_RAMP, _LONGEST_VIEW = 0.01, 0.7
"""Shortest ramp and longest enlarged view, as shares of the run; chosen values."""

_STANDSTILL = 1e-5
"""Largest distance from the angle of the turn at which the shaft counts as standing still, as a
share of the range of angles while braking."""

_OBSERVED, _COMMAND, _CLOSED = "0.65", COLOURS[1], COLOURS[4]

Span = tuple[float, float]
Handles = dict[str, Artist]
Mark = tuple[float, str, ColorType]

Lines = dict[str, tuple[str | tuple[str, str], ColorType, float]]
"""Words of a line → column, colour and width; of an area → columns of its lower and upper edge,
colour and opacity. An area without words has no key."""

Rows = dict[str, Float[np.ndarray, " _"]]
"""Trace in the units of the picture.

`time` is in s. True and `measured` TE (`error`) and flanks A and B (`lower`, `upper`) are in the
unit of TE. Axial shifts are in mm: commanded, `reached`, and needed to close the gap. The speed of
the reference and the estimate of the driving shaft (`observed`) are in rpm. `output` is the error
of the driven shaft in the unit of TE.
"""


def plot_simulation(found: Simulation, *, unit: Unit = "deg", span_s: Span | None = None) -> Figure:
    """Plot the transmission error of the whole run, and enlarged views of the reversal.

    As in the metrics, the transmission error is zero at the first sample. It lies between flank A
    and flank B, which approach each other as the gap closes. The next row shows three axial shifts:
    commanded, reached, and needed to close the gap; the excess of the command is filled. For a
    controller that shifts no gear it shows the deviation of the driven shaft from i φ₁ of the
    reference. The last row shows the speed of the reference and the observer's estimate of the
    driving shaft. Vertical lines mark the times when the motor brakes and turns and when the
    controller closes.

    **Arguments**
    - `found`: a run with a trace (`trace_every`), preferably of every period.
    - `unit`: unit of the transmission error, "deg" or "arcsec".
    - `span_s`: first and last time of the enlarged view, s. The default is the ramps before and
      after the turn: one view if they meet, none if they cover most of the run.

    **Raises** `ValueError` for a run without a trace, and for a span without samples.
    """
    rows, marks = rows_of(found, unit_size(unit)), _marks(found)
    time = rows["time"]
    whole = (float(time[0]), float(time[-1]))
    if span_s is not None:
        inside = (time >= span_s[0]) & (time <= span_s[1])
        if not span_s[0] < span_s[1] or inside.sum() < 2:
            raise ValueError(
                f"Argument `span_s` must hold two samples or more of the {whole[0]:g} …"
                f" {whole[1]:g} s of the trace, but is {span_s}."
            )
    spans = _enlarged_spans(found, whole[1]) if span_s is None else [span_s]
    shifts = found.case.controller.closes
    second = "axial shift [mm]" if shifts else f"error of the output [{SIGNS[unit]}]"
    labels = (f"transmission error [{SIGNS[unit]}]", second, "speed [rpm]")
    lines = (_ERROR, _SHIFT if shifts else _OUTPUT, _SPEED)
    figure = new_figure(8.0 if spans else 6.0)
    heights = [1.0, 1.0, 0.6]
    cells = figure.add_gridspec(
        4 if spans else 3,
        max(len(spans), 1),
        height_ratios=[0.9, *heights] if spans else heights,
    )
    if spans:
        ax = figure.add_subplot(cells[0, :])
        draw(ax, _ERROR, rows)
        for span in spans:
            ax.axvspan(*span, color=COLOURS[9], alpha=0.3, linewidth=0, zorder=0.5)
        ax.set_xlim(*whole)
        panel(ax, "whole run; the shaded spans are enlarged below", x="time [s]", y=labels[0])
    columns = range(cells.ncols)
    axes = [[figure.add_subplot(cells[row, column]) for column in columns] for row in (-3, -2, -1)]
    views = [within(rows, span) for span in spans or [whole]]
    handles = [draw_row(*row, views) for row in zip(axes, lines, labels, strict=True)]
    drawn_marks: Handles = {}
    for column, span in enumerate(spans or [whole]):
        view = [row[column] for row in axes]
        drawn_marks |= _mark(view, span, marks)
        for ax in view:
            ax.set_xlim(*span)
            ax.tick_params(labelleft=not column, labelbottom=ax is view[-1])
        view[-1].set_xlabel("time [s]")
    name = f"{found.plant} plant, controller {found.controller}, outcome {found.outcome}"
    heading(figure, "simulation", found.scenario.pair.name, name)
    handles[0] |= drawn_marks
    for row, row_handles in zip(axes, handles, strict=True):
        legend(row[-1], list(row_handles.values()), loc="upper left", ncols=1, borderaxespad=0.5)
    return figure


def rows_of(simulation: Simulation, size: float) -> Rows:
    """Return the trace with TE minus its first measured value, in units of `size` rad."""
    table = simulation.columns()
    zero = table["te_shown_deg"][0]
    sources = {"error": "te", "measured": "te_shown", "lower": "flank_a", "upper": "flank_b"}
    rows = {name: (table[f"{one}_deg"] - zero) * DEG / size for name, one in sources.items()}
    gap = (table["flank_b_deg"] - table["flank_a_deg"]) * DEG
    closing = float(simulation.case.bounds.closing_sum) or np.inf
    speed = np.asarray(simulation.case.motion.at(table["time_s"]).speed)
    return rows | {
        "time": table["time_s"],
        "command": table["command_mm"],
        "reached": table["axial_mm"],
        "closed": table["axial_mm"] + gap / closing,
        "speed": speed * 60 / REV,
        "observed": table["speed_rad_s"] * 60 / REV,
        "output": table["output_error_deg"] * DEG / size,
    }


def within(rows: Rows, span: Span) -> Rows:
    """Return the rows in a span of time and one more row at each end."""
    first, last = (int(index) for index in np.searchsorted(rows["time"], span))
    return {name: values[max(first - 1, 0) : last + 1] for name, values in rows.items()}


def _marks(simulation: Simulation) -> dict[str, Mark]:
    """Return time (s), style and colour of the vertical line of every event within the run."""
    motion, accumulators = simulation.case.motion, simulation.accumulators
    end = float(motion.duration_s)
    times = {
        "motor brakes": (float(motion.braking_s), "--", MODEL_COLOUR),
        "controller closes": (float(accumulators.detection_s), ":", _COMMAND),
        "motor turns": (float(motion.turn_s), "-.", MODEL_COLOUR),
        "drive blocks": (float(accumulators.blocked_s), "-", _CLOSED),
    }
    return {event: mark for event, mark in times.items() if mark[0] < end}


def _enlarged_spans(simulation: Simulation, end: float) -> list[Span]:
    """Return the time spans, s, of the enlarged views: the speed ramps before and after the turn.

    If the motion does not turn, return one span from the start of braking to `end`, the end of the
    trace. The list is empty if a view would show most of the run.
    """
    motion = simulation.case.motion
    braking, turn = float(motion.braking_s), float(motion.turn_s)
    if not simulation.turns:
        return _useful_spans([(braking - 0.05 * (end - braking), end)], end)
    time = np.linspace(braking, turn, 2001)
    angle = np.asarray(motion.at(time).angle)
    distance = np.abs(angle - angle[-1])
    stop = float(time[np.argmax(distance <= _STANDSTILL * distance.max())])
    ramp = max(stop - braking, _SHORTEST_RAMP * end)
    spans = [(first - _BEFORE * ramp, first + (1 + _AFTER) * ramp) for first in (braking, turn)]
    if spans[0][1] > spans[1][0]:
        spans = [(spans[0][0], spans[1][1])]
    return _useful_spans(spans, end)


def _useful_spans(spans: list[Span], end: float) -> list[Span]:
    """Return the spans, cut to the trace, or an empty list if one of them covers most of it."""
    cut = [(max(first, 0.0), min(last, end)) for first, last in spans if first < end]
    return [] if any(last - first > _LONGEST_VIEW * end for first, last in cut) else cut


def draw_row(axes: Sequence[Axes], lines: Lines, label: str, views: Sequence[Rows]) -> Handles:
    """Draw one quantity in all enlarged views, `axes`, with the same vertical scale."""
    handles: Handles = {}
    for ax, rows in zip(axes, views, strict=True):
        if ax is not axes[0]:
            ax.sharey(axes[0])
        handles |= draw(ax, lines, rows)
        grid(ax)
    axes[0].set_ylabel(label)
    return handles


_ERROR: Lines = {
    "": (("lower", "upper"), "0.93", 1.0),
    "flank B": ("upper", FLANK_COLOURS["B"], 1.0),
    "flank A": ("lower", FLANK_COLOURS["A"], 1.0),
    "transmission error": ("error", MODEL_COLOUR, 1.0),
    "measured by encoders": ("measured", _OBSERVED, 0.8),
}
_SHIFT: Lines = {
    "closes the gap": ("closed", _CLOSED, 1.0),
    "commanded": ("command", _COMMAND, 1.2),
    "reached": ("reached", MODEL_COLOUR, 1.2),
    "commanded too far": (("closed", "command"), _CLOSED, 0.3),
}
_OUTPUT: Lines = {"driven shaft less i φ₁ of the reference": ("output", MODEL_COLOUR, 1.2)}
_SPEED: Lines = {
    "reference": ("speed", MODEL_COLOUR, 1.0),
    "observer's estimate": ("observed", _OBSERVED, 0.8),
}


def draw(ax: Axes, lines: Lines, rows: Rows) -> Handles:
    """Draw the lines and areas of a quantity; an area that is empty has no key."""
    time, drawn = rows["time"], Handles()
    for words in sorted(lines, key=lambda one: lines[one][1] != _OBSERVED):  # it lies below
        columns, colour, size = lines[words]
        if isinstance(columns, str):
            look = {"color": colour, "linewidth": size, "label": words}
            [drawn[words]] = ax.plot(*thinned(time, rows[columns]), **look)
            continue
        low, high = (rows[column] for column in columns)
        if (shown := high > low).any():
            look = {"color": colour, "alpha": size, "label": words, "linewidth": 0, "zorder": 1}
            drawn[words] = ax.fill_between(time, low, high, where=shown.tolist(), **look)
    return {words: drawn[words] for words in lines if words and words in drawn}


def _mark(axes: list[Axes], span: Span, marks: dict[str, Mark]) -> Handles:
    """Draw the vertical lines of the events inside `span` in all `axes` of this span."""
    handles: Handles = {}
    for event, (time, style, colour) in marks.items():
        if span[0] <= time <= span[1]:
            for ax in axes:
                look = {"linestyle": style, "color": colour, "label": event}
                handles[event] = ax.axvline(time, linewidth=0.8, zorder=1.5, **look)
    return handles
