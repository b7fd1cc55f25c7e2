"""Profile and helix diagrams of measured flanks, and the pitch deviation of every tooth."""

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from ..geometry.deviations import Deviations, FlankMap
from ..geometry.flanks import flank_starts
from ..geometry.tooth import SHAFTS, tooth_of
from ..pair.gear_pair import GearPair
from ..pair.schema import FLANKS
from .style import COLOURS, FLANK_COLOURS, heading, labelled, legend, new_figure, panel

_TRACES = 3  # traces per panel
_SPLINE_POINTS = 201  # points of each spline curve; a chosen value
_ROW_IN = 2.3  # height of a row, inch


def plot_deviations(deviations: Deviations, pair: GearPair | None = None) -> Figure:
    """Plot profile, helix and pitch of every measured flank, like a gear measuring machine.

    Each map has a row: on the left the deviation over roll length at up to three values of z, on
    the right over z at up to three roll lengths, in µm, positive for extra material. Dots are the
    measured points, lines the spline through them. Each gear with pitch deviations has a row with
    the deviation of every tooth. All rows have the same scale.

    **Arguments**
    - `deviations`: maps, pitches or both.
    - `pair`: the gears; dashed lines then mark the ends of the flanks (form circle and tip) and of
      the faces.

    **Raises** `ValueError` without any map or pitch.

    **Example**
    ```python
    >>> import numpy as np, vttig_jax
    >>> from vttig_jax.geometry import Deviations, FlankMap
    >>> from vttig_jax.plotting import plot_deviations
    >>> vttig_jax.enable_x64()
    >>> roll, z = np.linspace(8.0, 20.0, 7), np.array([-8.0, 0.0, 8.0])
    >>> relief = FlankMap(roll, z, -0.1 * (roll[:, None] - 14.0) ** 2 + 0.2 * z)
    >>> figure = plot_deviations(Deviations(driving=(relief, None)))
    >>> [axes.get_xlabel() for axes in figure.axes]
    ['roll length [mm]', 'z [mm]']

    ```
    """
    maps = [
        (gear, flank, one)
        for gear in SHAFTS
        for flank, one in zip(FLANKS, getattr(deviations, gear), strict=True)
        if one is not None
    ]
    pitches = {gear: getattr(deviations, f"{gear}_pitch_um") for gear in SHAFTS}
    pitches = {gear: np.asarray(values) for gear, values in pitches.items() if values is not None}
    count = len(maps) + len(pitches)
    if not count:
        raise ValueError("Argument `deviations` must hold a map or pitches, but is empty.")
    figure = new_figure(0.5 + _ROW_IN * count)
    layout = figure.add_gridspec(count, 2)
    first: Axes | None = None
    for row, (gear, flank, flank_map) in enumerate(maps):
        first = profile = figure.add_subplot(layout[row, 0], sharey=first)
        helix = figure.add_subplot(layout[row, 1], sharey=first)
        _draw_map(profile, helix, flank_map, f"{gear} flank {flank}")
        if pair is not None:
            _mark_ends(profile, helix, pair, gear, flank)
    for row, (gear, values) in enumerate(pitches.items(), start=len(maps)):
        first = figure.add_subplot(layout[row, :], sharey=first)
        _draw_pitch(first, values, gear)
    heading(figure, "deviations of the flanks", "" if pair is None else pair.name)
    return figure


def _draw_map(profile: Axes, helix: Axes, flank_map: FlankMap, name: str) -> None:
    roll, z = np.asarray(flank_map.roll_mm), np.asarray(flank_map.z_mm)
    measured, spline = np.asarray(flank_map.deviation_um), flank_map.prepared()
    for ax, kind, label, along, across, points, words in (
        (profile, "profile", "roll length [mm]", roll, z, measured.T, "z = {:g} mm"),
        (helix, "helix", "z [mm]", z, roll, measured, "roll {:.4g} mm"),
    ):
        fine = np.linspace(along[0], along[-1], _SPLINE_POINTS)
        for k, row in enumerate(_trace_indices(len(across))):
            place, colour = np.full(_SPLINE_POINTS, across[row]), COLOURS[6 + k]
            smooth = spline(fine, place) if ax is profile else spline(place, fine)
            key = words.format(across[row])
            ax.plot(fine, np.asarray(smooth), color=colour, linewidth=1.1, label=key)
            ax.plot(along, points[row], ".", color=colour, markersize=5)
        ax.axhline(0.0, color="0.6", linewidth=0.7)
        panel(ax, f"{name}, {kind}", x=label, y="deviation [µm]", legend_rows=1)
        look = {"loc": "lower left", "bbox_to_anchor": (-0.02, 1.0), "handlelength": 1.2}
        legend(ax, labelled(ax), ncols=_TRACES, columnspacing=1.0, **look)


def _trace_indices(count: int) -> list[int]:
    """Return the first, middle and last index without repetition."""
    return sorted({0, count // 2, count - 1})[:_TRACES]


def _draw_pitch(ax: Axes, values: Float[np.ndarray, "2 teeth"], gear: str) -> None:
    teeth = np.arange(1, values.shape[1] + 1)
    for row, flank in enumerate(FLANKS):
        shift = (row - 0.5) * 0.3
        colour = FLANK_COLOURS[flank]
        ax.vlines(teeth + shift, 0.0, values[row], color=colour, linewidth=1.5)
        look = {"color": colour, "markersize": 4, "label": f"flank {flank}"}
        ax.plot(teeth + shift, values[row], ".", **look)
    ax.axhline(0.0, color="0.6", linewidth=0.7)
    ax.xaxis.set_major_locator(MaxNLocator(integer=True))
    ax.set_xlim(0.0, values.shape[1] + 1.0)
    words = f"{gear} gear, single teeth"
    panel(ax, words, x="tooth", y="deviation [µm]", keys=labelled(ax))


def _mark_ends(profile: Axes, helix: Axes, pair: GearPair, gear: str, flank: str) -> None:
    """Mark the ends of the flank (form circle, tip) in `profile`, and of the face in `helix`."""
    number, side = SHAFTS.index(gear), FLANKS.index(flank)
    teeth = tooth_of(pair, "driving"), tooth_of(pair, "driven")
    base, tip = float(pair.base_radii[number, side]), float(pair.tip_radii[number])
    start = float(flank_starts(teeth)[number, side]) * base
    half = float((pair.driving, pair.driven)[number].face_width_mm) / 2
    for ax, ends in ((profile, (start, np.sqrt(tip**2 - base**2))), (helix, (-half, half))):
        for end in ends:
            if np.isfinite(end):
                ax.axvline(end, color="0.6", linewidth=0.8, linestyle="--")
