"""The grid of a tooth: its fineness for a tolerance, and its measured distance from the surface."""

import math
import os
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
from jaxtyping import Float

from ...base.errors import PairError, UsageError
from ..tooth.surface import PARTS
from .gear_profile import GearProfile
from .tooth_grid import ORDER, Counts, ToothGrid, section_curve

_FINER = 6
"""Into how many parts each interval is divided to look between the points."""

_BETWEEN = 1 + 1 / _FINER**2
"""A parabola peaks by at most this above the largest of what is seen of it."""

_LEAST_AREA = 1e-14

_POINTS = 1_000_000
"""Of the true surface that are looked at together."""


def chordal_error(
    grid: ToothGrid, points: Float[np.ndarray, "rows columns 3"]
) -> tuple[float, float]:
    """Largest distance of the true surface from the triangles, mm, and that within the sections.

    The true surface is computed at 6 × 6 places of each quadrilateral, and what may lie between
    them added. Inside it counts the distance from the plane of the triangle there, on its edges
    along the end faces and between two pieces (which may be sharp) that from the edge.

    **Arguments**
    - `grid`: the division of the tooth.
    - `points`: its points as they are written, rounded or not.
    """
    points = np.take_along_axis(points, grid.columns()[..., None], axis=1)
    heights, rows = grid.heights(_FINER), len(points) - 1
    together = max(1, _POINTS // (_FINER**2 * points.shape[1]))
    inside, across = 0.0, 0.0
    for row in range(0, rows, together):
        until = min(row + together, rows)
        true = grid.rows_at(heights[row * _FINER : until * _FINER + 1], _FINER)
        found = _errors(grid, points[row : until + 1], true)
        inside, across = max(inside, found[0]), max(across, found[1])
    return _BETWEEN * max(inside, across), _BETWEEN * across


def _errors(grid: ToothGrid, points: np.ndarray, true: np.ndarray) -> tuple[float, float]:
    """Distances seen in some rows: inside of the quadrilaterals, and within the sections."""
    inside, across = 0.0, 0.0
    steps = np.arange(_FINER + 1) / _FINER
    corners = points[:-1, :-1], points[:-1, 1:], points[1:, 1:], points[1:, :-1]
    planes = _plane(*corners[:3]), _plane(corners[0], corners[2], corners[3])
    rows, columns = points.shape[0] - 1, points.shape[1] - 1
    for up, share_z in enumerate(steps):
        for along, share in enumerate(steps):
            at = true[up : up + rows * _FINER : _FINER, along : along + columns * _FINER : _FINER]
            first, other = planes if share >= share_z else planes[::-1]
            normal = np.where(first[1][..., None], first[0], other[0])
            off = np.abs(((at - corners[0]) * normal).sum(axis=-1))
            inside = max(inside, float(off.max()))
    for low, high, true_edge in _edges(grid, points, true):
        inside = max(inside, _from_edge(low, high, true_edge))
    for row in range(rows + 1):
        true_edge = true[row * _FINER]
        low, high = points[row, :-1], points[row, 1:]
        edge = np.stack([true_edge[k::_FINER][:columns] for k in range(_FINER)])
        across = max(across, _from_edge(low, high, edge))
    return inside, across


def section_error(profile: GearProfile, counts: Counts, z: Float[np.ndarray, " n"]) -> float:
    """Largest distance of flanks and fillets from their chords in sections, mm; lands are arcs."""
    radius, clockwise = section_curve(profile, counts, z, _FINER)
    true = np.stack([radius * np.sin(clockwise), radius * np.cos(clockwise)], axis=-1)
    corners = true[:, ::_FINER]
    curved = np.repeat([part in ("fillet", "flank") for _, part in ORDER], counts.pieces())
    found = 0.0
    for k in range(1, _FINER):
        low, high, at = corners[:, :-1], corners[:, 1:], true[:, k::_FINER]
        found = max(found, _from_edge(low[:, curved], high[:, curved], at[:, curved]))
    return _BETWEEN * found


def _edges(grid: ToothGrid, points: np.ndarray, true: np.ndarray):
    """Edges along the face between two pieces: start, end and the true points from each to each."""
    rows = len(points) - 1
    for column in grid.joints:
        line = true[:, column * _FINER]
        edge = np.stack([line[k::_FINER][:rows] for k in range(_FINER)])
        yield points[:-1, column], points[1:, column], edge


def _plane(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Unit normals of triangles, and which of them have any area."""
    normal = np.cross(b - a, c - a)
    length = np.linalg.norm(normal, axis=-1)
    real = length > _LEAST_AREA
    return np.where(real[..., None], normal / np.where(real, length, 1.0)[..., None], 0.0), real


def _from_edge(low: np.ndarray, high: np.ndarray, at: np.ndarray) -> float:
    """Largest distance of points from the lines through two points each."""
    along = high - low
    length = np.linalg.norm(along, axis=-1, keepdims=True)
    unit = along / np.where(length > 0, length, 1.0)
    away = at - low
    away = away - (away * unit).sum(axis=-1, keepdims=True) * unit
    return float(np.linalg.norm(away, axis=-1).max(initial=0.0))


_ACROSS = 0.55
"""Part of the tolerance that the chords of a section may take; the rest is for the way along."""

_PROBE = 8
_ROUNDS = 24
_TRIANGLE_BYTES = 400
"""Memory a triangle takes at most while a gear is built and written, measured."""

_COARSEST_UM = 1e5
"""Of a tolerance that is proposed."""

_FALLBACK_BYTES = 4 * 2**30


def fitting_grid(
    profile: GearProfile,
    tolerance_mm: float,
    teeth: int,
    rounding: type[np.floating] = np.float64,
) -> tuple[ToothGrid, float]:
    """A grid of one tooth whose triangles stay within a tolerance, and the error measured, mm.

    **Arguments**
    - `profile`: the curves of the gear.
    - `tolerance_mm`: largest distance of the true surface from the triangles.
    - `teeth`: how many the mesh will have; only for the memory.
    - `rounding`: to which the coordinates are rounded when written.

    **Raises** `UsageError` where the mesh would not fit into the memory, or where coordinates of
    this rounding cannot hold the tolerance.
    """
    _check_rounding(profile, tolerance_mm, rounding)
    half = float(profile.tooth.face_width_mm) / 2
    stretches = (-half, *profile.breaks(-half, half), half)

    def estimate(tolerance: float) -> Counts:
        return _estimate(profile, stretches, tolerance)

    grid = ToothGrid(profile, estimate(tolerance_mm), stretches)
    error = math.inf
    for _ in range(_ROUNDS):
        _check_memory(grid.counts, teeth, tolerance_mm, estimate)
        points = grid.points().astype(rounding).astype(float)
        error, across = chordal_error(grid, points)
        if error <= tolerance_mm:
            return grid, error
        grid = replace(grid, counts=_finer(grid.counts, error, across, tolerance_mm))
    raise PairError(
        f"triangles within {1e3 * tolerance_mm:g} µm were not found, {1e3 * error:.3g} µm is left;"
        " give a larger tolerance, or a recession that is smooth.",
        where="recession",
    )


def triangles_of(counts: Counts, teeth: int) -> int:
    """Triangles of the teeth, near enough: the end faces and the bore add some."""
    return 2 * teeth * counts.around * (counts.rows + 1)


def _check_memory(
    counts: Counts, teeth: int, tolerance_mm: float, estimate: Callable[[float], Counts]
) -> None:
    """Raise `UsageError` where a mesh needs more memory than there is."""
    wanted, most = triangles_of(counts, teeth), _free_bytes() // _TRIANGLE_BYTES
    if wanted <= most:
        return
    fits = rounded_up(1e3 * tolerance_mm * wanted / most)  # they fall as 1/tolerance, or slower
    while fits < _COARSEST_UM and 1.3 * triangles_of(estimate(1e-3 * fits), teeth) > most:
        fits = rounded_up(1.01 * fits)
    coarser = f"--tolerance-um {fits:g} or more, or " if fits < _COARSEST_UM else ""
    raise UsageError(
        f"a tolerance of {1e3 * tolerance_mm:g} µm takes about {wanted:.2g} triangles, more than"
        f" the memory holds ({most:.2g}); give {coarser}fewer --teeth."
    )


def rounded_up(value: float) -> float:
    """The next number of one digit."""
    digits = 10.0 ** math.floor(math.log10(value))
    return math.ceil(value / digits * (1 - 1e-9)) * digits


def section_counts(
    profile: GearProfile, z: Float[np.ndarray, " n"], tolerance_mm: float, teeth: int
) -> tuple[Counts, float]:
    """A division around the tooth whose chords stay within a tolerance, and their error, mm."""

    def estimate(tolerance: float) -> Counts:
        return _around(profile, z, tolerance)[0]

    counts = estimate(tolerance_mm)
    while True:
        _check_memory(counts, teeth, tolerance_mm, estimate)
        if (error := section_error(profile, counts, z)) <= tolerance_mm:
            return counts, error
        fillet, flank = (math.ceil(1.1 * n) for n in (counts.fillet, counts.flank))
        counts = replace(counts, fillet=fillet, flank=flank)


def _around(
    profile: GearProfile, z: Float[np.ndarray, " n"], tolerance: float
) -> tuple[Counts, float]:
    """The division, and the longest interval of fillets and flanks, mm."""
    probe = Counts(_PROBE, _PROBE, _PROBE, _PROBE, (1,))
    points, fine = (_plane_curve(profile, probe, z, finer) for finer in (1, 2))
    chord = points[:, 1:] - points[:, :-1]
    length = np.linalg.norm(chord, axis=-1)
    middle = fine[:, 1::2] - points[:, :-1]
    area = np.abs(chord[..., 0] * middle[..., 1] - chord[..., 1] * middle[..., 0])
    sagitta = (area / np.maximum(length, 1e-12)).max(axis=0).reshape(-1, _PROBE).max(axis=1)
    total = length.max(axis=0).reshape(-1, _PROBE).sum(axis=1)
    counts = {}
    for part in PARTS:
        worst = max(s for s, (_, name) in zip(sagitta, ORDER, strict=True) if name == part)
        counts[part] = max(1, math.ceil(_PROBE * math.sqrt(1.1 * worst / tolerance)))
    step = max(
        length / counts[part]
        for length, (_, part) in zip(total, ORDER, strict=True)
        if part in ("fillet", "flank")
    )
    return Counts(**counts, sections=(1,)), step


def _plane_curve(profile: GearProfile, counts: Counts, z: np.ndarray, finer: int = 1) -> np.ndarray:
    radius, clockwise = section_curve(profile, counts, z, finer)
    return np.stack([radius * np.sin(clockwise), radius * np.cos(clockwise)], axis=-1)


def _estimate(profile: GearProfile, stretches: tuple[float, ...], tolerance: float) -> Counts:
    """Around as in sections; along by twist |Δψ| L/(4 n k) and by bending of the joints."""
    ends = np.linspace(stretches[0], stretches[-1], 2 * _PROBE + 1)
    counts, step = _around(profile, np.append(ends, stretches), _ACROSS * tolerance)
    left = 0.5 * (1 - _ACROSS) * tolerance
    sections = []
    for low, high in pairwise(stretches):
        z = np.linspace(low, high, 2 * _PROBE + 1)
        twist = np.abs(np.diff(profile.turned(z), axis=0)).sum(axis=0).max() * step / 4
        coarse = Counts(1, 1, 1, 1, (1,))
        joints = _plane_curve(profile, coarse, z)
        bent = np.linalg.norm(joints[1:-1] - (joints[:-2] + joints[2:]) / 2, axis=-1).max()
        bends = 2 * _PROBE * math.sqrt(bent / left)
        sections.append(max(1, math.ceil(twist / left), math.ceil(bends / 2)))
    return replace(counts, sections=tuple(sections))


def _finer(counts: Counts, error: float, across: float, tolerance: float) -> Counts:
    """The next try: finer sections where these use up their part, else more of them."""
    if across > max(_ACROSS, 0.7) * tolerance:
        factor = math.sqrt(across / (_ACROSS * tolerance))
        return replace(
            counts,
            **{part: math.ceil(counts.of(part) * min(factor, 2.0)) for part in PARTS},
        )
    over = (error - across) / max(tolerance - across, 0.1 * tolerance)
    factor = min(max(1.15, over**0.7), 2.0)
    return replace(counts, sections=tuple(math.ceil(k * factor) for k in counts.sections))


def _check_rounding(profile: GearProfile, tolerance: float, rounding: type[np.floating]) -> None:
    unit = float(np.spacing(rounding(float(profile.tooth.tip_radius))))
    if tolerance < 8 * unit:
        raise UsageError(
            f"coordinates of this file resolve {1e3 * unit:.2g} µm, too coarse for a tolerance of"
            f" {1e3 * tolerance:g} µm; give --tolerance-um {rounded_up(8e3 * unit):g} or more"
            + ("." if rounding is np.float64 else ", or write .ply or .obj.")
        )


def _free_bytes() -> int:
    """Memory that a program can still get, where the system tells it."""
    with suppress(OSError):  # pages that only hold copies of files count here, not in sysconf
        for line in Path("/proc/meminfo").read_text("ascii").splitlines():
            if line.startswith("MemAvailable:"):
                return 1024 * int(line.split()[1])
    with suppress(AttributeError, ValueError, OSError):
        return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") // 2
    return _FALLBACK_BYTES
