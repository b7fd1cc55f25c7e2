"""Refinement of a tooth grid to a tolerance, and measured distance of the true surface."""

import math
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import numpy as np
from jaxtyping import Float

from ...base.errors import PairError, UsageError
from ...base.files.limits import free_bytes
from ..tooth.surface import PARTS
from .gear_profile import GearProfile
from .tooth_grid import ORDER, Counts, ToothGrid, section_curve

_FINER = 6
"""Number of parts of an interval in which the true surface is evaluated (chosen)."""

_BETWEEN = 1 + 1 / _FINER**2
"""Largest ratio of the peak of a parabola to the largest of its evaluated values."""

_LEAST_AREA = 1e-14  # parallelogram area of a triangle, mm², below which it has no normal; chosen

_POINTS = 1_000_000
"""Number of points of the true surface in one batch (chosen)."""


def chordal_error(
    grid: ToothGrid, points: Float[np.ndarray, "rows columns 3"]
) -> tuple[float, float]:
    """Return the largest distance, mm, of the true surface from the triangles.

    The second result is the largest distance of a section of the true surface from its chords. The
    true surface is evaluated at 6 × 6 points of each quadrilateral; an allowance for the points
    between them is added. The distance inside a quadrilateral is that from the plane of the
    triangle; on edges in sections and between pieces, which may be sharp, it is that from the edge.

    **Arguments**
    - `grid`: grid of the tooth.
    - `points`: points of the grid as written to the file, rounded or not, mm.
    """
    points = np.take_along_axis(points, grid.point_columns()[..., None], axis=1)
    heights, rows = grid.heights(_FINER), len(points) - 1
    batch = max(1, _POINTS // (_FINER**2 * points.shape[1]))
    inside, across = 0.0, 0.0
    for row in range(0, rows, batch):
        end = min(row + batch, rows)
        true = grid.rows_at(heights[row * _FINER : end * _FINER + 1], _FINER)
        errors = _errors(grid, points[row : end + 1], true)
        inside, across = max(inside, errors[0]), max(across, errors[1])
    return _BETWEEN * max(inside, across), _BETWEEN * across


def _errors(grid: ToothGrid, points: np.ndarray, true: np.ndarray) -> tuple[float, float]:
    """Return the largest distances of `true` from the triangles and from the section chords, mm."""
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
    """Return the largest distance of flanks and fillets from their chords in sections, mm.

    Lands are drawn as arcs and have no error.
    """
    radius, clockwise = section_curve(profile, counts, z, _FINER)
    true = np.stack([radius * np.sin(clockwise), radius * np.cos(clockwise)], axis=-1)
    corners = true[:, ::_FINER]
    curved = np.repeat([part in ("fillet", "flank") for _, part in ORDER], counts.pieces())
    error = 0.0
    for k in range(1, _FINER):
        low, high, at = corners[:, :-1], corners[:, 1:], true[:, k::_FINER]
        error = max(error, _from_edge(low[:, curved], high[:, curved], at[:, curved]))
    return _BETWEEN * error


def _edges(grid: ToothGrid, points: np.ndarray, true: np.ndarray):
    """Yield start, end and true points of the edges along the face between two pieces, mm."""
    rows = len(points) - 1
    for column in grid.joints:
        line = true[:, column * _FINER]
        edge = np.stack([line[k::_FINER][:rows] for k in range(_FINER)])
        yield points[:-1, column], points[1:, column], edge


def _plane(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the unit normals of triangles, and which of the triangles have an area."""
    normal = np.cross(b - a, c - a)
    length = np.linalg.norm(normal, axis=-1)
    valid = length > _LEAST_AREA
    return np.where(valid[..., None], normal / np.where(valid, length, 1.0)[..., None], 0.0), valid


def _from_edge(low: np.ndarray, high: np.ndarray, at: np.ndarray) -> float:
    """Return the largest distance of points from the lines through `low` and `high`, mm."""
    along = high - low
    length = np.linalg.norm(along, axis=-1, keepdims=True)
    unit = along / np.where(length > 0, length, 1.0)
    offset = at - low
    offset = offset - (offset * unit).sum(axis=-1, keepdims=True) * unit
    return float(np.linalg.norm(offset, axis=-1).max(initial=0.0))


_ACROSS = 0.55
"""Part of the tolerance for chords in sections; the rest is for errors along the face (chosen)."""

_PROBE = 8  # intervals of a piece in the estimate; chosen
_ROUNDS = 24  # largest number of refinements; chosen
_TRIANGLE_BYTES = 400  # largest memory of a triangle while a gear is built and written; measured
_COARSEST_UM = 1e5  # largest tolerance that a message proposes, µm; chosen


def fitting_grid(
    profile: GearProfile,
    tolerance_mm: float,
    teeth: int,
    rounding: type[np.floating] = np.float64,
) -> tuple[ToothGrid, float]:
    """Return a grid of one tooth whose triangles are within a tolerance, and its error, mm.

    **Arguments**
    - `profile`: curves of the gear.
    - `tolerance_mm`: largest distance of the true surface from the triangles.
    - `teeth`: number of teeth of the mesh; it determines the memory.
    - `rounding`: float type to which the coordinates are rounded when written.

    **Raises** `UsageError` if the mesh does not fit into the memory, or if rounded coordinates
    cannot satisfy the tolerance.
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
        f"triangles within {1e3 * tolerance_mm:g} µm were not found (error {1e3 * error:.3g} µm);"
        " give a larger tolerance, or a recession that is smooth.",
        where="recession",
    )


def triangles_of(counts: Counts, teeth: int) -> int:
    """Return the approximate number of triangles; end faces and bore add a few more."""
    return 2 * teeth * counts.around * (counts.rows + 1)


def _check_memory(
    counts: Counts, teeth: int, tolerance_mm: float, estimate: Callable[[float], Counts]
) -> None:
    """Raise `UsageError` if a mesh needs more memory than is free."""
    needed, most = triangles_of(counts, teeth), free_bytes() // _TRIANGLE_BYTES
    if needed <= most:
        return
    # The number of triangles decreases as 1/tolerance or slower.
    fits = rounded_up(1e3 * tolerance_mm * needed / most)
    while fits < _COARSEST_UM and 1.3 * triangles_of(estimate(1e-3 * fits), teeth) > most:
        fits = rounded_up(1.01 * fits)
    coarser = f"--tolerance-um {fits:g} or more, or " if fits < _COARSEST_UM else ""
    raise UsageError(
        f"a tolerance of {1e3 * tolerance_mm:g} µm needs about {needed:.2g} triangles, more than"
        f" the memory holds ({most:.2g}); give {coarser}fewer --teeth."
    )


def rounded_up(value: float) -> float:
    """Round up to a number with one significant digit."""
    digits = 10.0 ** math.floor(math.log10(value))
    return math.ceil(value / digits * (1 - 1e-9)) * digits


def section_counts(
    profile: GearProfile, z: Float[np.ndarray, " n"], tolerance_mm: float, teeth: int
) -> tuple[Counts, float]:
    """Return interval counts around the tooth for sections at heights z, and the error, mm.

    The chords are within `tolerance_mm` of the curves; `teeth` determines the memory.
    """

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
    """Return interval counts around the tooth, and the longest interval of fillet or flank, mm."""
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
    """Estimate the numbers of intervals around the tooth and along the face.

    The first follow from the sagitta of curves in sections; the second from the twist of the tooth
    and from the bending of the lines between its pieces.
    The error due to twist is |Δψ| s/(4 k), with the rotation Δψ of a stretch, its number of
    sections k and the longest interval s around the tooth.
    """
    ends = np.linspace(stretches[0], stretches[-1], 2 * _PROBE + 1)
    counts, step = _around(profile, np.append(ends, stretches), _ACROSS * tolerance)
    allowance = 0.5 * (1 - _ACROSS) * tolerance
    sections = []
    for low, high in pairwise(stretches):
        z = np.linspace(low, high, 2 * _PROBE + 1)
        twist = np.abs(np.diff(profile.rotation(z), axis=0)).sum(axis=0).max() * step / 4
        coarse = Counts(1, 1, 1, 1, (1,))
        joints = _plane_curve(profile, coarse, z)
        sagitta = np.linalg.norm(joints[1:-1] - (joints[:-2] + joints[2:]) / 2, axis=-1).max()
        bending = 2 * _PROBE * math.sqrt(sagitta / allowance)
        sections.append(max(1, math.ceil(twist / allowance), math.ceil(bending / 2)))
    return replace(counts, sections=tuple(sections))


def _finer(counts: Counts, error: float, across: float, tolerance: float) -> Counts:
    """Return larger counts: around the tooth if the error in sections is too large, else along it.

    `error` is the total error and `across` the error in sections, both in mm.
    """
    if across > max(_ACROSS, 0.7) * tolerance:
        factor = math.sqrt(across / (_ACROSS * tolerance))
        return replace(
            counts,
            **{part: math.ceil(counts.of(part) * min(factor, 2.0)) for part in PARTS},
        )
    excess = (error - across) / max(tolerance - across, 0.1 * tolerance)
    factor = min(max(1.15, excess**0.7), 2.0)
    return replace(counts, sections=tuple(math.ceil(k * factor) for k in counts.sections))


def _check_rounding(profile: GearProfile, tolerance: float, rounding: type[np.floating]) -> None:
    unit = float(np.spacing(rounding(float(profile.tooth.tip_radius))))
    if tolerance < 8 * unit:
        raise UsageError(
            f"coordinates of this file resolve {1e3 * unit:.2g} µm, which is too coarse for a"
            f" tolerance of {1e3 * tolerance:g} µm; give --tolerance-um"
            f" {rounded_up(8e3 * unit):g} or more"
            + ("." if rounding is np.float64 else ", or write .ply or .obj.")
        )
