"""Surface points and triangles per second: beside NumPy, and beside py_gearworks' tooth curve.

    OMP_NUM_THREADS=1 taskset -c 0 python -m benchmarks.surface_speed [--peer PYTHON]     # 2 min

The driving gear of the paper. Left flank and fillet by `tooth_surface`, and by the same equations
written with NumPy, whose points have to agree to 1e-12 mm before any time is taken. PYTHON is an
interpreter with `py-gearworks` (see `surface_peer.py`); the points of its involute have to lie on
our flank where nothing has receded, to 1e-9 mm. Without it that row is left out. Rows that are
compared run in turns; ratios are medians of those of each round. Meshes are gated by their own
measured error, closed edges, and the volume of the next finer one.

Writes results/surface_speed.json.
"""

import argparse
import json
import math
import statistics
import subprocess
import tempfile
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import jax
import numpy as np

import vttig_jax
from vttig_jax.geometry.mesh import GearMesh, gear_mesh, stl_bytes
from vttig_jax.geometry.surface import Part, fillet_span, flank_span, tooth_surface
from vttig_jax.geometry.tooth import Tooth, tooth_of
from vttig_jax.rig.paper import paper_rig

from .environment import write
from .simulation_cases import ratio, seconds, summary

_SIZES = {"1000 points": (40, 25), "1000000 points": (1000, 1000)}
"""Roll angles × heights."""

_SAME_MM = 1e-12
_ON_FLANK_MM = 1e-9
_PEER_POINTS = 20_000
_TOLERANCES_UM = (10.0, 1.0)


def numpy_surface(tooth: Tooth, roll: np.ndarray, z: np.ndarray, part: Part) -> np.ndarray:
    """The left side by (1), (10), (13) and (14), with arrays and nothing else."""
    alpha = float(tooth.pressure_angles[0])
    sine, cosine, tangent = math.sin(alpha), math.cos(alpha), math.tan(alpha)
    radius, quarter = float(tooth.reference_radius), math.pi * float(tooth.module_mm) / 4
    above, below = float(tooth.addendum_mm), float(tooth.dedendum_mm)
    shift, arc = float(tooth.profile_shift_mm), float(tooth.fillet_radius_mm)
    delta = np.asarray(tooth.recession[0](z))
    phi = roll + delta / radius
    if part == "flank":
        d = sine * (quarter + above * tangent + (above - shift) / tangent + phi * radius - delta)
        x1 = d * sine + delta - quarter - above * tangent
        y1 = d * cosine - above + shift
    else:
        height = shift - below + arc
        along = (arc * (1 - sine) - below) * tangent - quarter - arc * cosine
        across = along + delta - phi * radius
        steep = np.arctan2(abs(height), -math.copysign(1.0, height) * across)
        x1 = along + delta + arc * np.cos(steep)
        y1 = height - arc * np.sin(steep)
    c, s = np.cos(phi), np.sin(phi)
    across, up = x1 - phi * radius, y1 + radius
    return np.stack([across * c + up * s, up * c - across * s, np.broadcast_to(z, phi.shape)], -1)


