import dataclasses
import math
import re
from typing import Any

import jax
import numpy as np
import pytest
from hypothesis import assume, given, settings
from scipy.integrate import quad
from scipy.interpolate import PchipInterpolator

from tests.geometry.surface_teeth import any_tooth, between, crowned, tooth
from vttig_jax.base.errors import PairError, UsageError
from vttig_jax.geometry import mesh as meshing
from vttig_jax.geometry.form import form_radius
from vttig_jax.geometry.mesh import gear_mesh
from vttig_jax.geometry.surface import fillet_span, flank_roll, tooth_surface
from vttig_jax.geometry.tooth import SIDES, Side, Taper, Tooth

ALIKE = np.array([20.0, 20.0])
GEARS = {
    "overlapping fillets, unequal flanks": tooth(),
    "overlapping fillets, as on the paper's gear": tooth(
        pressure_angles_deg=ALIKE, fillet_radius_mm=0.76, recession=(crowned(0.0524, 0.0),) * 2
    ),
    "undercut": tooth(12, recession=(crowned(0.02, 0.01), crowned(0.01, 0.0))),
    "spur": tooth(20, recession=(crowned(0.0, 0.0),) * 2, fillet_radius_mm=0.3),
    "hollow": tooth(
        30,
        fillet_radius_mm=0.2,
        recession=(crowned(0.01, 0.02), Taper(0.0, -0.1, 20.0, 0.1)),
    ),
    "sharp cutter": tooth(60, fillet_radius_mm=0.0),
    "winding": tooth(14, fillet_radius_mm=0.3, recession=(crowned(0.6, 0.0), crowned(-0.6, 0.0))),
}


def volume_by_integral(gear: Tooth, bore_mm: float) -> float:
    """N ∫∫ r min(2π/N, ψ_left + ψ_right) dr dz below the tip, from the surface itself."""
    root, tip = float(gear.root_radius), float(gear.tip_radius)
    pitch, half = 2 * math.pi / gear.teeth, float(gear.face_width_mm) / 2
    halves = [_half_angle(gear, side) for side in SIDES]
    radius = root + (tip - root) * (1 - np.cos(np.linspace(0, math.pi, 4001))) / 2
    both = sum(angle(radius) for angle in halves)

    def area(z: float) -> float:
        receded = gear.recessions(np.array([z])).sum() / float(gear.reference_radius)
        return float(np.trapezoid(radius * np.minimum(pitch, both - receded), radius))

    teeth = quad(area, -half, half, epsabs=1e-4, limit=100)[0] * gear.teeth
    return teeth + math.pi * (root**2 - bore_mm**2 / 4) * 2 * half


def _half_angle(gear: Tooth, side: Side):
    """ψ(r) of one side where δ = 0."""
    form, index = form_radius(gear, side), SIDES.index(side)
    still = dataclasses.replace(gear, recession=(crowned(0.0, 0.0),) * 2)
    with jax.disable_jit():  # it would be compiled for each number of teeth
        roll = between(fillet_span(gear, side), 20001)
        x, y, _ = np.asarray(tooth_surface(still, roll, 0.0, side=side, part="fillet")).T
    order = np.argsort(np.hypot(x, y))
    kept = order[np.append(True, np.diff(np.hypot(x, y)[order]) > 1e-12)]
    fillet = PchipInterpolator(np.hypot(x, y)[kept], np.abs(np.arctan2(x, y))[kept])

    def angle(radius: np.ndarray) -> np.ndarray:
        above = np.maximum(radius, form * (1 + 1e-12))
        with np.errstate(invalid="ignore"):  # of the other flank, whose base circle is larger
            flank = np.asarray(still.half_angles(above, np.zeros_like(above)))[:, index]
        return np.where(radius < form, fillet(np.minimum(radius, form)), flank)

    return angle


def crossings(mesh) -> int:
    """Edges that pierce a triangle with which they share no point, by brute force."""
    corners = mesh.vertices[mesh.triangles]
    edges = np.unique(
        np.sort(np.concatenate([mesh.triangles[:, [k, (k + 1) % 3]] for k in range(3)])), axis=0
    )
    start, way = mesh.vertices[edges[:, 0]], mesh.vertices[edges[:, 1]] - mesh.vertices[edges[:, 0]]
    found = 0
    for triangle, (a, b, c) in zip(mesh.triangles, corners, strict=True):
        across = np.cross(way, c - a)
        volume = across @ (b - a)
        safe = np.where(np.abs(volume) > 1e-15, volume, np.nan)
        offset = start - a
        u = (offset * across).sum(axis=1) / safe
        turned = np.cross(offset, b - a)
        v = (way * turned).sum(axis=1) / safe
        t = (turned @ (c - a)) / safe
        tiny = 1e-9
        inside = (u > tiny) & (v > tiny) & (u + v < 1 - tiny) & (t > tiny) & (t < 1 - tiny)
        found += int((inside & ~np.isin(edges, triangle).any(axis=1)).sum())
    return found


