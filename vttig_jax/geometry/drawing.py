"""Section of a gear as a closed line of chords and arcs, and its SVG and DXF files."""

import math
from dataclasses import dataclass
from io import StringIO
from xml.etree import ElementTree

import numpy as np
from jaxtyping import Float

from ..base.errors import UsageError
from ..base.shown_text import shown_name
from .mesh import section_counts
from .outline import Blank, Counts, blank_of, section_curve
from .tooth import Tooth

# Chosen values of SVG files:
_LINE_SHARE = 2e-3  # stroke width as a share of the width of the drawing
_PLACES = 9  # decimal places of a millimetre
_MARGIN = 1.02  # size of the drawing relative to the gear

Line = Float[np.ndarray, "_"]


@dataclass(frozen=True)
class SectionDrawing:
    """Outline of a section with exact arcs, counter-clockwise seen from +z.

    **Arguments**
    - `points`: x, y of the corners, mm.
    - `bulges`: tan(a/4) for the angle a of the arc from each corner to the next, counter-clockwise
      positive; 0 for a straight line.
    - `bore_mm`: diameter of a bore inside the outline; 0 without bore and for a sector, whose
      outline includes the bore.
    - `z_mm`: height of the section.
    - `teeth`: number of teeth drawn.
    - `error_mm`: measured largest distance of the true section from the outline.
    - `notes`: sentences on the geometry of the teeth.
    """

    points: Float[np.ndarray, "n 2"]
    bulges: Float[np.ndarray, " n"]
    bore_mm: float
    z_mm: float
    teeth: int
    error_mm: float
    notes: tuple[str, ...] = ()

    @property
    def area_mm2(self) -> float:
        """Area of the outline with its arcs minus the bore, mm²."""
        x, y = self.points.T
        following = np.roll(self.points, -1, axis=0)
        polygon = (x * following[:, 1] - y * following[:, 0]).sum() / 2
        chord = np.linalg.norm(following - self.points, axis=-1)
        angle = 4 * np.arctan(self.bulges)
        radius2 = np.where(angle != 0, chord / np.where(angle, 2 * np.sin(angle / 2), 1.0), 0) ** 2
        arcs = (radius2 * (angle - np.sin(angle)) / 2).sum()
        return float(polygon + arcs - math.pi * self.bore_mm**2 / 4)


def section_drawing(
    tooth: Tooth,
    z_mm: float = 0.0,
    *,
    tolerance_mm: float = 1e-3,
    teeth: int | None = None,
    bore_mm: float | None = None,
) -> SectionDrawing:
    """Return the outline of a gear at a height; arguments and errors are those of `gear_mesh`.

    Flanks and fillets are chords within the tolerance; tip, root and bore are arcs.

    **Example**
    ```python
    >>> import vttig_jax
    >>> from vttig_jax import Gear, GearPair
    >>> from vttig_jax.geometry import section_drawing, tooth_of
    >>> vttig_jax.enable_x64()
    >>> gears = Gear(45, 3, 3, 20), Gear(80, 3, 3, 20)
    >>> pair = GearPair(*gears, module_mm=2.0, pressure_angles_deg=20.0)
    >>> drawing = section_drawing(tooth_of(pair, "driving"), tolerance_mm=0.01)
    >>> drawing.error_mm <= 0.01, round(drawing.area_mm2)
    (True, 5814)

    ```
    """
    blank = blank_of(
        tooth, teeth=teeth, bore_mm=bore_mm, tolerance_mm=tolerance_mm, section_mm=z_mm
    )
    z = np.array([z_mm])
    counts, error = section_counts(blank.profile, z, tolerance_mm, blank.teeth)
    angles, radii, turns = _outline(blank, counts, z)
    points = np.stack([-radii * np.sin(angles), radii * np.cos(angles)], axis=-1)
    distinct = np.linalg.norm(np.roll(points, -1, axis=0) - points, axis=-1) > 1e-9
    return SectionDrawing(
        points=points[distinct],
        bulges=np.tan(turns / 4)[distinct],
        bore_mm=blank.bore_mm if blank.whole else 0.0,
        z_mm=z_mm,
        teeth=blank.teeth,
        error_mm=error,
        notes=blank.notes,
    )