def points(tooth: Tooth, rounds: int) -> dict[str, Any]:
    """Row 1: points per second of ours and of NumPy's."""
    record: dict[str, Any] = {}
    half = float(tooth.face_width_mm) / 2
    spans: dict[Part, Any] = {"flank": flank_span, "fillet": fillet_span}
    for part, span in spans.items():
        for size, (rolls, heights) in _SIZES.items():
            low, high = np.asarray(span(tooth, "left"))
            roll, z = np.meshgrid(np.linspace(low, high, rolls), np.linspace(-half, half, heights))

            def ours(roll: np.ndarray = roll, z: np.ndarray = z, part: Part = part) -> Any:
                return jax.block_until_ready(tooth_surface(tooth, roll, z, part=part))

            def theirs(roll: np.ndarray = roll, z: np.ndarray = z, part: Part = part) -> Any:
                return numpy_surface(tooth, roll, z, part)

            apart = float(np.abs(np.asarray(ours()) - theirs()).max())
            assert apart < _SAME_MM, f"{part}: {apart:.1e} mm apart"
            repeats = max(1, 100_000 // roll.size)
            row = _beside(ours, theirs, rounds, repeats, roll.size)
            record[f"{part}, {size}"] = row | {"apart_mm": apart}
            print(f"{part}, {size}", record[f"{part}, {size}"])
    return record


def _beside(
    ours: Callable[[], Any], theirs: Callable[[], Any], rounds: int, repeats: int, size: int
) -> dict[str, Any]:
    found: tuple[list[float], list[float]] = ([], [])
    for _ in range(rounds):
        for times, run in zip(found, (ours, theirs), strict=True):
            taken = seconds(lambda run=run: [run() for _ in range(repeats)])
            times.append(taken / repeats)
    return {
        "ours_points_per_s": round(size / statistics.median(found[0])),
        "numpy_points_per_s": round(size / statistics.median(found[1])),
        "ours_ms": summary([1e3 * t for t in found[0]]),
        "numpy_ms": summary([1e3 * t for t in found[1]]),
        "times_numpy": ratio(found[1], found[0]),
    }


def peer(tooth: Tooth, python: str | None, rounds: int) -> dict[str, Any]:
    """Row 2: our flank beside py_gearworks' involute, as many points of one section."""
    if python is None:
        return {"left_out": "no interpreter with py-gearworks was given (--peer)"}
    wanted = {
        "teeth": tooth.teeth,
        "module_mm": float(tooth.module_mm),
        "pressure_angle_deg": float(tooth.pressure_angles_deg[0]),
        "points": _PEER_POINTS,
    }
    low, high = np.asarray(flank_span(tooth, "left"))
    roll = np.linspace(low, high, _PEER_POINTS)
    found: tuple[list[float], list[float]] = ([], [])
    away = math.nan
    with tempfile.TemporaryDirectory() as folder:
        script = Path(__file__).with_name("surface_peer.py")
        with subprocess.Popen(
            [python, str(script), folder],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        ) as process:
            assert process.stdin is not None and process.stdout is not None
            version = json.loads(process.stdout.readline())["version"]
            for _ in range(rounds + 1):
                process.stdin.write(json.dumps(wanted) + "\n")
                process.stdin.flush()
                found[1].append(json.loads(process.stdout.readline())["seconds"])
                away = _off_flank(tooth, np.load(Path(folder) / "peer.npy"))
                assert away < _ON_FLANK_MM, f"py_gearworks' curve is {away:.1e} mm off our flank"
                run = lambda: jax.block_until_ready(tooth_surface(tooth, roll, 0.0))  # noqa: E731
                found[0].append(seconds(lambda run=run: [run() for _ in range(10)]) / 10)
            process.stdin.close()
    ours, theirs = (times[1:] for times in found)
    record = {
        "version": version,
        "off_our_flank_mm": away,
        "ours_points_per_s": round(_PEER_POINTS / statistics.median(ours)),
        "py_gearworks_points_per_s": round(_PEER_POINTS / statistics.median(theirs)),
        "times": ratio(theirs, ours),
        "rounds": rounds,
    }
    print("py_gearworks", record)
    return record


def _off_flank(tooth: Tooth, curve: np.ndarray) -> float:
    """Arc between points of a curve around the x axis and our flank where δ = 0, mm."""
    radius, angle = np.hypot(curve[:, 0], curve[:, 1]), np.arctan2(curve[:, 1], curve[:, 0])
    inside = radius > float(tooth.base_radii[0]) * (1 + 1e-9)
    half = np.asarray(tooth.half_angles(radius[inside], np.zeros(inside.sum())))[:, 0]
    assert np.ptp(radius[inside]) > 2.0  # most of a tooth
    return float((radius[inside] * np.abs(np.abs(angle[inside]) - half)).max())


def meshes(tooth: Tooth, rounds: int) -> dict[str, Any]:
    """Row 3: whole gears as STL."""
    record: dict[str, Any] = {}
    finest = 0.0
    for tolerance in reversed(_TOLERANCES_UM):

        def build(tolerance: float = tolerance) -> GearMesh:
            return gear_mesh(tooth, tolerance_mm=1e-3 * tolerance, rounding=np.float32)

        mesh = build()
        assert mesh.error_mm <= 1e-3 * tolerance and _closed(mesh.triangles)
        finest = finest or mesh.volume_mm3
        assert abs(mesh.volume_mm3 / finest - 1) < 1e-4 * tolerance
        taken = [seconds(build) for _ in range(rounds)]
        data, count = stl_bytes(mesh, "gear"), len(mesh.triangles)
        name = f"{tolerance:g} um"
        record[name] = {
            "triangles": count,
            "error_um": round(1e3 * mesh.error_mm, 3),
            "sections": mesh.sections,
            "MB": round(len(data) / 1e6, 1),
            "s": summary(taken),
            "triangles_per_s": round(count / statistics.median(taken)),
            "stl_s": summary([seconds(lambda mesh=mesh: stl_bytes(mesh, "")) for _ in range(3)]),
        }
        print("mesh", name, record[name])
    return record


def _closed(triangles: np.ndarray) -> bool:
    """Every edge is there once in each direction."""
    edges = np.concatenate([triangles[:, [k, (k + 1) % 3]] for k in range(3)]).astype(np.int64)
    top = edges.max() + 1
    forward = np.sort(edges[:, 0] * top + edges[:, 1])
    backward = np.sort(edges[:, 1] * top + edges[:, 0])
    return bool((np.diff(forward) > 0).all() and (forward == backward).all())


def solids(tooth: Tooth, rounds: int) -> dict[str, Any]:
    """Row 4: the whole gear as STEP."""
    if not find_spec("OCP"):
        return {"left_out": "the extra `cad` is not installed"}
    from vttig_jax.geometry.solid import gear_solid, step_bytes

    solid = gear_solid(tooth, tolerance_mm=1e-3)
    assert solid.error_mm <= 1e-3
    taken = [seconds(lambda: gear_solid(tooth, tolerance_mm=1e-3)) for _ in range(rounds)]
    clock = seconds(lambda: step_bytes(solid, "gear"))
    record = {
        "faces": solid.faces,
        "error_um": round(1e3 * solid.error_mm, 3),
        "MB": round(len(step_bytes(solid, "gear")) / 1e6, 1),
        "s": summary(taken),
        "step_s": round(clock, 2),
    }
    print("STEP", record)
    return record


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--peer", help="interpreter with py-gearworks")
    parser.add_argument("--rounds", type=int, default=11)
    options = parser.parse_args()
    vttig_jax.enable_x64()
    tooth = tooth_of(paper_rig().pair, "driving")
    record = {
        "points": points(tooth, options.rounds),
        "py_gearworks": peer(tooth, options.peer, options.rounds),
        "meshes": meshes(tooth, 3),
        "solids": solids(tooth, 3),
    }
    write("surface_speed.json", record)


if __name__ == "__main__":
    main()
