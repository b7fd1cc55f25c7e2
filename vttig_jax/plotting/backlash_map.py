"""Picture of a backlash map, with or without bands."""

import math

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ..base.errors import NoAnswerError
from ..base.units import DEG, REV
from ..kinematics.backlash_map import BacklashMap, Extreme
from ..posterior.summary.bands import BandedMap
from ..posterior.summary.draws import millimetres
from .curves import thinned
from .style import COLOURS, MODEL_COLOUR, driving_axis, figure_of, labelled, new_figure, panel

_PER_PERIOD = 24  # points per period of the highest order; a chosen value


def plot_map(backlash: BacklashMap, *, ax: Axes | None = None, turns: int | None = None) -> Figure:
    """Plot the backlash over the hunting period, its first-order map and both extremes.

    Shaded angles were not covered on both flanks by the logs. A band shows the interval of a map
    that a delay may shift. The right axis is in mm: axial displacement that closes the backlash if
    the pair has taper, otherwise backlash at the reference circle. A drive has no right axis.

    **Arguments**
    - `backlash`: the map.
    - `ax`: axes to draw on; by default a new figure.
    - `turns`: largest number of driving turns shown; by default the whole hunting period. The title
      gives the turns shown if it is longer; the extremes are those of the whole period.

    **Raises** `NoAnswerError` if the backlash is not a number because one flank was not measured.
    """
    if turns is not None and turns < 1:
        raise ValueError(f"Argument `turns` must be at least 1, but is {turns}.")
    period = backlash.pair.hunting_turns
    shown = min(turns or period, period)
    per_turn = min(_PER_PERIOD * math.ceil(backlash.model.highest_order), 2**20 // shown + 1)
    angle = np.linspace(0.0, shown * REV, shown * per_turn + 1)
    gap = backlash.over(angle)
    if not np.isfinite(gap).all():
        raise NoAnswerError(
            "the backlash map is not a number: one of its flanks was not measured; record both"
            " directions."
        )
    if ax is None:
        ax = new_figure(4.2).add_subplot()
    look = {"color": COLOURS[0], "linewidth": 0.8, "label": "backlash map"}
    ax.plot(*thinned(angle / DEG, gap / DEG), **look)
    if backlash.shift is not None:
        low, high = (end / DEG for end in backlash.interval(gap))
        label = "95 %, with the delay left open"
        ax.fill_between(angle / DEG, low, high, color=COLOURS[0], alpha=0.2, lw=0, label=label)
    if backlash.first_order is not None:
        x, y = thinned(angle / DEG, backlash.first_order_over(angle) / DEG)
        ax.plot(x, y, "--", color=COLOURS[1], linewidth=1.3, label="first order only")
    _shade(ax, backlash, angle)
    ax.set_xlim(0.0, 360.0 * shown)
    driving_axis(ax)
    seen, keys = "backlash of the fitted orders", labelled(ax)
    if not backlash.unknown:
        _mark(ax, backlash.smallest, "v", "smallest", shown)
        _mark(ax, backlash.largest, "^", "largest", shown)
        seen, keys = "backlash, and where it is smallest", [*labelled(ax)[-2:], *keys]
    _add_mm_axis(ax, backlash)
    words = seen, backlash.pair.name, _span(shown, period)
    label = "backlash, angle of the driven gear [°]"
    panel(ax, *words, y=label, keys=keys, legend_rows=math.ceil(len(keys) / 2))
    return figure_of(ax)


def _shade(ax: Axes, backlash: BacklashMap, angle: Float[np.ndarray, " n"]) -> None:
    """Shade the angles that the logs did not cover on both flanks."""
    if backlash.coverage is None:
        return
    between = (angle[1:] + angle[:-1]) / 2
    open_ = np.concatenate([[False], ~backlash.coverage.holds(between), [False]])
    edges = np.flatnonzero(np.diff(open_.astype(np.int8)))
    look = {"color": "0.92", "linewidth": 0, "zorder": 0}
    for first, last in (angle[edges] / DEG).reshape(-1, 2).tolist():
        ax.axvspan(first, last, label="extrapolated: not covered on both flanks", **look)


def _span(shown: int | float, period: int) -> str:
    if shown < period:
        return f"first {shown:.6g} of the {period} turns of the hunting period"
    return f"hunting period of {period} turn{'s' if period > 1 else ''}"


def _mark(ax: Axes, extreme: Extreme, marker: str, name: str, shown: int) -> None:
    """Mark the smallest or largest backlash; beyond the turns shown it is only in the legend."""
    visible = extreme.driving_angle <= shown * REV
    place = [float(extreme.driving_angle) / DEG], [float(extreme.backlash) / DEG]
    point = place if visible else ([], [])
    turn = f", turn {float(extreme.driving_angle) / REV:.2f}" if "turns" in ax.get_xlabel() else ""
    label = f"{name}: {extreme}{turn}" + ("" if visible else ", not shown")
    style = {"color": MODEL_COLOUR, "markersize": 7, "markerfacecolor": "none"}
    ax.plot(*point, marker, label=label, **style)


def _add_mm_axis(ax: Axes, backlash: BacklashMap) -> None:
    """Add the right axis, mm: s = j R₂/(tan β_L + tan β_R), or j R₂ for a pair without taper."""
    radius, axial = millimetres(backlash.pair)
    if not np.isfinite(radius):
        return
    tapered = np.isfinite(axial)
    size = (axial if tapered else radius) * DEG
    right = ax.secondary_yaxis(
        "right",
        functions=(lambda deg: np.asarray(deg) * size, lambda mm: np.asarray(mm) / size),
    )
    label = "axial displacement that closes it [mm]" if tapered else "at the reference circle [mm]"
    right.set_ylabel(label, fontsize="small")


_CLOSE_UP_DEG = 90.0  # width of the panel around the smallest gap; a chosen value


def plot_band_map(
    banded: BandedMap, *, ax: Axes | None = None, turns: float | None = None
) -> Figure:
    """Plot the backlash with its pointwise and simultaneous bands, and its smallest value.

    The inner band contains the gap at one angle, the outer band contains the whole map, each with
    the probability in the legend. The panel below shows a quarter of a turn around the smallest
    gap.

    **Arguments**
    - `banded`: the map with its bands.
    - `ax`: axes to draw on; by default a new figure with a second panel around the smallest gap.
    - `turns`: driving turns shown; by default the whole map.
    """
    if turns is not None and not turns > 0:
        raise ValueError(f"Argument `turns` must be positive, but is {turns:g}.")
    last = min(turns or np.inf, banded.turns) * 360.0
    whole, *below = [ax] if ax is not None else new_figure(6.6).subplots(2, 1)
    _draw(whole, banded, (0.0, last))
    seen, pair, keys = "backlash, and where it is smallest", banded.map.pair, labelled(whole)
    words = seen, pair.name, _span(banded.turns, pair.hunting_turns)
    panel(whole, *words, keys=keys, legend_rows=math.ceil(len(keys) / 2))
    middle = banded.smallest.place[0] / DEG
    span = min(_CLOSE_UP_DEG, 360.0 * banded.turns)
    start = float(np.clip(middle - span / 2, 0.0, max(360.0 * banded.turns - span, 0.0)))
    for close_up in below:
        _draw(close_up, banded, (start, start + span))
        around = start <= middle <= start + span
        panel(close_up, "around the smallest gap" if around else "part of the map")
    return figure_of(whole)


def _draw(ax: Axes, banded: BandedMap, span_deg: tuple[float, float]) -> None:
    band, percent = banded.band, f"{100 * banded.band.probability:.6g} %"
    angle = banded.driving_angle / DEG
    shown = (angle >= span_deg[0] - 1e-9) & (angle <= span_deg[1] + 1e-9)
    angle = angle[shown]
    edges = [
        (band.low_simultaneous, band.high_simultaneous, "0.80", f"{percent} band of the whole map"),
        (band.low, band.high, COLOURS[1], f"{percent} band at one angle"),
    ]
    for low, high, colour, label in edges:
        ends = low[shown] / DEG, high[shown] / DEG
        ax.fill_between(angle, *ends, linewidth=0, color=colour, label=label)
    x, y = thinned(angle, band.centre[shown] / DEG)
    ax.plot(x, y, color=COLOURS[0], linewidth=0.8, label="mean of the draws")
    place, share = banded.smallest.place
    low, median, high = (limit / DEG for limit in banded.smallest.interval)
    inside = span_deg[0] <= place / DEG <= span_deg[1]
    label = f"smallest gap {median:.5f}° ({low:.5f}° … {high:.5f}°), {100 * share:.0f} % here"
    x = [place / DEG] if inside else [np.nan]
    ends = [[median - low], [high - median]]
    ax.errorbar(x, [median], yerr=ends, fmt="none", ecolor=MODEL_COLOUR, capsize=3, zorder=3)
    label = label if inside else label.replace("here", "not shown")
    look = {"color": MODEL_COLOUR, "markersize": 4, "markerfacecolor": "none", "label": label}
    ax.plot(x, [median], "o", zorder=3, **look)
    _shade(ax, banded.map, angle * DEG)
    if low < 0:
        ax.axhline(0.0, color=MODEL_COLOUR, linewidth=0.6)
    ax.set_xlim(*span_deg)
    _add_mm_axis(ax, banded.map)
    panel(ax, y="backlash [° of the driven gear]")
    driving_axis(ax)