OPTIONS = {"teeth": 2}, {"bore_mm": 0.0}, {"teeth": 2, "bore_mm": 0.0}


@pytest.mark.parametrize(
    ("name", "options"),
    [(name, one) for k, name in enumerate(GEARS) for one in ({}, OPTIONS[k % 3])],
)
def test_closed_oriented_and_without_crossings(name, options):
    trimesh = pytest.importorskip("trimesh")
    manifold = pytest.importorskip("manifold3d")
    mesh = gear_mesh(GEARS[name], tolerance_mm=0.05, **options)
    assert trimesh.Trimesh(mesh.vertices, mesh.triangles, process=False).is_volume
    judged = manifold.Manifold(manifold.Mesh64(mesh.vertices, mesh.triangles.astype(np.uint64)))
    assert judged.status() == manifold.Error.NoError
    assert judged.volume() == pytest.approx(mesh.volume_mm3, rel=1e-12)
    assert judged.genus() == (0 if options else 1)
    if "teeth" in options:
        assert crossings(mesh) == 0
    if name == "spur" and options:
        bent = mesh.vertices.copy()
        bent[np.argmax(bent[:, 1]), 0] += 5.0  # the tip over the flank
        assert crossings(dataclasses.replace(mesh, vertices=bent)) > 0


@pytest.mark.slow
@settings(max_examples=12)
@given(any_tooth())
def test_any_gear_is_a_closed_solid_or_told_why_not(gear):
    trimesh = pytest.importorskip("trimesh")
    mesh, words = None, ""
    try:
        mesh = gear_mesh(gear, tolerance_mm=0.05)
    except PairError as error:
        words = str(error)
    assert mesh or words.endswith(".")
    assume(mesh is not None)
    assert mesh is not None
    assert trimesh.Trimesh(mesh.vertices, mesh.triangles, process=False).is_volume
    bore_mm = 0.6 * float(gear.root_radius)
    assert mesh.volume_mm3 == pytest.approx(volume_by_integral(gear, bore_mm), rel=0.02)


@pytest.mark.parametrize("name", GEARS)
def test_volume_is_the_integral_of_the_section(name):
    gear, calls = GEARS[name], []
    expected = volume_by_integral(gear, 0.6 * float(gear.root_radius))
    mesh = gear_mesh(gear, tolerance_mm=0.002, progress=lambda: calls.append(1))
    assert mesh.volume_mm3 == pytest.approx(expected, rel=1e-4) and len(calls) == 2


def test_sectors_add_up():
    gear = GEARS["overlapping fillets, as on the paper's gear"]
    whole = gear_mesh(gear, tolerance_mm=0.05)
    sector = gear_mesh(gear, tolerance_mm=0.05, teeth=9)
    assert sector.teeth == 9 and whole.teeth == 45
    assert 5 * sector.volume_mm3 == pytest.approx(whole.volume_mm3, rel=1e-12)
    assert gear_mesh(gear, tolerance_mm=0.05, teeth=45).volume_mm3 == whole.volume_mm3


def true_points(gear: Tooth) -> np.ndarray:
    """Points of both flanks, and of the fillets above any crossing, of the tooth at x = 0."""
    generator, found = np.random.default_rng(0), []
    with jax.disable_jit():
        for side in SIDES:
            form, tip = form_radius(gear, side), float(gear.tip_radius)
            z = generator.uniform(-10, 10, 150)
            roll = flank_roll(gear, generator.uniform(form, tip, 150), side)
            found.append(np.asarray(tooth_surface(gear, roll, z, side=side)))
            low, high = np.sort(np.asarray(fillet_span(gear, side)))
            roll = generator.uniform(low, high, 150)
            fillet = np.asarray(tooth_surface(gear, roll, z, side=side, part="fillet"))
            inside = np.abs(np.arctan2(fillet[:, 0], fillet[:, 1])) < 0.9 * math.pi / gear.teeth
            found.append(fillet[inside & (np.hypot(fillet[:, 0], fillet[:, 1]) < form)])
    return np.concatenate(found)


@pytest.mark.parametrize(
    ("name", "tolerance_mm"),
    [(name, (0.05, 0.005)[k % 2]) for k, name in enumerate(GEARS) if name != "undercut"],
)
def test_no_point_of_the_surface_is_further_than_the_tolerance(name, tolerance_mm):
    """By brute force over all triangles; the grid is not far finer than needed either."""
    trimesh = pytest.importorskip("trimesh")
    gear = GEARS[name]
    mesh = gear_mesh(gear, tolerance_mm=tolerance_mm, teeth=1)
    corners = mesh.vertices[mesh.triangles]
    distances = []
    for point in true_points(gear)[::2]:
        box = np.abs(corners - point).min(axis=1).max(axis=1)
        near = corners[np.argsort(box)[:400]]
        closest = trimesh.triangles.closest_point(near, np.broadcast_to(point, (len(near), 3)))
        distances.append(np.linalg.norm(closest - point, axis=1).min())
    assert max(distances) <= mesh.error_mm * 1.0001
    assert mesh.error_mm <= tolerance_mm
    assert max(distances) > 0.05 * tolerance_mm


