"""Picture of one transmission error curve."""

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ..base.units import DEG
from ..kinematics.te_curve import TECurve
from .style import (
    FLANK_COLOURS,
    SIGNS,
    Unit,
    driving_axis,
    figure_of,
    grid,
    new_figure,
    title,
    unit_size,
)
from .thinning import thinned


def plot_te(curve: TECurve, *, ax: Axes | None = None, unit: Unit = "arcsec") -> Figure:
    """Transmission error over driving angle.

    **Arguments**
    - `curve`: one run on one flank.
    - `ax`: axes to draw on; a new figure when absent.
    - `unit`: of the transmission error, "arcsec" or "deg".
    """
    size = unit_size(unit)
    if ax is None:
        ax = new_figure(3.6).add_subplot()
    x, y = thinned(curve.driving_angle / DEG, curve.transmission_error / size)
    ax.plot(x, y, color=FLANK_COLOURS[curve.flank], linewidth=0.8, label=f"flank {curve.flank}")
    ax.set_ylabel(f"transmission error [{SIGNS[unit]}]")
    title(ax, f"transmission error, flank {curve.flank}")
    grid(ax)
    driving_axis(ax)
    return figure_of(ax)
