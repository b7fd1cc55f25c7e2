"""Picture of the contact of two gears: the teeth in mesh and the contact lines of the flanks."""

import math
from typing import Any

import jax.numpy as jnp
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure

from ..base.units import DEG
from ..geometry.contact import mates_on
from ..geometry.contact_report import Contacts
from ..geometry.outline import Counts, gear_profile, section_curve
from ..geometry.tooth import Tooth
from ..kinematics.flank_model import flank_index
from ..pair.gear_pair import GearPair
from .style import COLOURS, FLANK_COLOURS, MODEL_COLOUR, heading, legend, new_figure, panel, title

_TEETH = 3
"""Number of teeth of each gear drawn on either side of the line of centres; a chosen value."""

_COUNTS = Counts(root=8, fillet=16, flank=32, tip=8, sections=(1,))

_LINES = 12
"""Largest number of driving angles with contact lines; a chosen value."""

_SHADES = LinearSegmentedColormap.from_list("", [(0.25, 0.55, 0.85), (0.05, 0.1, 0.2)])
"""Colours of contact lines from the first angle (0) to the last one (1)."""


def plot_contact(contacts: Contacts, pair: GearPair | None = None, *, place: int = 0) -> Figure:
    """Plot the gears in mesh at one driving angle, and the contact lines from this angle on.

    The left panel shows the section of the first contact: both gears in their positions, including
    eccentricity and displaced axes, and the points of contact. The tilt of the driven axis is too
    small to be visible and is left out. The right panel shows the flank of the driving gear (radius
    over z) with a contact line or point for each of up to twelve driving angles within a pitch.

    **Arguments**
    - `contacts`: result of `contact_at`.
    - `pair`: the gears; the heading has their name.
    - `place`: index of the driving angle.

    **Raises** `ValueError` if no flanks are in contact at this angle.

    **Example**
    ```python
    >>> import numpy as np, vttig_jax
    >>> from vttig_jax import Gear, GearPair
    >>> from vttig_jax.geometry import contact_model
    >>> from vttig_jax.geometry import contact_at
    >>> from vttig_jax.plotting import plot_contact
    >>> vttig_jax.enable_x64()
    >>> gears = Gear(45, 3, 3, 20), Gear(80, 3, 3, 20)
    >>> model = contact_model(GearPair(*gears, module_mm=2.0, pressure_angles_deg=20.0))
    >>> figure = plot_contact(contact_at(model, np.zeros(1), "A"))
    >>> [axes.get_xlabel() for axes in figure.axes]
    ['x, from axis to axis [mm]', 'z [mm]']

    ```
    """
    if not contacts.contact_lines(place):
        raise ValueError(
            f"Argument `place` must be the index of an angle with contact, but {place} has none."
        )
    figure = new_figure(4.6)
    left, right = figure.subplots(1, 2, width_ratios=[1.25, 1.0])
    _draw_mesh(left, contacts, place)
    _draw_flank(right, contacts, place)
    angle = contacts.driving_angle[place] / DEG
    name = (pair and pair.name) or "gear pair"
    heading(figure, "contact", name, f"flank {contacts.flank} at {angle:g}°")
    return figure


