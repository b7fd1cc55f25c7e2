"""Sizes, colours, units, ticks and legends of all pictures, and the thinning of long lines."""

import math
from collections.abc import Sequence
from typing import Final, Literal

import numpy as np
from jaxtyping import Float
from matplotlib import color_sequences
from matplotlib.artist import Artist
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
_LEGEND_ROW_PT = 15.0


def new_figure(height_in: float) -> Figure:
    """A figure 1200 pixels wide at 150 dpi, without touching pyplot."""
    return Figure(figsize=(_WIDTH_IN, height_in), layout="constrained")


def figure_of(ax: Axes) -> Figure:
    """The whole figure that `ax` belongs to, also from a subfigure."""
    figure = ax.get_figure(root=True)
    assert isinstance(figure, Figure)
    return figure


def unit_size(unit: str) -> float:
    """Radians per `unit`."""
    if unit not in SIGNS:
        raise ValueError(f"Argument `unit` must be {' or '.join(SIGNS)}, but is {unit!r}.")
    return ANGLE_UNITS[unit]


def heading(figure: Figure, *parts: str) -> None:
    """What a figure shows, in its first line; a `$` in a file name stays a `$`."""
    figure.suptitle(
        _joined(parts), x=0.01, horizontalalignment="left", fontsize="medium", parse_math=False
    )


def title(ax: Axes, *parts: str, legend_rows: int = 0) -> None:
    """What axes show, left above them and above the rows of a legend that needs the width."""
    ax.set_title(
        _joined(parts),
        loc="left",
        fontsize="medium",
        pad=6.0 + _LEGEND_ROW_PT * legend_rows,
        parse_math=False,
    )


def legend(ax: Axes, handles: Sequence[Artist]) -> None:
    """A legend of two columns on top of the axes, where it covers no data."""
    ax.legend(
        handles=handles,
        loc="lower right",
        bbox_to_anchor=(1.0, 1.0),
        ncols=2,
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


def _joined(parts: tuple[str, ...]) -> str:
    return " · ".join(part for part in parts if part)


MOST_POINTS = 20_000
"""Points a line keeps: an order of magnitude more than a page has pixels."""


def thinned(
    x: Float[np.ndarray, " n"], y: Float[np.ndarray, " n"], most: int = MOST_POINTS
) -> tuple[Float[np.ndarray, " m"], Float[np.ndarray, " m"]]:
    """Keep the ends, and the minimum and maximum of y in equal pieces, in the order they came.

    **Arguments**
    - `x`, `y`: a line; NaN in y is passed over where its piece has numbers.
    - `most`: points that may remain, at least 4; shorter lines come back as they are.

    **Example**
    ```python
    >>> import numpy as np
    >>> from vttig_jax.plotting.style import thinned
    >>> x, y = thinned(np.arange(100.0), np.sin(np.arange(100.0)), 10)
    >>> len(x) <= 10, bool(y.max() == np.sin(np.arange(100.0)).max())
    (True, True)

    ```
    """
    if most < 4:
        raise ValueError(f"Argument `most` must be at least 4, but is {most}.")
    if len(y) <= most:
        return x, y
    width = -(-len(y) // ((most - 2) // 2))
    pieces = np.pad(y, (0, -len(y) % width), constant_values=np.nan).reshape(-1, width)
    hole = np.isnan(pieces)
    starts = np.arange(len(pieces)) * width
    lowest = starts + np.where(hole, np.inf, pieces).argmin(axis=1)
    highest = starts + np.where(hole, -np.inf, pieces).argmax(axis=1)
    kept = np.unique(np.concatenate([lowest, highest, [0, len(y) - 1]]))
    return x[kept], y[kept]
