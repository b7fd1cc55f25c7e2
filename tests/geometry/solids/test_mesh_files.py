from io import BytesIO

import numpy as np
import pytest

from tests.geometry.surface_teeth import tooth
from vttig_jax.geometry.solids.mesh import MESH_FILES, gear_mesh

NAMES = {".stl": 84, ".ply": 0, ".obj": 0}


@pytest.mark.parametrize("suffix", NAMES)
def test_read_back_by_trimesh(suffix):
    trimesh = pytest.importorskip("trimesh")
    write, rounding = MESH_FILES[suffix]
    mesh = gear_mesh(tooth(), tolerance_mm=0.05, teeth=2, rounding=rounding)
    data = write(mesh, "gear – driving")
    found = trimesh.load(BytesIO(data), file_type=suffix[1:])
    assert found.is_volume and len(found.faces) == len(mesh.triangles)
    assert found.volume == pytest.approx(mesh.volume_mm3, rel=1e-9)
    np.testing.assert_allclose(
        found.bounds, [mesh.vertices.min(0), mesh.vertices.max(0)], atol=1e-9
    )
    if suffix == ".stl":
        assert len(data) == 84 + 50 * len(mesh.triangles)
        assert not data.startswith(b"solid")  # a reader would take it for text
        np.testing.assert_allclose(found.face_normals, _normals(mesh), atol=1e-5)


def _normals(mesh):
    a, b, c = (mesh.vertices[mesh.triangles[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    return normal / np.linalg.norm(normal, axis=1, keepdims=True)
