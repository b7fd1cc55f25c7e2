"""A mesh as binary STL, binary PLY or OBJ: three layouts short enough to need no library."""

from collections.abc import Callable
from io import BytesIO

import numpy as np

from .mesh import GearMesh

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
