# pyright: reportMissingImports=false, reportAttributeAccessIssue=false
import sys
from dataclasses import replace

import numpy as np
import pytest

from tests.geometry.solids.test_mesh import true_points
from tests.geometry.surface_teeth import crowned, tooth
from vttig_jax.base.errors import PairError, UsageError
from vttig_jax.geometry.mesh import gear_mesh
from vttig_jax.geometry.outline import gear_profile
from vttig_jax.geometry.solid import gear_solid, require_cad, step_bytes, tooth_patches

SMALL = tooth(14, fillet_radius_mm=0.5, recession=(crowned(0.02, 0.01), crowned(0.03, 0.0)))
OVERLAP = tooth()
WINDING = tooth(14, fillet_radius_mm=0.3, recession=(crowned(0.6, 0.0), crowned(-0.6, 0.0)))


@pytest.fixture
def cad():
    pytest.importorskip("OCP.collections", reason="needs the extra `cad`")
    from vttig_jax.geometry import sewing as solid_sewing

    return solid_sewing


def read_step(path):
    from OCP.STEPControl import STEPControl_Reader  # pyright: ignore[reportAttributeAccessIssue]

    reader = STEPControl_Reader()
    reader.ReadFile(str(path))
    reader.TransferRoots()
    return reader.OneShape()


@pytest.mark.parametrize(
    ("gear", "options"),
    [
        (SMALL, {}),
        (OVERLAP, {"teeth": 3, "bore_mm": 0.0}),
        (WINDING, {"teeth": 3}),
    ],
)
def test_read_back_it_is_the_same_valid_solid(cad, tmp_path, gear, options):
    from OCP.BRepCheck import BRepCheck_Analyzer

    calls = []
    solid = gear_solid(gear, tolerance_mm=0.002, progress=lambda: calls.append(1), **options)
    assert solid.error_mm <= 0.002 and len(calls) == 3
    path = tmp_path / "gear.step"
    path.write_bytes(step_bytes(solid, "gear, – driving"))
    found = read_step(path)
    assert BRepCheck_Analyzer(found).IsValid()
    assert len(cad.faces_of(found)) == solid.faces
    assert cad.volume(found) == pytest.approx(solid.volume_mm3, rel=1e-9)
    mesh = gear_mesh(gear, tolerance_mm=0.001, **options)
    assert solid.volume_mm3 == pytest.approx(mesh.volume_mm3, rel=1e-4)
    text = path.read_text("ascii")
    assert "PRODUCT('gear, ? driving','gear, ? driving'" in text and "Author" not in text


def distances(shape, points: np.ndarray) -> np.ndarray:
    """From points to a shape, by Open CASCADE."""
    from OCP.BRepBuilderAPI import BRepBuilderAPI_MakeVertex
    from OCP.BRepExtrema import BRepExtrema_DistShapeShape
    from OCP.gp import gp_Pnt

    found = []
    for point in points:
        vertex = BRepBuilderAPI_MakeVertex(gp_Pnt(*map(float, point))).Vertex()
        found.append(BRepExtrema_DistShapeShape(vertex, shape).Value())
    return np.array(found)


def test_points_of_the_true_surface_lie_on_its_faces(cad, tmp_path):
    solid = gear_solid(OVERLAP, tolerance_mm=0.001, teeth=1)
    path = tmp_path / "gear.step"
    path.write_bytes(step_bytes(solid, "gear"))
    shell = _shell(read_step(path))
    points = true_points(OVERLAP)[::5]
    assert distances(shell, points).max() <= solid.error_mm
    moved = points * [1.0, 1.001, 1.0]
    assert distances(shell, moved).max() > solid.error_mm


def _shell(shape):
    """Only the surface: points inside of a solid would have no distance."""
    from OCP.TopAbs import TopAbs_ShapeEnum
    from OCP.TopExp import TopExp_Explorer

    return TopExp_Explorer(shape, TopAbs_ShapeEnum.TopAbs_SHELL).Current()


def test_a_tolerance_that_sewing_cannot_hold_is_refused(cad):
    with pytest.raises(UsageError, match=r"below the accuracy of the file; .* 0\.002 or more"):
        gear_solid(SMALL, tolerance_mm=1e-6)


@pytest.mark.slow
def test_a_jump_of_the_recession_is_told():
    def jump(z):
        return np.where(z > 0.3, 0.3, 0.0)

    rough = replace(SMALL, recession=(jump, crowned(0.0, 0.0)))
    with pytest.raises(PairError, match="a recession that is smooth"):
        tooth_patches(gear_profile(rough), 1e-4)


def test_without_the_extra_it_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "OCP.collections", None)
    with pytest.raises(UsageError, match=r"extra `cad` .*pip install vttig-jax\[cad\]"):
        require_cad()
    with pytest.raises(UsageError, match="extra `cad`"):
        gear_solid(SMALL)
