import math
import re
from functools import cache
from io import StringIO
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest

from tests.geometry.surface_teeth import crowned, tooth
from vttig_jax.base.errors import PairError, UsageError
from vttig_jax.geometry.drawing import dxf_bytes, section_drawing, svg_bytes
from vttig_jax.geometry.form import form_radius
from vttig_jax.geometry.mesh import gear_mesh
from vttig_jax.geometry.surface import flank_roll, tooth_surface

GEAR = tooth()
UNDERCUT = tooth(12, recession=(crowned(0.02, 0.0), crowned(0.01, 0.0)))
CASES = [(GEAR, -10.0), (GEAR, 10.0), (UNDERCUT, -10.0), (UNDERCUT, 3.0)]


def polygon(drawing, steps: int = 200) -> np.ndarray:
    """The outline with its arcs as many chords, point by point from the bulges."""
    found = []
    for start, end, bulge in zip(
        drawing.points, np.roll(drawing.points, -1, axis=0), drawing.bulges, strict=True
    ):
        if bulge == 0:
            found.append(start[None])
            continue
        angle = 4 * math.atan(bulge)
        p, q = complex(*start), complex(*end)
        centre = (p + q) / 2 + 1j * (q - p) / 2 / math.tan(angle / 2)
        turned = centre + (p - centre) * np.exp(1j * np.linspace(0, angle, steps)[:-1])
        found.append(np.stack([turned.real, turned.imag], axis=1))
    return np.concatenate(found)


def area(points: np.ndarray) -> float:
    x, y = points.T
    return float((x * np.roll(y, -1) - y * np.roll(x, -1)).sum() / 2)


@cache
def end_areas(teeth: int, options: tuple[tuple[str, float], ...]) -> dict[float, float]:
    """Of the two end faces of a mesh."""
    gear = {45: GEAR, 12: UNDERCUT}[teeth]
    mesh, found = gear_mesh(gear, tolerance_mm=0.002, **dict(options)), {}  # pyright: ignore
    for z in (-10.0, 10.0):
        at = np.abs(mesh.vertices[:, 2] - z) < 1e-9
        flat = mesh.triangles[at[mesh.triangles].all(axis=1)]
        a, b, c = (mesh.vertices[flat[:, k], :2] for k in range(3))
        u, v = b - a, c - a
        found[z] = abs((u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]).sum() / 2)
    return found


@pytest.mark.slow
def test_area_is_that_of_the_outline_and_of_the_mesh():
    kinds: list[dict[str, Any]] = [{}, {"bore_mm": 0.0}, {"teeth": 3}, {"teeth": 3, "bore_mm": 0.0}]
    for gear, z in CASES:
        for options in kinds:
            drawing = section_drawing(gear, z, tolerance_mm=0.001, **options)
            bore = math.pi * drawing.bore_mm**2 / 4
            assert drawing.area_mm2 == pytest.approx(area(polygon(drawing)) - bore, rel=1e-6)
            if abs(z) == 10.0:
                faces = end_areas(gear.teeth, tuple(options.items()))[z]
                assert drawing.area_mm2 == pytest.approx(faces, rel=2e-4)


def test_flanks_lie_within_the_tolerance():
    for tolerance_mm, (gear, z) in zip((0.02, 0.001) * 2, CASES, strict=True):
        drawing = section_drawing(gear, z, tolerance_mm=tolerance_mm)
        form, tip = form_radius(gear, "left"), float(gear.tip_radius)
        roll = flank_roll(gear, np.linspace(form, tip, 301), "left")
        true = np.asarray(tooth_surface(gear, roll, z))[:, :2]
        start, end = drawing.points, np.roll(drawing.points, -1, axis=0)
        straight = drawing.bulges == 0
        start, way = start[straight], (end - start)[straight]
        offset = true[:, None] - start
        share = np.clip((offset * way).sum(-1) / (way**2).sum(-1), 0, 1)
        away = np.linalg.norm(offset - share[..., None] * way, axis=-1).min(axis=1).max()
        assert 0.02 * tolerance_mm < away <= drawing.error_mm <= tolerance_mm


@pytest.mark.parametrize("options", [{}, {"teeth": 2}])
def test_svg_says_the_same(options):
    drawing = section_drawing(GEAR, 0.0, tolerance_mm=0.01, **options)
    root = ElementTree.fromstring(svg_bytes(drawing, "gear <driving> & co"))
    width = float(root.attrib["viewBox"].split()[2])
    assert root.attrib["width"] == f"{width:.6f}mm"
    assert width == pytest.approx(1.02 * np.ptp(drawing.points[:, 0]))
    title, path = root[0], root[1]
    assert title.text == "gear <driving> & co, section z = 0 mm"
    words = re.findall(r"([MLAZ])([^MLAZ]*)", path.attrib["d"])
    ends = np.array(
        [[float(n) for n in text.split()[-2:]] for word, text in words if word in "MLA"]
    )
    ends = ends[: len(drawing.points) + 1] * [1, -1]
    np.testing.assert_allclose(ends[:-1], drawing.points, atol=1e-9)
    np.testing.assert_allclose(ends[-1], drawing.points[0], atol=1e-9)
    arcs = [text.split() for word, text in words if word == "A"]
    count = int((drawing.bulges != 0).sum())
    assert len(arcs) == count + (0 if options else 2)
    radii = {round(float(arc[0]), 3) for arc in arcs[:count]}
    assert radii == {47.0, 42.5} | ({12.75} if options else set())


@pytest.mark.parametrize("options", [{}, {"teeth": 2}])
def test_dxf_read_back(options):
    ezdxf = pytest.importorskip("ezdxf")
    drawing = section_drawing(GEAR, -10.0, tolerance_mm=0.01, **options)
    document = ezdxf.read(StringIO(dxf_bytes(drawing, "gear").decode()))
    assert not document.audit().errors and document.units == ezdxf.units.MM
    line, *circles = document.modelspace()
    points = np.array(list(line.get_points("xyb")))
    assert line.closed
    np.testing.assert_allclose(points, np.column_stack([drawing.points, drawing.bulges]), atol=1e-9)
    assert [circle.dxf.radius for circle in circles] == ([] if options else [12.75])


def test_dxf_without_the_extra_names_it(monkeypatch):
    import sys

    monkeypatch.setitem(sys.modules, "ezdxf", None)
    drawing = section_drawing(GEAR, 0.0, tolerance_mm=0.05)
    with pytest.raises(UsageError, match=r"extra `cad`; pip install vttig-jax\[cad\]"):
        dxf_bytes(drawing, "gear")


def test_sections_that_are_none():
    with pytest.raises(UsageError, match="face ends at ±10 mm"):
        section_drawing(GEAR, 10.5)
    with pytest.raises(PairError, match="pointed"):
        section_drawing(tooth(recession=(crowned(0.09, 0.0),) * 2), 0.0)


def test_a_gear_without_width_has_sections():
    drawing = section_drawing(tooth(face_width_mm=math.nan), 0.0, tolerance_mm=0.01)
    assert drawing.area_mm2 == pytest.approx(section_drawing(GEAR, 0.0, tolerance_mm=0.01).area_mm2)
