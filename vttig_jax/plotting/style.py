"""Sizes, colours, units, ticks and legends of all pictures."""

import math
from collections.abc import Sequence
from io import BytesIO
from typing import Any, Final, Literal

import numpy as np
from jaxtyping import Float
from matplotlib import color_sequences
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MultipleLocator

from ..base.shown_text import shown_name
from ..base.units import ANGLE_UNITS

Unit = Literal["arcsec", "deg"]

COLOURS: Final = color_sequences["petroff10"]
"""Ten colours that are distinct for any colour vision (Petroff, arXiv:2107.02270)."""

FLANK_COLOURS: Final = {"A": COLOURS[0], "B": COLOURS[2]}
MODEL_COLOUR: Final = "0.1"
SIGNS: Final = {"arcsec": "arcsec", "deg": "°"}

_WIDTH_IN = 8.0  # width of a figure, inch
MANY_TURNS = 25  # from which on turns are folded, and are the labels of an axis; a chosen value
_MAX_TICKS = 9  # of a driving angle axis; a chosen value
_MOST_LETTERS = 120  # of a name in a heading, which is 8 inches wide; chosen value
_LEGEND_ROW_PT = 15.0  # height of a legend row, point


class Picture(Figure):
    """A figure that has no pyplot window until `show`, and that notebooks display as a picture."""

    def show(self, warn: bool = True) -> None:
        """Open a window with this figure; see `matplotlib.figure.Figure.show`."""
        if self.canvas.manager is None:
            from matplotlib import pyplot

            window = pyplot.figure()
            # This figure takes the place of the empty figure in the new window.
            type(window.canvas).new_manager(self, window.number)
        super().show(warn)

    def _repr_png_(self) -> bytes:
        buffer = BytesIO()
        self.savefig(buffer, format="png")
        return buffer.getvalue()


def new_figure(height_in: float) -> Figure:
    """Return a figure of a height in inch, 1200 pixels wide at 150 dpi, without pyplot."""
    return Picture(figsize=(_WIDTH_IN, height_in), layout="constrained")


def figure_of(ax: Axes) -> Figure:
    """Return the root figure of `ax`, also if `ax` is in a subfigure."""
    figure = ax.get_figure(root=True)
    assert isinstance(figure, Figure)
    return figure


def unit_size(unit: str) -> float:
    """Return the radians per `unit`."""
    if unit not in SIGNS:
        raise ValueError(f"Argument `unit` must be {' or '.join(SIGNS)}, but is {unit!r}.")
    return ANGLE_UNITS[unit]


def heading(figure: Figure, *parts: str) -> None:
    """Set the heading of a figure from `parts`; a `$` in them does not start a formula."""
    figure.suptitle(
        _joined(parts), x=0.01, horizontalalignment="left", fontsize="medium", parse_math=False
    )


def title(ax: Axes, *parts: str, legend_rows: int = 0) -> None:
    """Set the title of axes at the upper left, with space below for `legend_rows` legend rows."""
    ax.set_title(
        _joined(parts),
        loc="left",
        fontsize="medium",
        pad=6.0 + _LEGEND_ROW_PT * legend_rows,
        parse_math=False,
    )


def legend(ax: Axes, handles: Sequence[Artist], **look: Any) -> None:
    """Draw a legend of two columns above the axes, where it covers no data."""
    place = {"loc": "lower right", "bbox_to_anchor": (1.0, 1.0), "ncols": 2, "frameon": False}
    size = {"fontsize": "small", "borderaxespad": 0.2, "handlelength": 1.5, "columnspacing": 1.2}
    ax.legend(handles=handles, **place | size | look)


def labelled(ax: Axes) -> list[Artist]:
    """Return what axes show with a label, for a legend; of equal labels it is the last one."""
    handles, labels = ax.get_legend_handles_labels()
    return list(dict(zip(labels, handles, strict=True)).values())


def panel(
    ax: Axes,
    *words: str,
    x: str = "",
    y: str = "",
    keys: Sequence[Artist] = (),
    legend_rows: int = 0,
) -> None:
    """Name axes and what they show, `words`, over light grid lines; `keys` have a legend."""
    ax.set(xlabel=x or ax.get_xlabel(), ylabel=y or ax.get_ylabel())
    if words:
        title(ax, *words, legend_rows=legend_rows)
    grid(ax)
    if keys:
        legend(ax, keys)


def figure_legend(figure: Figure, handles: Sequence[Artist], columns: int, **look: Any) -> None:
    """Draw one legend for all panels of a figure, below them unless `look` says otherwise."""
    style = {"loc": "outside lower center", "frameon": False, "fontsize": "small"}
    figure.legend(handles=handles, ncols=columns, **style | look)


def dots(
    ax: Axes, x: Float[np.ndarray, " n"], y: Float[np.ndarray, " n"], flank: str, label: str
) -> list[Line2D]:
    """Draw points in the colour of their flank."""
    style = {"color": FLANK_COLOURS[flank], "markersize": 3, "markeredgewidth": 0, "alpha": 0.6}
    return ax.plot(x, y, ".", label=label, **style)


def grid(ax: Axes) -> None:
    """Draw light grid lines behind the data, and remove the upper and right frame lines."""
    ax.grid(True, color="0.9", linewidth=0.6)
    ax.set_axisbelow(True)
    ax.spines[["top", "right"]].set_visible(False)


def with_margin(low: float, high: float, share: float) -> tuple[float, float]:
    """Return limits of an axis with a margin on both sides, also around a single value."""
    margin = share * (high - low) or max(abs(low), 1.0) * 1e-6
    return low - margin, high + margin


def driving_axis(ax: Axes) -> None:
    """Label the driving angle axis, with ticks at whole turns if it covers three or more.

    From 25 turns on the labels are turns.
    """
    ax.set_xlabel("driving angle [°]")
    low, high = ax.get_xlim()
    turns = (high - low) / 360.0
    if turns >= 3:
        ax.xaxis.set_major_locator(MultipleLocator(360.0 * math.ceil(turns / _MAX_TICKS)))
    if turns >= MANY_TURNS:
        ax.set_xlabel("driving angle [turns]")
        ax.xaxis.set_major_formatter(lambda x, _: f"{x / 360:g}")


def _joined(parts: tuple[str, ...]) -> str:
    return " · ".join(shown_name(part, _MOST_LETTERS) for part in parts if part)
