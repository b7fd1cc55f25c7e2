"""What all pictures share: size, colours, units of the axes, ticks at whole turns, legends."""

import math
from typing import Final, Literal

from matplotlib import color_sequences
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MultipleLocator

from ..base.units import ANGLE_UNITS

Unit = Literal["arcsec", "deg"]

COLOURS: Final = color_sequences["petroff10"]
"""Ten colours that people with any colour vision tell apart (Petroff, arXiv:2107.02270)."""

FLANK_COLOURS: Final = {"A": COLOURS[0], "B": COLOURS[2]}
MODEL_COLOUR: Final = "0.1"
SIGNS: Final = {"arcsec": "arcsec", "deg": "°"}

_WIDTH_IN = 8.0
_MOST_TICKS = 9


def new_figure(height_in: float) -> Figure:
    """A figure 1200 pixels wide at 150 dpi, without touching pyplot."""
    return Figure(figsize=(_WIDTH_IN, height_in), layout="constrained")


def figure_of(ax: Axes) -> Figure:
    """The whole figure that `ax` belongs to, also from a subfigure."""
    figure = ax.get_figure(root=True)
    assert isinstance(figure, Figure)
    return figure


def unit_size(unit: Unit) -> float:
    """Radians per `unit`."""
    if unit not in SIGNS:
        raise ValueError(f"Argument `unit` must be {' or '.join(SIGNS)}, but is {unit!r}.")
    return ANGLE_UNITS[unit]


def title(ax: Axes, *parts: str) -> None:
    """What is shown, left above the axes; a `$` in a file name stays a `$`."""
    text = " · ".join(part for part in parts if part)
    ax.set_title(text, loc="left", fontsize="medium", parse_math=False)


def legend(ax: Axes, columns: int = 2) -> None:
    """A legend on top of the axes, where it covers no data."""
    ax.legend(
        loc="lower right",
        bbox_to_anchor=(1.0, 1.0),
        ncols=columns,
        frameon=False,
        fontsize="small",
        borderaxespad=0.2,
        handlelength=1.5,
        columnspacing=1.2,
    )


def grid(ax: Axes) -> None:
    """Light grid lines behind the data, no frame above and at the right."""
    ax.grid(True, color="0.9", linewidth=0.6)
    ax.set_axisbelow(True)
    ax.spines[["top", "right"]].set_visible(False)


def driving_axis(ax: Axes) -> None:
    """Name the angle axis; ticks at whole turns where it covers several."""
    ax.set_xlabel("driving angle [°]")
    low, high = ax.get_xlim()
    turns = (high - low) / 360.0
    if turns >= 3:
        ax.xaxis.set_major_locator(MultipleLocator(360.0 * math.ceil(turns / _MOST_TICKS)))
