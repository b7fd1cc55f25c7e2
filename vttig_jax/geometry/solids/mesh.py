"""The closed triangle mesh of a gear or of a sector of it, and its STL, PLY and OBJ files."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from io import BytesIO
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from ...base.errors import PairError
from ..tooth.tooth import Tooth
from .blank import Blank, blank_of
from .closing_faces import Triangles, bore_grid, real, rim_face, tooth_face, zipped
from .grid_refinement import fitting_grid
from .tooth_grid import ToothGrid


@dataclass(frozen=True)
class GearMesh:
    """A closed surface, its triangles counter-clockwise seen from outside.

    **Arguments**
    - `vertices`: x, y, z in the frame of the gear, mm; each point once.
    - `triangles`: three vertices each.
    - `teeth`: how many of the gear.
    - `sections`: rows of points along the face.
    - `error_mm`: largest distance of the true surface from the triangles, measured.
    - `notes`: what is worth knowing of the gear.
    """

    vertices: Float[np.ndarray, "points 3"]
    triangles: Int[np.ndarray, "count 3"]
    teeth: int
    sections: int
    error_mm: float
    notes: tuple[str, ...] = ()

    @property
    def volume_mm3(self) -> float:
        """∑ a·(b × c)/6 over the triangles."""
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
    """Mesh a gear within a tolerance: teeth, end faces, bore.

    Rows of points stand in sections, the same number around every tooth. Where the fillets of
    neighbouring teeth overlap, the bottom of the space is the line in which they cross.

    **Arguments**
    - `tooth`: the gear; it needs a face width.
    - `tolerance_mm`: largest distance of the true surface from the triangles; it is measured
      between the points, and the grid made finer until it holds.
    - `teeth`: of a sector, cut in the middle of its outer spaces; all when absent.
    - `bore_mm`: diameter of the bore; 0 for none, 0.3 of the root diameter when absent.
    - `rounding`: float type to which the coordinates are rounded, as the file does.
    - `progress`: called when the grid is found, and when the triangles are there.

    **Raises** `PairError` for teeth that are none (no thickness, pointed, no flank left, no space),
    `UsageError` for a tolerance or bore that cannot be.

    **Example**
    ```python
    >>> import vttig_jax
    >>> from vttig_jax import Gear, GearPair
    >>> from vttig_jax.geometry import gear_mesh
    >>> from vttig_jax.geometry import tooth_of
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
    used[triangles] = True  # those of closed pieces are not
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
    """Numbers of the points: rows of the teeth, then the bore."""

    def __init__(self, grid: ToothGrid, blank: Blank, tolerance_mm: float) -> None:
        self.grid, self.blank = grid, blank
        self.around = blank.teeth * grid.counts.around
        self.width = self.around + (0 if blank.whole else 1)
        self.bore = bore_grid(grid, blank, tolerance_mm, self.width * len(grid.z))

    def vertices(self, points: np.ndarray) -> Float[np.ndarray, "n 3"]:
        """Points of all teeth and of the bore."""
        pitch = self.grid.profile.pitch
        teeth = [_turned(points[:, :-1], k * pitch) for k in range(self.blank.teeth)]
        if not self.blank.whole:
            teeth.append(_turned(points[:, -1:], (self.blank.teeth - 1) * pitch))
        outside = np.concatenate(teeth, axis=1).reshape(-1, 3)
        return np.concatenate([outside, self.bore.points()])

    def triangles(self, points: np.ndarray, vertices: np.ndarray) -> Triangles:
        """Teeth, end faces, bore, cut faces; of one tooth's points, and all points as written."""
        columns, joints = self.grid.columns(), self.grid.joints
        pitch, turned = self.grid.profile.pitch, self.bore.turned
        found = self.bore.triangles()
        for tooth in range(self.blank.teeth):
            at = self._outside(tooth, columns)
            a, b, c, d = at[:-1, :-1], at[:-1, 1:], at[1:, 1:], at[1:, :-1]
            found += [_triangles(a, b, c), _triangles(a, c, d)]
            for row in (0, -1):
                inner = self.bore.row(row, tooth)
                face = [
                    tooth_face(points[row], at[row], joints),
                    rim_face(points[row], at[row], joints, inner, pitch, float(turned[row])),
                ]
                if tooth == 0:
                    _check_face(real(np.concatenate(face)), vertices)
                found += [part if row else part[:, ::-1] for part in face]
        if not self.blank.whole:
            found += self._cuts()
        return real(np.concatenate(found))

    def _cuts(self) -> list[Triangles]:
        """Faces of a sector between the bottom of its outer spaces and the bore."""
        rows = np.arange(len(self.grid.z)) * self.width
        first, last = (
            zipped(rows + column, self.bore.edge(last=column > 0), self.grid.z, self.bore.z)
            for column in (0, self.around)
        )
        return [first, last[:, ::-1]]

    def _outside(self, tooth: int, columns: np.ndarray) -> np.ndarray:
        """Numbers of the points that stand for those of one tooth, row by row."""
        along = tooth * self.grid.counts.around + columns
        rows = np.arange(len(columns))[:, None] * self.width
        return rows + (along % self.width if self.blank.whole else along)


def _turned(points: np.ndarray, angle: float) -> np.ndarray:
    """Counter-clockwise about the axis."""
    x, y, z = np.moveaxis(points, -1, 0)
    cosine, sine = math.cos(angle), math.sin(angle)
    return np.stack([x * cosine - y * sine, x * sine + y * cosine, z], axis=-1)


def _triangles(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> Triangles:
    return np.stack([a.ravel(), b.ravel(), c.ravel()], axis=-1)


def _check_face(triangles: Triangles, vertices: np.ndarray) -> None:
    """Each triangle of an end face has to be counter-clockwise, then none lies over another."""
    a, b, c = (vertices[triangles[:, k], :2] for k in range(3))
    u, v = b - a, c - a
    if not (u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0] > 0).all():
        raise PairError(
            "the end face of the tooth cannot be filled: its outline turns back; take more teeth, a"
            " larger profile shift or a smaller bore.",
            where="end face",
        )


_STL = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
_PLY_FACE = np.dtype([("count", "u1"), ("corners", "<i4", 3)])


def stl_bytes(mesh: GearMesh, name: str) -> bytes:
    """Binary STL: 80 bytes of text, the count, then normal and corners of each triangle in mm."""
    corners = mesh.vertices[mesh.triangles]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(normal, axis=-1, keepdims=True)
    records = np.zeros(len(corners), _STL)
    records["normal"] = normal / np.where(length > 0, length, 1.0)
    records["corners"] = corners
    header = f"vttig {name}, mm".encode("ascii", "replace")[:80].ljust(80)
    return header + np.uint32(len(records)).tobytes() + records.tobytes()


def ply_bytes(mesh: GearMesh, name: str) -> bytes:
    """Binary PLY, little-endian, 64-bit coordinates in mm."""
    faces = np.empty(len(mesh.triangles), _PLY_FACE)
    faces["count"], faces["corners"] = 3, mesh.triangles
    comment = name.encode("ascii", "replace").decode()
    header = (
        f"ply\nformat binary_little_endian 1.0\ncomment vttig {comment}, mm\n"
        f"element vertex {len(mesh.vertices)}\n"
        "property double x\nproperty double y\nproperty double z\n"
        f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    return header.encode("ascii") + mesh.vertices.astype("<f8").tobytes() + faces.tobytes()


def obj_bytes(mesh: GearMesh, name: str) -> bytes:
    """Wavefront OBJ: coordinates in mm to 10⁻⁹, triangles counted from 1."""
    buffer = BytesIO()
    buffer.write(f"# vttig {name}, mm\n".encode())
    np.savetxt(buffer, mesh.vertices, fmt="v %.9f %.9f %.9f")
    np.savetxt(buffer, mesh.triangles + 1, fmt="f %d %d %d")
    return buffer.getvalue()


MESH_FILES: dict[str, tuple[Callable[[GearMesh, str], bytes], type[np.floating]]] = {
    ".stl": (stl_bytes, np.float32),
    ".ply": (ply_bytes, np.float64),
    ".obj": (obj_bytes, np.float64),
}
"""Suffix → what makes the file, and the float type of its coordinates."""
