"""Closed triangle mesh of a gear or of a sector, and its STL, PLY and OBJ files."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from io import BytesIO
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from ...base.errors import PairError
from ...base.shown_text import shown_name
from ..tooth.tooth import Tooth
from .blank import Blank, blank_of
from .closing_faces import Triangles, bore_grid, nondegenerate, rim_face, tooth_face, triangle_strip
from .grid_refinement import fitting_grid
from .tooth_grid import ToothGrid


@dataclass(frozen=True)
class GearMesh:
    """Closed triangle mesh; its triangles are counter-clockwise seen from outside.

    **Arguments**
    - `vertices`: x, y, z in the frame of the gear, mm; each point once.
    - `triangles`: three vertex indices for each triangle.
    - `teeth`: number of teeth in the mesh.
    - `sections`: number of rows of points along the face.
    - `error_mm`: measured largest distance of the true surface from the triangles.
    - `notes`: sentences on the geometry of the teeth.
    """

    vertices: Float[np.ndarray, "points 3"]
    triangles: Int[np.ndarray, "count 3"]
    teeth: int
    sections: int
    error_mm: float
    notes: tuple[str, ...] = ()

    @property
    def volume_mm3(self) -> float:
        """Volume ∑ a·(b × c)/6 over the triangles, mm³."""
        a, b, c = (self.vertices[self.triangles[:, k]] for k in range(3))
        return float((a * np.cross(b, c)).sum() / 6)


def gear_mesh(
    tooth: Tooth,
    *,
    tolerance_mm: float = 1e-3,
    teeth: int | None = None,
    bore_mm: float | None = None,
    rounding: type[np.floating] = np.float64,
    progress: Callable[[], Any] = lambda: None,
) -> GearMesh:
    """Mesh a gear within a tolerance: teeth, end faces and bore.

    Rows of points lie in sections, with the same number of points around every tooth. Where the
    fillets of neighbouring teeth overlap, the bottom of the space is their line of intersection.

    **Arguments**
    - `tooth`: gear with a face width.
    - `tolerance_mm`: largest distance of the true surface from the triangles; it is measured
      between the points, and the grid is refined until it is satisfied.
    - `teeth`: number of teeth of a sector, cut in the middle of its outer spaces; by default all.
    - `bore_mm`: diameter of the bore; 0 for none, 0.3 of the root diameter when absent.
    - `rounding`: float type of the file to which the coordinates are rounded.
    - `progress`: function called after the grid is refined and after the triangles are made.

    **Raises** `PairError` for impossible teeth (no thickness, pointed, no flank, no space) and
    `UsageError` for an impossible tolerance or bore.

    **Example**
    ```python
    >>> import vttig_jax
    >>> from vttig_jax import Gear, GearPair
    >>> from vttig_jax.geometry import gear_mesh, tooth_of
    >>> vttig_jax.enable_x64()
    >>> gears = Gear(45, 3, 3, 20), Gear(80, 3, 3, 20)
    >>> pair = GearPair(*gears, module_mm=2.0, pressure_angles_deg=20.0)
    >>> mesh = gear_mesh(tooth_of(pair, "driving"), tolerance_mm=0.02)
    >>> mesh.error_mm <= 0.02, round(mesh.volume_mm3, -2)
    (True, 116300.0)

    ```
    """
    blank = blank_of(tooth, teeth=teeth, bore_mm=bore_mm, tolerance_mm=tolerance_mm)
    grid, error = fitting_grid(blank.profile, tolerance_mm, blank.teeth, rounding)
    progress()
    points = grid.points()
    layout = _Layout(grid, blank, tolerance_mm)
    vertices = layout.vertices(points).astype(rounding).astype(float)
    triangles = layout.triangles(points, vertices)
    used = np.zeros(len(vertices), bool)
    used[triangles] = True  # points of pieces that have no area are in no triangle
    progress()
    return GearMesh(
        vertices=vertices[used],
        triangles=(np.cumsum(used) - 1)[triangles],
        teeth=blank.teeth,
        sections=len(grid.z),
        error_mm=max(error, layout.bore.error_mm),
        notes=blank.notes,
    )


class _Layout:
    """Numbering of the points of the mesh: the points of the teeth come first, then the bore.

    The points of the teeth are numbered section by section along the face width.
    """

    def __init__(self, grid: ToothGrid, blank: Blank, tolerance_mm: float) -> None:
        self.grid, self.blank = grid, blank
        self.around = blank.teeth * grid.counts.around
        self.width = self.around + (0 if blank.whole else 1)
        self.bore = bore_grid(grid, blank, tolerance_mm, self.width * len(grid.z))

    def vertices(self, points: np.ndarray) -> Float[np.ndarray, "n 3"]:
        """Return the points of all teeth and of the bore, mm."""
        pitch = self.grid.profile.pitch
        teeth = [_turned(points[:, :-1], k * pitch) for k in range(self.blank.teeth)]
        if not self.blank.whole:
            teeth.append(_turned(points[:, -1:], (self.blank.teeth - 1) * pitch))
        outside = np.concatenate(teeth, axis=1).reshape(-1, 3)
        return np.concatenate([outside, self.bore.points()])

    def triangles(self, points: np.ndarray, vertices: np.ndarray) -> Triangles:
        """Return the triangles of teeth, end faces, bore and cut faces.

        `points` are those of one tooth, `vertices` all points as written, both in mm.
        """
        columns, joints = self.grid.point_columns(), self.grid.joints
        pitch, rotation = self.grid.profile.pitch, self.bore.rotation
        triangles = self.bore.triangles()
        for tooth in range(self.blank.teeth):
            index = self._outside(tooth, columns)
            a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]
            triangles += [_triangles(a, b, c), _triangles(a, c, d)]
            for row in (0, -1):
                inner, angle = self.bore.row(row, tooth), float(rotation[row])
                face = [
                    tooth_face(points[row], index[row], joints),
                    rim_face(
                        points[row],
                        columns=index[row],
                        joints=joints,
                        inner=inner,
                        pitch=pitch,
                        rotation=angle,
                    ),
                ]
                if tooth == 0:
                    _check_face(nondegenerate(np.concatenate(face)), vertices)
                triangles += [part if row else part[:, ::-1] for part in face]
        if not self.blank.whole:
            triangles += self._cuts()
        return nondegenerate(np.concatenate(triangles))

    def _cuts(self) -> list[Triangles]:
        """Return the triangles of the first and of the last cut face of a sector.

        A sector is cut in the middle of the tooth space at each of its two ends. A cut face reaches
        from the bottom of this space to the bore, over the whole face width. Each triangle is three
        vertex indices, counter-clockwise seen from outside.
        """
        rows = np.arange(len(self.grid.z)) * self.width
        first, last = (
            triangle_strip(rows + column, self.bore.edge(last=column > 0), self.grid.z, self.bore.z)
            for column in (0, self.around)
        )
        return [first, last[:, ::-1]]

    def _outside(self, tooth: int, columns: np.ndarray) -> np.ndarray:
        """Return the vertex indices of the points of one tooth; each section is one row."""
        along = tooth * self.grid.counts.around + columns
        rows = np.arange(len(columns))[:, None] * self.width
        return rows + (along % self.width if self.blank.whole else along)


def _turned(points: np.ndarray, angle: float) -> np.ndarray:
    """Rotate points counter-clockwise about the axis by an angle, rad."""
    x, y, z = np.moveaxis(points, -1, 0)
    cosine, sine = math.cos(angle), math.sin(angle)
    return np.stack([x * cosine - y * sine, x * sine + y * cosine, z], axis=-1)


def _triangles(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> Triangles:
    return np.stack([a.ravel(), b.ravel(), c.ravel()], axis=-1)


def _check_face(triangles: Triangles, vertices: np.ndarray) -> None:
    """Raise `PairError` if a triangle of an end face is clockwise and so overlaps another one."""
    a, b, c = (vertices[triangles[:, k], :2] for k in range(3))
    u, v = b - a, c - a
    if not (u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0] > 0).all():
        raise PairError(
            "the end face of the tooth cannot be meshed because its outline turns back; take more"
            " teeth, a larger profile shift or a smaller bore.",
            where="end face",
        )


_STL = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
_PLY_FACE = np.dtype([("count", "u1"), ("corners", "<i4", 3)])


def stl_bytes(mesh: GearMesh, name: str) -> bytes:
    """Return binary STL: 80 bytes of text, the count, normal and corners of each triangle, mm."""
    corners = mesh.vertices[mesh.triangles]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(normal, axis=-1, keepdims=True)
    records = np.zeros(len(corners), _STL)
    records["normal"] = normal / np.where(length > 0, length, 1.0)
    records["corners"] = corners
    header = f"vttig {shown_name(name)}, mm".encode("ascii", "replace")[:80].ljust(80)
    return header + np.uint32(len(records)).tobytes() + records.tobytes()


def ply_bytes(mesh: GearMesh, name: str) -> bytes:
    """Return binary PLY, little-endian, with 64-bit coordinates in mm."""
    faces = np.empty(len(mesh.triangles), _PLY_FACE)
    faces["count"], faces["corners"] = 3, mesh.triangles
    comment = shown_name(name).encode("ascii", "replace").decode()
    header = (
        f"ply\nformat binary_little_endian 1.0\ncomment vttig {comment}, mm\n"
        f"element vertex {len(mesh.vertices)}\n"
        "property double x\nproperty double y\nproperty double z\n"
        f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    return header.encode("ascii") + mesh.vertices.astype("<f8").tobytes() + faces.tobytes()


def obj_bytes(mesh: GearMesh, name: str) -> bytes:
    """Return Wavefront OBJ with coordinates in mm to 10⁻⁹ and vertices counted from 1."""
    buffer = BytesIO()
    buffer.write(f"# vttig {shown_name(name)}, mm\n".encode())
    np.savetxt(buffer, mesh.vertices, fmt="v %.9f %.9f %.9f")
    np.savetxt(buffer, mesh.triangles + 1, fmt="f %d %d %d")
    return buffer.getvalue()


MESH_FILES: dict[str, tuple[Callable[[GearMesh, str], bytes], type[np.floating]]] = {
    ".stl": (stl_bytes, np.float32),
    ".ply": (ply_bytes, np.float64),
    ".obj": (obj_bytes, np.float64),
}
"""Suffix → function that makes the file, and float type of its coordinates."""