def test_coordinates_are_rounded_before_they_are_measured():
    gear = GEARS["spur"]
    mesh = gear_mesh(gear, tolerance_mm=0.01, teeth=1, rounding=np.float32)
    np.testing.assert_array_equal(mesh.vertices, mesh.vertices.astype(np.float32))
    words = r"coordinates of this file resolve .* or write \.step"
    with pytest.raises(UsageError, match=words) as refused:
        gear_mesh(gear, tolerance_mm=1e-6, teeth=1, rounding=np.float32)
    mesh = gear_mesh(gear, tolerance_mm=asked_for(refused), teeth=1, rounding=np.float32)
    assert mesh.error_mm <= asked_for(refused)


def asked_for(error: pytest.ExceptionInfo[UsageError]) -> float:
    """The tolerance that a refusal proposes, mm."""
    found = re.search(r"--tolerance-um (\S+) or more", str(error.value))
    assert found
    return float(found[1]) * 1e-3


def test_too_many_triangles_are_refused_with_the_tolerance_that_fits(monkeypatch):
    gear, words = GEARS["spur"], r"triangles, more than the memory holds .*or fewer --teeth"
    with pytest.raises(UsageError, match=words):
        gear_mesh(GEARS["overlapping fillets, unequal flanks"], tolerance_mm=1e-8)
    monkeypatch.setattr(meshing, "free_bytes", lambda: 1_000_000)
    with pytest.raises(UsageError, match=words) as refused:
        gear_mesh(gear, tolerance_mm=0.001)
    mesh = gear_mesh(gear, tolerance_mm=asked_for(refused))
    assert 500 < len(mesh.triangles) <= 1_000_000 / 400
    monkeypatch.setattr(meshing, "free_bytes", lambda: 1000)
    with pytest.raises(UsageError, match=r"holds .*; give fewer --teeth"):
        gear_mesh(gear, tolerance_mm=0.001)
    with pytest.raises(UsageError, match="below the accuracy of the file") as refused:
        gear_mesh(gear, tolerance_mm=1e-9)
    assert asked_for(refused) == 1e-8


BAD = {
    "pointed": (tooth(recession=(crowned(0.09, 0.0),) * 2), "pointed at z = 10 mm"),
    "no tooth": (tooth(recession=(crowned(0.2, 0.0),) * 2), "thick on the reference circle"),
    "no width": (tooth(face_width_mm=math.nan), "give its face_width_mm"),
    "cut through": (
        tooth(4, recession=(crowned(0.0, 0.0),) * 2, profile_shift_mm=-0.8),
        "cut through at a radius of 1.7",
    ),
}


def test_gears_that_are_no_solid():
    for name in BAD:
        gear, words = BAD[name]
        with pytest.raises(PairError, match=words):
            gear_mesh(gear, tolerance_mm=0.05)


def test_what_cannot_be_taken_of_a_gear():
    cases: list[tuple[dict[str, Any], str]] = [
        ({"teeth": 21}, "the gear has 20 teeth"),
        ({"bore_mm": 36.0}, "leaves no rim"),
        ({"bore_mm": -1.0}, "leaves no rim"),
    ]
    for options, words in cases:
        with pytest.raises(UsageError, match=words):
            gear_mesh(GEARS["spur"], tolerance_mm=0.05, **options)
        with pytest.raises(ValueError, match="tolerance_mm"):
            gear_mesh(GEARS["spur"], tolerance_mm=0.0)


def test_notes_say_where_fillets_overlap_and_how_deep_the_undercut_is():
    (overlap,) = gear_mesh(
        GEARS["overlapping fillets, as on the paper's gear"], tolerance_mm=0.05
    ).notes
    assert "overlap from z = -10 to -2.4" in overlap and "tip radius of 0.19" in overlap
    assert "undercut by 0.701 mm" in " ".join(gear_mesh(GEARS["undercut"], tolerance_mm=0.05).notes)
    assert gear_mesh(GEARS["spur"], tolerance_mm=0.05).notes == ()


@pytest.mark.parametrize("name", ["spur", "winding"])
def test_bore_is_the_one_asked_for(name):
    """Its triangles look at the axis and are nowhere further inside than the error."""
    mesh = gear_mesh(GEARS[name], tolerance_mm=0.01, bore_mm=12.0)
    on_bore = np.isclose(np.hypot(*mesh.vertices[:, :2].T), 6.0, rtol=1e-9)
    corners = mesh.vertices[mesh.triangles[on_bore[mesh.triangles].all(axis=1)]]
    share = np.random.default_rng(0).dirichlet(np.ones(3), 200)
    inside = np.einsum("sk,tkx->tsx", share, corners)
    radius = np.hypot(inside[..., 0], inside[..., 1])
    assert 6.0 - mesh.error_mm <= radius.min() < 6.0 - 0.002
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert ((normal * corners.mean(axis=1))[:, :2].sum(axis=1) < 0).all()
    assert np.isclose(np.ptp(corners[..., 2]), 20.0)
