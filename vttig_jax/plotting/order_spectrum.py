"""Picture of the fitted orders: amplitudes of both shafts and of the mesh on each flank."""

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from ..identify.orders import Order
from ..identify.result import Fit
from .style import FLANK_COLOURS, figure_legend, grid, heading, new_figure

_SHAFTS = "driving", "driven", "mesh"
_WIDTH = 0.38  # of a bar, orders
_SHIFT = {"A": -_WIDTH / 2, "B": _WIDTH / 2}


def plot_orders(fit: Fit, *, log: bool = True) -> Figure:
    """Plot the amplitude and standard error of every fitted order, flanks A and B side by side.

    Bars of orders that are not significant are hollow.

    **Arguments**
    - `fit`: result of a fit.
    - `log`: whether the axis is logarithmic, so that small pitch orders are readable.
    """
    figure = new_figure(4.2)
    by_shaft = {shaft: [o for o in fit.orders if o.shaft == shaft] for shaft in _SHAFTS}
    by_shaft = {shaft: orders for shaft, orders in by_shaft.items() if orders}
    if not by_shaft:
        ax = figure.add_subplot()
        ax.set_axis_off()
        ax.text(0.5, 0.5, "no order was fitted", ha="center", transform=ax.transAxes)
        return figure
    top = max(fit.orders, key=lambda o: o.amplitude_arcsec)
    # A panel with a single order needs room for its name.
    widths = [max(len({o.order for o in orders}), 2.5) for orders in by_shaft.values()]
    [axes] = figure.subplots(1, len(widths), sharey=True, squeeze=False, width_ratios=widths)
    for ax, (shaft, orders) in zip(axes, by_shaft.items(), strict=True):
        _draw(ax, orders, 0.1 * top.amplitude_arcsec)
        ax.set_xlabel(f"{shaft} order")
    _scale(axes[0], fit.orders, log)
    axes[0].set_ylabel("amplitude at the driven gear [arcsec]")
    largest = f"{top.shaft} {top.order:.5g}, {top.amplitude_arcsec:.3g}″"
    heading(figure, f"order spectrum: the largest is {largest}", fit.pair.name)
    flanks = sorted({o.flank for o in fit.orders})
    keys = [Patch(color=FLANK_COLOURS[flank], label=f"flank {flank}") for flank in flanks]
    if not all(o.significant for o in fit.orders):
        keys.append(Patch(facecolor="none", edgecolor="0.4", label="not significant"))
    figure_legend(figure, keys, len(keys))
    return figure


def _draw(ax: Axes, orders: list[Order], named_arcsec: float) -> None:
    numbers = sorted({o.order for o in orders})
    shift = _SHIFT if len({o.flank for o in orders}) == 2 else {"A": 0.0, "B": 0.0}
    for o in orders:
        colour, place = FLANK_COLOURS[o.flank], numbers.index(o.order) + shift[o.flank]
        size, std, face = o.amplitude_arcsec, o.std_arcsec, colour if o.significant else "none"
        look = {"ecolor": "0.1", "elinewidth": 0.9, "capsize": 2, "capthick": 0.9}
        bars = ax.bar(
            place, size, 0.9 * _WIDTH, yerr=std, facecolor=face, edgecolor=colour, error_kw=look
        )
        if o.amplitude_arcsec >= named_arcsec:
            ax.bar_label(bars, fmt="%.3g", rotation=90, padding=3, fontsize="x-small")
    names = [f"{number:.5g}" for number in numbers]
    ax.set_xticks(range(len(numbers)), names, rotation=30 if max(map(len, names)) > 4 else 0)
    ax.set_xlim(-0.75, len(numbers) - 0.25)
    grid(ax)
    ax.grid(False, axis="x")


def _scale(ax: Axes, orders: tuple[Order, ...], log: bool) -> None:
    """Set the amplitude axis: linear from 0, or logarithmic from a third of the least amplitude.

    An amplitude below its standard error counts as this error, because how far below is chance.
    """
    positive = [max(o.amplitude_arcsec, o.std_arcsec) for o in orders if o.amplitude_arcsec > 0]
    if not log or not positive:
        ax.set_ylim(bottom=0.0)
        return
    ax.set_yscale("log", nonpositive="clip")
    ax.set_ylim(min(positive) / 3, 3.0 * max(o.amplitude_arcsec + o.std_arcsec for o in orders))
    ax.yaxis.set_major_formatter("{x:g}")
