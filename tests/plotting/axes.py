"""What axes of a picture show."""

import numpy as np
from matplotlib.axes import Axes


def data(ax: Axes, line: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the points of a line."""
    x, y = ax.lines[line].get_data()
    return np.asarray(x), np.asarray(y)


def legend_texts(ax: Axes) -> list[str]:
    """Return the words of the legend."""
    legend = ax.get_legend()
    assert legend is not None
    return [text.get_text() for text in legend.get_texts()]
