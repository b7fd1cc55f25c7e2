"""Picture of a simulated run: the whole of it, then braking and turning close up."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.typing import ColorType

from ..base.units import DEG, REV
from ..control.simulation.result import Simulation
from .style import (
    COLOURS,
    FLANK_COLOURS,
    MODEL_COLOUR,
    SIGNS,
    Unit,
    grid,
    heading,
    new_figure,
    thinned,
    title,
    unit_size,
)

_BEFORE, _AFTER = 0.2, 0.3
"""Shown before and after a ramp, as shares of its time."""

_LEAST, _MOST = 0.01, 0.7
"""Shares of the run: what counts as a ramp at least, and what a close view may show."""

_RESTS = 1e-5
"""Share of the range of angles within which the shaft stands where it turns."""

_SEEN, _COMMAND, _CLOSED = "0.65", COLOURS[1], COLOURS[4]

Span = tuple[float, float]
Keys = dict[str, Artist]
Mark = tuple[float, str, ColorType]


@dataclass(frozen=True)
class _Rows:
    """A trace in the units of the picture: s, those of TE, mm and rpm."""

    time: Float[np.ndarray, " n"]
    error: Float[np.ndarray, " n"]
    shown: Float[np.ndarray, " n"]
    lower: Float[np.ndarray, " n"]
    upper: Float[np.ndarray, " n"]
    command: Float[np.ndarray, " n"]
    reached: Float[np.ndarray, " n"]
    closed: Float[np.ndarray, " n"]
    speed: Float[np.ndarray, " n"]
    seen: Float[np.ndarray, " n"]

    def within(self, span: Span) -> "_Rows":
        """The rows in a span of time, with one more at either end."""
        first, last = (int(place) for place in np.searchsorted(self.time, span))
        part = slice(max(first - 1, 0), last + 1)
        return _Rows(**{name: values[part] for name, values in vars(self).items()})


def plot_simulation(found: Simulation, *, unit: Unit = "deg", span_s: Span | None = None) -> Figure:
    """The transmission error of the whole run; then, close up, how the gap closes and is crossed.

    Transmission error is that of the metrics: from the first sample on. It lies between flank A and
    flank B, which move towards each other as the gap is closed. Below it stands the axial shift
    commanded, that reached, and that which closes the gap, with what is commanded beyond it. Then
    the speed of the driving shaft, and what the controller's observer makes of it. Vertical lines
    mark where the motor brakes and turns, and where the controller closes.

    **Arguments**
    - `found`: a run with a trace (`trace_every`), best of every period.
    - `unit`: of the transmission error, "deg" or "arcsec".
    - `span_s`: first and last time to show close up, instead of the ramps before and after the
      turn; these two are one where they meet, and left out where they are most of the run.

    **Raises** `ValueError` for a run without a trace, and a span without samples.
    """
    rows, marks = _rows(found, unit_size(unit)), _marks(found)
    if span_s is not None:
        _check(span_s, rows)
    whole = (float(rows.time[0]), float(rows.time[-1]))
    spans = _close(found, whole[1]) if span_s is None else [span_s]
    labels = (f"transmission error [{SIGNS[unit]}]", "axial shift [mm]", "speed [rpm]")
    figure = new_figure(8.0 if spans else 6.0)
    heights = [1.0, 1.0, 0.6]
    cells = figure.add_gridspec(
        4 if spans else 3,
        max(len(spans), 1),
        height_ratios=[0.9, *heights] if spans else heights,
    )
    if spans:
        _draw_whole(figure.add_subplot(cells[0, :]), rows, whole, spans, labels[0])
    columns = range(cells.ncols)
    axes = [[figure.add_subplot(cells[row, column]) for column in columns] for row in (-3, -2, -1)]
    keys = [
        _draw_row(*row, rows, spans or [whole]) for row in zip(axes, _DRAW, labels, strict=True)
    ]
    found_marks: Keys = {}
    for column, span in enumerate(spans or [whole]):
        own = [row[column] for row in axes]
        found_marks |= _mark(own, span, marks)
        for ax in own:
            ax.tick_params(labelleft=not column, labelbottom=ax is own[-1])
        own[-1].set_xlabel("time [s]")
    name = f"{found.spec.plant} plant, controller {found.controller}, outcome {found.outcome}"
    heading(figure, "simulation", found.pair.name, name)
    keys[0] |= found_marks
    for row, words in zip(axes, keys, strict=True):
        _legend(row[-1], words)
    return figure


def _rows(found: Simulation, size: float) -> _Rows:
    """The trace, TE from the first sample on, in units of `size` rad."""
    table = found.columns()
    zero = table["te_shown_deg"][0]
    errors = {
        name: (table[f"{column}_deg"] - zero) * DEG / size
        for name, column in (
            ("error", "te"),
            ("shown", "te_shown"),
            ("lower", "flank_a"),
            ("upper", "flank_b"),
        )
    }
    left = (table["flank_b_deg"] - table["flank_a_deg"]) * DEG
    closed = table["axial_mm"] + left / float(found.case.bounds.closing_sum)
    speed = np.asarray(found.case.motion.at(table["time_s"]).speed)
    return _Rows(
        time=table["time_s"],
        command=table["command_mm"],
        reached=table["axial_mm"],
        closed=closed,
        speed=speed * 60 / REV,
        seen=table["speed_rad_s"] * 60 / REV,
        **errors,
    )


def _marks(found: Simulation) -> dict[str, Mark]:
    """Words → time in s, style and colour of a vertical line; NaN for what did not happen."""
    motion, tally = found.case.motion, found.tally
    end = float(motion.duration_s)
    times = {
        "motor brakes": (float(motion.braking_s), "--", MODEL_COLOUR),
        "controller closes": (float(tally.detection_s), ":", _COMMAND),
        "motor turns": (float(motion.turn_s), "-.", MODEL_COLOUR),
        "drive blocks": (float(tally.blocked_s), "-", _CLOSED),
    }
    return {word: mark for word, mark in times.items() if mark[0] < end}


def _close(found: Simulation, end: float) -> list[Span]:
    """The ramps before and after the turn, what follows the brakes where there is no turn.

    Nothing where a close view would show most of the run; `end` is that of the trace, s.
    """
    motion = found.case.motion
    braking, turn = float(motion.braking_s), float(motion.turn_s)
    if not found.turns:
        return _worth_it([(braking - 0.05 * (end - braking), end)], end)
    time = np.linspace(braking, turn, 2001)
    angle = np.asarray(motion.at(time).angle)
    away = np.abs(angle - angle[-1])
    stop = float(time[np.argmax(away <= _RESTS * away.max())])
    ramp = max(stop - braking, _LEAST * end)
    spans = [(first - _BEFORE * ramp, first + (1 + _AFTER) * ramp) for first in (braking, turn)]
    if spans[0][1] > spans[1][0]:
        spans = [(spans[0][0], spans[1][1])]
    return _worth_it(spans, end)


def _worth_it(spans: list[Span], end: float) -> list[Span]:
    """Those that begin within the trace, cut to it; nothing where one is most of it."""
    cut = [(max(first, 0.0), min(last, end)) for first, last in spans if first < end]
    return [] if any(last - first > _MOST * end for first, last in cut) else cut


def _check(span: Span, rows: _Rows) -> None:
    inside = (rows.time >= span[0]) & (rows.time <= span[1])
    if not span[0] < span[1] or inside.sum() < 2:
        raise ValueError(
            f"Argument `span_s` must hold two samples or more of the {rows.time[0]:g} …"
            f" {rows.time[-1]:g} s of the trace, but is {span}."
        )


def _draw_whole(ax: Axes, rows: _Rows, whole: Span, spans: list[Span], label: str) -> None:
    """The run from its first to its last sample, with what is shown close up."""
    _draw_error(ax, rows)
    for span in spans:
        ax.axvspan(*span, color=COLOURS[9], alpha=0.3, linewidth=0, zorder=0.5)
    ax.set_xlim(*whole)
    ax.set_ylabel(label)
    ax.set_xlabel("time [s]")
    title(ax, "whole run; what is shaded stands below, close up")
    grid(ax)


def _draw_row(
    axes: list[Axes],
    draw: Callable[[Axes, _Rows], Keys],
    label: str,
    rows: _Rows,
    spans: list[Span],
) -> Keys:
    """One quantity in all close views, on one scale."""
    keys: Keys = {}
    for ax, span in zip(axes, spans, strict=True):
        if ax is not axes[0]:
            ax.sharey(axes[0])
        keys |= draw(ax, rows.within(span))
        ax.set_xlim(*span)
        grid(ax)
    axes[0].set_ylabel(label)
    return keys


def _draw_error(ax: Axes, rows: _Rows) -> Keys:
    ax.fill_between(rows.time, rows.lower, rows.upper, color="0.93", linewidth=0, zorder=1)
    shown = _line(ax, rows.time, rows.shown, _SEEN, 0.8)
    return {
        "flank B": _line(ax, rows.time, rows.upper, FLANK_COLOURS["B"], 1.0),
        "flank A": _line(ax, rows.time, rows.lower, FLANK_COLOURS["A"], 1.0),
        "transmission error": _line(ax, rows.time, rows.error, MODEL_COLOUR, 1.0),
        "as encoders show it": shown,
    }


def _draw_displacement(ax: Axes, rows: _Rows) -> Keys:
    keys: Keys = {
        "closes the gap": _line(ax, rows.time, rows.closed, _CLOSED, 1.0),
        "commanded": _line(ax, rows.time, rows.command, _COMMAND, 1.2),
        "reached": _line(ax, rows.time, rows.reached, MODEL_COLOUR, 1.2),
    }
    beyond = rows.command > rows.closed
    if beyond.any():
        keys["commanded too far"] = ax.fill_between(
            rows.time,
            rows.closed,
            rows.command,
            where=beyond.tolist(),
            color=_CLOSED,
            alpha=0.3,
            linewidth=0,
            zorder=1,
        )
    return keys


def _draw_speed(ax: Axes, rows: _Rows) -> Keys:
    observed = _line(ax, rows.time, rows.seen, _SEEN, 0.8)
    return {
        "driving shaft": _line(ax, rows.time, rows.speed, MODEL_COLOUR, 1.0),
        "as observed": observed,
    }


_DRAW = (_draw_error, _draw_displacement, _draw_speed)


def _line(
    ax: Axes,
    time: Float[np.ndarray, " n"],
    values: Float[np.ndarray, " n"],
    colour: ColorType,
    width: float,
) -> Artist:
    [line] = ax.plot(*thinned(time, values), color=colour, linewidth=width)
    return line


def _mark(axes: list[Axes], span: Span, marks: dict[str, Mark]) -> Keys:
    """Vertical lines through the views of one span."""
    keys: Keys = {}
    for word, (time, style, colour) in marks.items():
        if span[0] <= time <= span[1]:
            for ax in axes:
                keys[word] = ax.axvline(
                    time, linestyle=style, color=colour, linewidth=0.8, zorder=1.5
                )
    return keys


def _legend(ax: Axes, keys: Keys) -> None:
    """A legend at the right of a row."""
    ax.legend(
        list(keys.values()),
        list(keys),
        loc="upper left",
        bbox_to_anchor=(1.0, 1.0),
        frameon=False,
        fontsize="small",
        handlelength=1.5,
    )
