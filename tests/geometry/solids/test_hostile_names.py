"""Names that try to break out of the written files, read back by other programs."""

import re
import subprocess
import sys
from io import BytesIO, StringIO
from xml.etree import ElementTree

import numpy as np
import pytest

from tests.geometry.surface_teeth import tooth
from vttig_jax.geometry.drawing import dxf_bytes, section_drawing, svg_bytes
from vttig_jax.geometry.mesh import gear_mesh, stl_bytes

NAMES = (
    "two\nlines",
    "rig\nv 9 9 9\nf 1 2 3",
    "rig\r\nelement vertex 7\r\nend_header",
    "rig\n0\nSECTION\n2\nENTITIES",
    "</title><script>alert(1)</script>",
    "<![CDATA[ ]]> & &amp; ]]>",
    "');DATA;",
    "it''s 'quoted' \"twice\"",
    "back\\slash\\",
    "esc\x1b[2Jbell\x07",
    "nul\x00del\x7f",
    "c1\x9b\x85",
    "\u202egnp.exe\u2066",
    "\u2028line\u2029paragraph",
    "\ufffe\uffff",
    "lone \udcff surrogate",
    "\\X2\\00E4\\X0\\ %%c ^J {\\fArial;}",
    "=cmd|' /C calc'!A0",
    "# comment // /* */ -->",
    "🦷 測定 Ä\u0308",
    "n" * 100_000,
)


@pytest.fixture(scope="module")
def drawing():
    return section_drawing(tooth(), 0.0)


def test_stl():
    trimesh = pytest.importorskip("trimesh")
    mesh = gear_mesh(tooth(), tolerance_mm=0.2, teeth=1, rounding=np.float32)
    for name in NAMES:
        data = stl_bytes(mesh, name)
        found = trimesh.load(BytesIO(data), file_type="stl")
        assert found.is_volume and len(found.faces) == len(mesh.triangles), name
        assert len(data) == len(stl_bytes(mesh, "gear"))
        assert not re.search(rb"[\x1b\x07\x9b]", data[:84])
    record = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    written = np.frombuffer(stl_bytes(mesh, "gear")[84:], record)
    first, second = np.diff(written["corners"].astype(float), axis=1).swapaxes(0, 1)
    across = np.cross(first, second)
    unit = across / np.linalg.norm(across, axis=1, keepdims=True)
    np.testing.assert_allclose(written["normal"], unit, atol=1e-3)


def test_svg(drawing):
    for name in NAMES:
        root = ElementTree.fromstring(svg_bytes(drawing, name))
        title = root.find("{http://www.w3.org/2000/svg}title")
        assert title is not None and title.text is not None and "section z = 0 mm" in title.text
        assert len(list(root.iter())) == len(
            list(ElementTree.fromstring(svg_bytes(drawing, "gear")).iter())
        )


@pytest.mark.slow
def test_dxf(drawing):
    ezdxf = pytest.importorskip("ezdxf")
    expected = len(ezdxf.read(StringIO(dxf_bytes(drawing, "gear").decode())).modelspace())
    for name in NAMES:
        document = ezdxf.read(StringIO(dxf_bytes(drawing, name).decode()))
        assert len(document.modelspace()) == expected, name
        assert "section z = 0 mm" in document.header.custom_vars.get("Title"), name


@pytest.mark.slow
def test_step(tmp_path):
    """The reader of Open CASCADE names every syntax error on stdout, and reads on."""
    pytest.importorskip("OCP")
    from OCP.BRepPrimAPI import BRepPrimAPI_MakeBox  # pyright: ignore[reportAttributeAccessIssue]

    from vttig_jax.geometry.sewing import write_step
    from vttig_jax.geometry.solid import GearSolid, step_bytes

    shape = BRepPrimAPI_MakeBox(1.0, 1.0, 1.0).Shape()
    for number, name in enumerate(NAMES):
        solid = GearSolid(shape, 1, 1, 1, error_mm=0.0, volume_mm3=1.0)
        (tmp_path / f"{number}.step").write_bytes(step_bytes(solid, name))
    assert errors_of_step(tmp_path) == ""
    write_step(shape, tmp_path / "raw.step", "');DATA;")
    assert "Incorrect Syntax" in errors_of_step(tmp_path)


def errors_of_step(folder) -> str:
    """What a new process says when it reads all files; this one has no printers any more."""
    code = (
        "import sys\n"
        "from OCP.STEPControl import STEPControl_Reader\n"
        "for path in sys.argv[1:]: STEPControl_Reader().ReadFile(path)"
    )
    paths = [str(path) for path in folder.glob("*.step")]
    done = subprocess.run(
        [sys.executable, "-c", code, *paths], capture_output=True, text=True, check=True
    )
    return done.stdout