def _draw_mesh(ax: Axes, contacts: Contacts, place: int) -> None:
    """Draw both gears in the section of the first contact, around the line of centres."""
    model = contacts.model
    driving, driven = model.teeth
    mounting, z = model.mounting, float(contacts.z_mm[place])
    angle = float(contacts.driving_angle[place])
    driven_angle = float(model.ratio) * angle + float(contacts.transmission_error[place])
    distance = float(mounting.centre_distance)
    driving_offset = mounting.driving_centre(jnp.asarray(angle))
    driven_offset = mounting.driven_centre(jnp.asarray(driven_angle))
    centres = complex(*map(float, driving_offset)), distance + complex(*map(float, driven_offset))
    standing = float(mates_on(model, flank_index(contacts.flank)).standing)
    turned, driven_z = math.pi + standing - driven_angle, -(z + float(mounting.axial))
    outlines = (
        (driving, centres[0], angle, False, z, "driving"),
        (driven, centres[1], turned, True, driven_z, "driven"),
    )
    for number, (tooth, centre, turn, flipped, height, name) in enumerate(outlines):
        radius, clockwise = section_curve(gear_profile(tooth), _COUNTS, np.array([height]))
        # The tooth points along the x axis; a flipped one is seen from the other side.
        outline = radius[0] * np.exp((1j if flipped else -1j) * clockwise[0])
        pitch = 2 * math.pi / tooth.teeth
        nearest = round(((math.pi if flipped else 0.0) - turn) / pitch)
        for step in range(nearest - _TEETH, nearest + _TEETH + 1):
            drawn = centre + outline * np.exp(1j * (turn + step * pitch))
            label = f"{name} gear" if step == nearest else None
            ax.plot(drawn.real, drawn.imag, color=COLOURS[6 + number], linewidth=1.0, label=label)
    for point in _touch_points(driving, contacts, place, centres[0]):
        ax.plot(point.real, point.imag, ".", color=FLANK_COLOURS[contacts.flank], markersize=9)
    pitch_point = distance * driving.teeth / (driving.teeth + driven.teeth)
    half = 2.6 * float(driving.module_mm)
    limits = {"xlim": (pitch_point - half, pitch_point + half), "ylim": (-1.5 * half, 1.5 * half)}
    ax.set(**limits, aspect="equal", xlabel="x, from axis to axis [mm]", ylabel="y [mm]")
    title(ax, f"section z = {z:.4g} mm", legend_rows=1)
    legend(ax, ax.get_legend_handles_labels()[0])


def _touch_points(driving: Tooth, contacts: Contacts, place: int, centre: complex) -> list[complex]:
    """Return the contact points of the tooth pairs in or very near the section of first contact."""
    sign, side = (1.0, 0) if contacts.flank == "A" else (-1.0, 1)
    tolerance = 0.01 * float(np.ptp(contacts.section_z_mm[place]))
    points = []
    for number, line in contacts.contact_lines(place).items():
        distance = np.abs(line[:, 0] - contacts.z_mm[place])
        if distance.min() > tolerance:
            continue
        z, radius = line[np.argmin(distance)]
        half = np.asarray(driving.half_angles(np.array(radius), np.array(z)))[side].item()
        middle = contacts.driving_angle[place] - (number - 1) * 2 * math.pi / driving.teeth
        points.append(centre + radius * np.exp(1j * (middle + sign * half)))
    return points


def _draw_flank(ax: Axes, contacts: Contacts, place: int) -> None:
    """Draw the driving flank (radius over z) with the contact lines of angles within one pitch."""
    driving = contacts.model.teeth[0]
    pitch = 2 * math.pi / driving.teeth
    ahead = contacts.driving_angle - contacts.driving_angle[place]
    within = np.flatnonzero((ahead >= 0) & (ahead < pitch))
    chosen = within[:: max(len(within) // _LINES, 1)][:_LINES]
    for row in chosen:
        share = float(ahead[row] / pitch)
        for line in contacts.contact_lines(int(row)).values():
            line = line[np.argsort(line[:, 0])]
            style = "-" if contacts.line[row] else "."
            ax.plot(line[:, 0], line[:, 1], style, color=_SHADES(share), linewidth=1.0)
    tip, root = float(driving.tip_radius), float(np.min(driving.base_radii))
    for radius, name in ((tip, "tip"), (root, "base")):
        ax.axhline(radius, color=MODEL_COLOUR, linewidth=0.6, linestyle="--")
        side = "bottom" if name == "base" else "top"
        look: dict[str, Any] = {"ha": "right", "va": side, "fontsize": "small"}
        ax.annotate(name, (0.98, radius), xycoords=("axes fraction", "data"), **look)
    if not math.isnan(half := float(driving.face_width_mm) / 2):
        ax.set_xlim(-1.25 * half, 1.25 * half)
    several = len(chosen) > 1
    words = f"{len(chosen)} angles within a pitch, light to dark" if several else "one angle"
    panel(ax, words, x="z [mm]", y="radius on the driving gear [mm]")