def _outline(blank: Blank, counts: Counts, z: Line) -> tuple[Line, Line, Line]:
    """Return polar angles, rad, and radii, mm, of the corners and the angles of arcs after them.

    The angle of an arc is in rad; it is 0 for a chord.
    """
    profile = blank.profile
    radius, clockwise = (row[0] for row in section_curve(profile, counts, z))
    foot, corner, other_corner, other_foot = counts.joints[[1, 3, 5, 7]]
    # Corners of one tooth from its right foot to its left foot; the lands between are arcs.
    corners = np.concatenate([np.arange(foot, corner + 1), np.arange(other_corner, other_foot + 1)])
    angle, distance = -clockwise[corners], radius[corners]
    turn = np.zeros(len(corners))
    turn[corner - foot] = angle[corner - foot + 1] - angle[corner - foot]
    turn[-1] = max(angle[0] + profile.pitch - angle[-1], 0.0)
    land = profile.land(z)[0] > 0
    if not land:  # both feet are the same point
        angle, distance, turn = angle[:-1], distance[:-1], turn[:-1]
    shifts = np.arange(blank.teeth)[:, None] * profile.pitch
    angles, radii = (angle + shifts).ravel(), np.tile(distance, blank.teeth)
    turns = np.tile(turn, blank.teeth)
    if blank.whole:
        return angles, radii, turns
    first, last = -clockwise[0], -clockwise[-1] + shifts[-1, 0]
    gap = max(float(angle[0] - first), 0.0)
    turns[-1] = gap if land else 0.0
    with_bore = blank.bore_mm > 0
    inner, arcs = ([last, first], [first - last, 0.0]) if with_bore else ([first], [0.0])
    angles = np.concatenate([[first], angles, [last], inner])
    radii = np.concatenate([[radius[0]], radii, [radius[-1]], [blank.bore_mm / 2] * len(inner)])
    return angles, radii, np.concatenate([[gap], turns, [0.0], arcs])


def svg_bytes(drawing: SectionDrawing, name: str) -> bytes:
    """Return SVG in millimetres with y upwards as in the gear: one path of lines and arcs."""
    (left, low), (right, high) = drawing.points.min(axis=0), drawing.points.max(axis=0)
    width, height = _MARGIN * (right - left), _MARGIN * (high - low)
    corner = (left + right - width) / 2, -(low + high + height) / 2
    root = ElementTree.Element(
        "svg",
        {
            "xmlns": "http://www.w3.org/2000/svg",
            "width": f"{width:.6f}mm",
            "height": f"{height:.6f}mm",
            "viewBox": f"{corner[0]:.6f} {corner[1]:.6f} {width:.6f} {height:.6f}",
        },
    )
    ElementTree.SubElement(root, "title").text = _title(drawing, name)
    path = {
        "d": _path(drawing),
        "fill": "#e6e6e6",
        "fill-rule": "evenodd",
        "stroke": "black",
        "stroke-width": f"{_LINE_SHARE * width:.4f}",
    }
    ElementTree.SubElement(root, "path", path)
    return ElementTree.tostring(root, encoding="utf-8", xml_declaration=True) + b"\n"


def _path(drawing: SectionDrawing) -> str:
    x, y = drawing.points[:, 0], -drawing.points[:, 1]
    commands = [f"M{_mm(x[0], y[0])}"]
    for k, bulge in enumerate(drawing.bulges):
        end = (k + 1) % len(x)
        if bulge == 0:
            commands.append(f"L{_mm(x[end], y[end])}")
            continue
        angle = 4 * math.atan(bulge)
        chord = math.hypot(x[end] - x[k], y[end] - y[k])
        radius = chord / (2 * abs(math.sin(angle / 2)))
        flags = f"{int(abs(angle) > math.pi)} {int(bulge < 0)}"  # SVG has y downwards
        commands.append(f"A{_mm(radius, radius)} 0 {flags} {_mm(x[end], y[end])}")
    commands.append("Z")
    if radius := drawing.bore_mm / 2:
        half = f"A{_mm(radius, radius)} 0 1 0 "
        commands.append(f"M{_mm(radius, 0.0)}{half}{_mm(-radius, 0.0)}{half}{_mm(radius, 0.0)}Z")
    return "".join(commands)


def _mm(*values: float) -> str:
    """Format numbers for SVG without trailing zeros."""
    return " ".join(f"{value:.{_PLACES}f}".rstrip("0").rstrip(".") for value in values)


def dxf_bytes(drawing: SectionDrawing, name: str) -> bytes:
    """Return DXF in millimetres: one closed polyline with bulges, and the circle of the bore.

    **Raises** `UsageError` without `ezdxf`.
    """
    try:
        import ezdxf
    except ImportError as error:
        raise UsageError(
            "a .dxf file needs the extra `cad`; pip install vttig-jax[cad], or write .svg."
        ) from error
    document = ezdxf.new("R2010", units=ezdxf.units.MM)  # type: ignore[attr-defined]
    document.header.custom_vars.append("Title", _title(drawing, name))
    space = document.modelspace()
    line = np.column_stack([drawing.points, drawing.bulges])
    space.add_lwpolyline(line.tolist(), format="xyb", close=True)
    if drawing.bore_mm > 0:
        space.add_circle((0, 0), drawing.bore_mm / 2)
    text = StringIO()
    document.write(text)
    return text.getvalue().encode("utf-8")


def _title(drawing: SectionDrawing, name: str) -> str:
    return f"{shown_name(name)}, section z = {drawing.z_mm:g} mm"
