"""Picture of a tooth: sections at both ends and in the middle, and thickness along the face."""

import math
from typing import Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from ..geometry.checks import section_report
from ..geometry.form import form_radius
from ..geometry.outline import ORDER, Counts, GearProfile, blank_of, section_curve
from ..geometry.tooth import SIDES, Tooth
from .style import COLOURS, MODEL_COLOUR, figure_legend, heading, labelled, new_figure, panel

_PIECE_COLOURS = {"root": "0.45", "fillet": COLOURS[1], "flank": COLOURS[0], "tip": COLOURS[2]}
_CIRCLES: tuple[tuple[str, Literal["-", "--", ":"]], ...] = (
    ("tip, root circle", "-"),
    ("base circle", "--"),
    ("form circle", ":"),
)
_COUNTS = Counts(8, 24, 24, 8, (1,))
_HALF_WIDTH = 0.62
"""Visible width on either side of the middle of the tooth, as a share of the pitch."""

_TAPER_LIMIT = 1e-6
"""Relative change of the thickness above which a tooth has a thin end; a chosen tolerance."""

_TURN_LIMIT = 0.05
"""Displacement, as a share of the pitch, above which a section is drawn turned upright."""


def plot_tooth(tooth: Tooth, *, name: str = "") -> Figure:
    """Plot three sections of a tooth and its thickness along the face.

    The sections are at the thin end, in the middle and at the thick end, seen from +z. Root,
    fillet, flank and tip have their own colours; the circles are tip, root, base and form circle.
    Sections of helical teeth are turned upright. The panel below shows, over z, the tooth thickness
    at the reference circle and at the tip circle, and the root land.

    **Arguments**
    - `tooth`: a gear with a face width.
    - `name`: name of the gear in the heading.

    **Raises** `PairError` for a gear that has no valid solid: see `gear_mesh`.

    **Example**
    ```python
    >>> import vttig_jax
    >>> from vttig_jax import Gear, GearPair
    >>> from vttig_jax.geometry import tooth_of
    >>> from vttig_jax.plotting import plot_tooth
    >>> vttig_jax.enable_x64()
    >>> gears = Gear(45, 3, 3, 20), Gear(80, 3, 3, 20)
    >>> pair = GearPair(*gears, module_mm=2.0, pressure_angles_deg=20.0)
    >>> [axes.get_xlabel() for axes in plot_tooth(tooth_of(pair, "driving")).axes]
    ['x [mm]', 'x [mm]', 'x [mm]', 'z [mm]']

    ```
    """
    profile = blank_of(tooth, teeth=None, bore_mm=0.0, tolerance_mm=1e-3).profile
    half = float(tooth.face_width_mm) / 2
    thickness = section_report(tooth, [-half, half]).thickness_mm
    tapered = abs(thickness[1] - thickness[0]) > _TAPER_LIMIT * thickness.max()
    thin_end = half if thickness[1] <= thickness[0] or not tapered else -half
    names = ("thin end", "middle", "thick end") if tapered else ("end", "middle", "end")
    figure = new_figure(5.6)
    layout = figure.add_gridspec(2, 3, height_ratios=[1.5, 1.0])
    for k, (section, z) in enumerate(zip(names, (thin_end, 0.0, -thin_end), strict=True)):
        _draw_section(figure.add_subplot(layout[0, k]), profile, section, z, labelled=k == 0)
    _draw_thickness(figure.add_subplot(layout[1, :]), tooth, half)
    handles = [Line2D([], [], color=c, label=part) for part, c in _PIECE_COLOURS.items()]
    handles += [
        Line2D([], [], color="0.6", linewidth=0.7, linestyle=style, label=label)
        for label, style in _CIRCLES
    ]
    figure_legend(figure, handles, 7, handlelength=1.5, columnspacing=1.2)
    heading(figure, f"tooth of {tooth.teeth}", name)
    return figure


def _draw_section(ax: Axes, profile: GearProfile, name: str, z: float, *, labelled: bool) -> None:
    """Draw one tooth in colours, its neighbours in grey and the circles behind."""
    tooth, heights = profile.tooth, np.array([z])
    radius, clockwise = (row[0] for row in section_curve(profile, _COUNTS, heights))
    left, right = profile.rotation(heights)[0]
    turn = float(left - right) / 2
    turn = turn if abs(turn) > _TURN_LIMIT * profile.pitch else 0.0
    clockwise = clockwise - turn
    tip, root = float(tooth.tip_radius), float(tooth.root_radius)
    base, forms = np.asarray(tooth.base_radii), [form_radius(tooth, side) for side in SIDES]
    sweep = np.linspace(-1.5, 1.5, 241) * profile.pitch
    for style, circles in {"-": (tip, root), "--": set(base), ":": set(forms)}.items():
        for r in circles:
            ax.plot(r * np.sin(sweep), r * np.cos(sweep), style, color="0.6", linewidth=0.7)
    for near in (clockwise - profile.pitch, clockwise + profile.pitch):
        ax.plot(radius * np.sin(near), radius * np.cos(near), color="0.8", linewidth=1.2)
    x, y = radius * np.sin(clockwise), radius * np.cos(clockwise)
    joints = _COUNTS.joints
    for k, (_, part) in enumerate(ORDER):
        piece = slice(joints[k], joints[k + 1] + 1)
        ax.plot(x[piece], y[piece], color=_PIECE_COLOURS[part], linewidth=1.8)
    reach = tip * math.sin(min(_HALF_WIDTH * profile.pitch, math.pi / 2))
    low = min(float(y.min()), float(base.min())) - 0.12 * (tip - root)
    ax.set(xlim=(-reach, reach), ylim=(low, tip + 0.12 * (tip - root)), aspect="equal")
    turned = f"x [mm], turned by {math.degrees(turn):.3g}°" if turn else "x [mm]"
    panel(ax, f"{name}, z = {z:g} mm", x=turned, y="y [mm]" if labelled else "")


def _draw_thickness(ax: Axes, tooth: Tooth, half: float) -> None:
    """Draw the tooth thickness and the root land over the face."""
    report = section_report(tooth, np.linspace(-half, half, 81))
    for values, label, colour in (
        (report.thickness_mm, "tooth at the reference circle", MODEL_COLOUR),
        (report.tip_thickness_mm, "tooth at the tip circle", _PIECE_COLOURS["tip"]),
        (report.root_land_mm, "root land", _PIECE_COLOURS["root"]),
    ):
        ax.plot(report.z_mm, values, color=colour, linewidth=1.4, label=label)
    overlap = report.root_land_mm < 0
    if overlap.any():
        look = {"where": list(overlap), "color": "0.85", "label": "fillets overlap"}
        ax.fill_between(report.z_mm, report.root_land_mm, 0.0, **look)
    ax.axhline(0.0, color="0.6", linewidth=0.7)
    for z in (-half, 0.0, half):
        ax.axvline(z, color="0.6", linewidth=0.7, linestyle=":")
    panel(ax, "along the face", x="z [mm]", y="arc [mm]", keys=labelled(ax), legend_rows=2)
