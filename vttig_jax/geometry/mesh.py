"""Closed triangle mesh of a gear or of a sector, and its STL file."""

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from ..base.errors import PairError, UsageError
from ..base.files.limits import free_bytes
from ..base.shown_text import shown_name
from .outline import ORDER, Blank, Counts, GearProfile, ToothGrid, blank_of, section_points
from .surface import PARTS, turned
from .tooth import Tooth

Triangles = Int[np.ndarray, "_ 3"]
Line = Int[np.ndarray, "_"]
Keys = Float[np.ndarray, "_"]

_FOLLOWS = 0.5
"""Rotation of the spaces, in half pitches, above which the bore rotates with them (chosen)."""

_SHARE = 0.9
"""Part of the tolerance that the chords of the bore may use (chosen)."""

_STL = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])


@dataclass(frozen=True)
class GearMesh:
    """Closed triangle mesh; its triangles are counter-clockwise seen from outside.

    **Arguments**
    - `vertices`: x, y, z in the frame of the gear, mm; each point once.
    - `triangles`: three vertex indices for each triangle.
    - `teeth`: number of teeth in the mesh.
    - `sections`: number of rows of points along the face.
    - `error_mm`: measured largest distance of the true surface from the triangles.
    - `notes`: sentences on the geometry of the teeth.
    """

    vertices: Float[np.ndarray, "points 3"]
    triangles: Int[np.ndarray, "count 3"]
    teeth: int
    sections: int
    error_mm: float
    notes: tuple[str, ...] = ()

    @property
    def volume_mm3(self) -> float:
        """Volume ∑ a·(b × c)/6 over the triangles, mm³."""
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
    """Mesh a gear within a tolerance: teeth, end faces and bore.

    Rows of points lie in sections, with the same number of points around every tooth. Where the
    fillets of neighbouring teeth overlap, the bottom of the space is their line of intersection.

    **Arguments**
    - `tooth`: gear with a face width.
    - `tolerance_mm`: largest distance of the true surface from the triangles; it is measured
      between the points, and the grid is refined until it is satisfied.
    - `teeth`: number of teeth of a sector, cut in the middle of its outer spaces; by default all.
    - `bore_mm`: diameter of the bore; 0 for none, 0.3 of the root diameter when absent.
    - `rounding`: float type of the file to which the coordinates are rounded.
    - `progress`: function called after the grid is refined and after the triangles are made.

    **Raises** `PairError` for impossible teeth (no thickness, pointed, no flank, no space) and
    `UsageError` for an impossible tolerance or bore.

    **Example**
    ```python
    >>> import vttig_jax
    >>> from vttig_jax import Gear, GearPair
    >>> from vttig_jax.geometry import gear_mesh, tooth_of
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
    bore = _Bore(grid, blank, tolerance_mm)
    points = grid.points()
    vertices = _vertices(points, bore, blank).astype(rounding).astype(float)
    triangles = _triangles(grid, points, vertices, bore, blank)
    used = np.zeros(len(vertices), bool)
    used[triangles] = True  # points of pieces that have no area are in no triangle
    progress()
    return GearMesh(
        vertices=vertices[used],
        triangles=(np.cumsum(used) - 1)[triangles],
        teeth=blank.teeth,
        sections=len(grid.z),
        error_mm=max(error, bore.error_mm),
        notes=blank.notes,
    )


class _Bore:
    """Rows of points on the bore: at both ends, or in all sections if it winds with helical teeth.

    Each row has `per_pitch` intervals in a pitch; without bore it is one point on the axis.
    """

    def __init__(self, grid: ToothGrid, blank: Blank, tolerance_mm: float) -> None:
        pitch = grid.profile.pitch
        self.radius, self.per_pitch, self.error_mm = blank.bore_mm / 2, 0, 0.0
        self.z, self.rotation = grid.z, np.zeros(len(grid.z))
        if self.radius > 0:
            self.rotation = bore_rotation(grid.profile, self.z)
            widest = 2 * math.acos(max(1 - _SHARE * tolerance_mm / self.radius, 0.5))
            self.per_pitch = math.ceil(pitch / widest)
        if not self.rotation.any():
            self.z, self.rotation = self.z[[0, -1]], self.rotation[[0, -1]]
        if self.per_pitch:
            step = max(pitch / self.per_pitch, float(np.abs(np.diff(self.rotation)).max()))
            self.error_mm = self.radius * (1 - math.cos(step / 2))


def _numbers(blank: Blank, rows: int, per_pitch: int, first: int = 0) -> Int[np.ndarray, "_ _"]:
    """Return the numbers of the points of rows around the gear, counted from `first`.

    Around a whole gear the last point of a row is its first one.
    """
    count = blank.teeth * per_pitch
    width = max(count if blank.whole else count + 1, 1)
    return first + np.arange(rows)[:, None] * width + np.arange(count + 1) % width


def _vertices(points: np.ndarray, bore: _Bore, blank: Blank) -> Float[np.ndarray, "n 3"]:
    """Return the points of all teeth by section and then those of the bore, mm."""
    pitch = blank.profile.pitch
    teeth = [rotated(points[:, :-1], k * pitch) for k in range(blank.teeth)]
    if not blank.whole:
        teeth.append(rotated(points[:, -1:], (blank.teeth - 1) * pitch))
    outside = np.concatenate(teeth, axis=1).reshape(-1, 3)
    width = 1 + np.ptp(_numbers(blank, 1, bore.per_pitch))
    around = np.arange(width) * (pitch / max(bore.per_pitch, 1))
    inside = on_circle(bore.radius, bore.rotation[:, None] - pitch / 2 + around, bore.z)
    return np.concatenate([outside, inside.reshape(-1, 3)])


def _triangles(
    grid: ToothGrid, points: np.ndarray, vertices: np.ndarray, bore: _Bore, blank: Blank
) -> Triangles:
    """Return the triangles of bore, teeth, end faces and cut faces, seen from outside.

    `points` are those of one tooth, `vertices` all points as written, both in mm.
    """
    columns, around = grid.point_columns(), grid.counts.around
    outer = _numbers(blank, len(grid.z), around)
    inner = _numbers(blank, len(bore.z), bore.per_pitch, int(outer.max()) + 1)
    pitches = [slice(k * bore.per_pitch, (k + 1) * bore.per_pitch + 1) for k in range(blank.teeth)]
    triangles = []
    for row in range(len(bore.z) - 1 if bore.per_pitch else 0):
        increasing = bore.rotation[row + 1] > bore.rotation[row]
        for pitch in pitches:
            low, high = inner[row, pitch], inner[row + 1, pitch]
            a, b, c, d = low[:-1], low[1:], high[1:], high[:-1]
            # With the shorter diagonal no triangle spans a larger arc than its longest side.
            halves = ((a, d, b), (b, d, c)) if increasing else ((a, c, b), (a, d, c))
            triangles += _stacked(*halves)
    for tooth, pitch in enumerate(pitches):
        index = np.take_along_axis(outer, tooth * around + columns, axis=1)
        a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]
        triangles += _stacked((a, b, c), (a, c, d))
        for row in (0, -1):
            turn = float(bore.rotation[row])
            face = _end_face(grid, points[row], index[row], inner[row, pitch], turn)
            if tooth == 0:
                _check_face(_nondegenerate(np.concatenate(face)), vertices)
            triangles += [part if row else part[:, ::-1] for part in face]
    if not blank.whole:
        # A cut face reaches from the bottom of an outer space to the bore.
        for column, order in ((0, 1), (-1, -1)):
            cut = _strip(outer[:, column], inner[:, column], grid.z, bore.z)
            triangles.append(cut[:, ::order])
    return _nondegenerate(np.concatenate(triangles))


def _stacked(*corners: tuple[np.ndarray, ...]) -> list[Triangles]:
    return [np.stack([one.ravel() for one in three], axis=-1) for three in corners]


def _strip(first: Line, second: Line, first_key: Keys, second_key: Keys) -> Triangles:
    """Return triangles between two lines of points, in the order of the edges of both lines.

    A triangle has a point of the first line, the next point and a point of the second line. It is
    counter-clockwise if the second line lies to the left of the first. The keys are the positions
    of the points along the lines; a single point gives a fan.
    """
    ends = (first_key[1:] + first_key[:-1]) / 2, (second_key[1:] + second_key[:-1]) / 2
    order = np.argsort(np.concatenate(ends), kind="stable")
    on_first = order < len(ends[0])
    a = np.concatenate([[0], np.cumsum(on_first)])[:-1]
    b = np.concatenate([[0], np.cumsum(~on_first)])[:-1]
    next_a, next_b = np.minimum(a + 1, len(first) - 1), np.minimum(b + 1, len(second) - 1)
    return np.stack([first[a], np.where(on_first, first[next_a], second[next_b]), second[b]], -1)


def _end_face(
    grid: ToothGrid, points: np.ndarray, index: np.ndarray, inner: np.ndarray, rotation: float
) -> list[Triangles]:
    """Return the triangles of an end face of one pitch, counter-clockwise seen from +z.

    The first are those of the tooth, above the line between its two feet, the others reach from
    the feet to the bore. `points` are those of the section, mm, and `index` their numbers in the
    mesh; `inner` are the numbers of the points on the bore, evenly from one space to the next,
    turned counter-clockwise by `rotation`, rad.
    """
    foot, corner, middle, other_corner, other_foot, last = grid.counts.joints[[1, 3, 4, 5, 7, 8]]
    key = np.hypot(points[:, 0], points[:, 1])
    # The radius is constant along the tip, so the key increases there to its middle.
    top = max(key[corner], key[other_corner])
    key[corner : middle + 1] = top + np.linspace(0.0, 1.0, middle - corner + 1)
    key[middle : other_corner + 1] = top + np.linspace(1.0, 0.0, other_corner - middle + 1)
    right, left = np.arange(foot, middle + 1), np.arange(other_foot, middle - 1, -1)
    outer = np.concatenate([np.arange(foot + 1), np.arange(other_foot, last + 1)])
    x, y, _ = rotated(points[outer], -rotation).T
    half = grid.profile.pitch / 2
    bore_angles = np.linspace(-half, half, len(inner))
    return [
        index[_strip(right, left, key[right], key[left])],
        _strip(index[outer], inner, np.arctan2(-x, y), bore_angles),
    ]


def _nondegenerate(triangles: Triangles) -> Triangles:
    """Return the triangles without those that have the same point at two corners."""
    a, b, c = triangles.T
    return triangles[(a != b) & (b != c) & (c != a)]


def bore_rotation(profile: GearProfile, z: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Return the rotation of the bore with the teeth, rad; 0 if the teeth hardly rotate.

    The middle of a space rotates by as much; for helical teeth it can exceed a turn.
    """
    starts, turns = profile.starts(z), profile.rotation(z)
    halves = enumerate((profile.left, profile.right))
    left, right = (half(starts[:, k])[1] - turns[:, k] for k, half in halves)
    rotation = (left - right) / 2
    follows = np.abs(rotation).max() > _FOLLOWS * profile.pitch / 2
    return rotation if follows else np.zeros_like(rotation)


def on_circle(
    radius: float, angle: Float[np.ndarray, "rows columns"], z: Float[np.ndarray, " rows"]
) -> Float[np.ndarray, "rows columns 3"]:
    """Return points on a circle about the axis, mm, at angles counter-clockwise from y, rad."""
    x, y = -radius * np.sin(angle), radius * np.cos(angle)
    return np.stack(np.broadcast_arrays(x, y, z[:, None]), axis=-1)


def rotated(points: Float[np.ndarray, "*shape 3"], angle: float) -> Float[np.ndarray, "*shape 3"]:
    """Rotate points counter-clockwise about the axis by an angle, rad."""
    x, y, z = np.moveaxis(points, -1, 0)
    return np.asarray(turned(x, y, z, np.asarray(-angle)))


def _check_face(triangles: Triangles, vertices: np.ndarray) -> None:
    """Raise `PairError` if a triangle of an end face is clockwise and so overlaps another one."""
    a, b, c = (vertices[triangles[:, k], :2] for k in range(3))
    u, v = b - a, c - a
    if not (u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0] > 0).all():
        raise PairError(
            "the end face of the tooth cannot be meshed because its outline turns back; take more"
            " teeth, a larger profile shift or a smaller bore.",
            where="end face",
        )


def stl_bytes(mesh: GearMesh, name: str) -> bytes:
    """Return binary STL: 80 bytes of text, the count, normal and corners of each triangle, mm."""
    corners = mesh.vertices[mesh.triangles]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(normal, axis=-1, keepdims=True)
    records = np.zeros(len(corners), _STL)
    records["normal"] = normal / np.where(length > 0, length, 1.0)
    records["corners"] = corners
    header = f"vttig {shown_name(name)}, mm".encode("ascii", "replace")[:80].ljust(80)
    return header + np.uint32(len(records)).tobytes() + records.tobytes()


_FINER = 6
"""Number of parts of an interval in which the true surface is evaluated (chosen)."""

_BETWEEN = 1 + 1 / _FINER**2
"""Largest ratio of the peak of a parabola to the largest of its evaluated values."""

_ACROSS = 0.55
"""Part of the tolerance for chords in sections; the rest is for errors along the face (chosen)."""

# Chosen values, but the memory of a triangle, which is measured:
_LEAST_AREA = 1e-14  # parallelogram area of a triangle, mm², below which it has no normal
_POINTS = 1_000_000  # points of the true surface in one batch
_PROBE = 8  # intervals of a piece in the estimate
_ROUNDS = 24  # largest number of refinements
_TRIANGLE_BYTES = 400  # largest memory of a triangle while a gear is built and written
_COARSEST_UM = 1e5  # largest tolerance that a message proposes, µm

CURVED = "fillet", "flank"
"""Parts of a section that are no arcs about the axis."""


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
        part = points[row : end + 1]
        # Edges along the face lie between two pieces, chords in the sections.
        edges = (
            _from_edges(part[:-1, column], part[1:, column], true[:, column * _FINER])
            for column in grid.counts.joints
        )
        chords = (
            _from_edges(line[:-1], line[1:], true_line)
            for line, true_line in zip(part, true[::_FINER], strict=True)
        )
        inside = max(inside, *_off_planes(part, true), *edges)
        across = max(across, *chords)
    return _BETWEEN * max(inside, across), _BETWEEN * across


def _off_planes(points: np.ndarray, true: np.ndarray) -> Iterator[float]:
    """Yield the largest distances of true points from the planes of the triangles, mm."""
    a, b, c, d = points[:-1, :-1], points[:-1, 1:], points[1:, 1:], points[1:, :-1]
    planes = _plane(a, b, c), _plane(a, c, d)
    rows, columns = np.array(a.shape[:2]) * _FINER
    for up, along in np.ndindex(_FINER + 1, _FINER + 1):
        at = true[up : up + rows : _FINER, along : along + columns : _FINER]
        first, other = planes if along >= up else planes[::-1]
        normal = np.where(first[1][..., None], first[0], other[0])
        yield float(np.abs(((at - a) * normal).sum(axis=-1)).max())


def _plane(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the unit normals of triangles, and which of the triangles have an area."""
    normal = np.cross(b - a, c - a)
    length = np.linalg.norm(normal, axis=-1)
    valid = length > _LEAST_AREA
    return np.where(valid[..., None], normal / np.where(valid, length, 1.0)[..., None], 0.0), valid


def _from_edges(low: np.ndarray, high: np.ndarray, line: np.ndarray) -> float:
    """Return the largest distance of a line of finer points from its edges, from low to high."""
    points = np.stack([line[k::_FINER][: len(low)] for k in range(_FINER)])
    along = high - low
    length = np.linalg.norm(along, axis=-1, keepdims=True)
    unit = along / np.where(length > 0, length, 1.0)
    offset = points - low
    offset = offset - (offset * unit).sum(axis=-1, keepdims=True) * unit
    return float(np.linalg.norm(offset, axis=-1).max(initial=0.0))


def fitting_grid(
    profile: GearProfile, tolerance_mm: float, teeth: int, rounding: type[np.floating] = np.float64
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
    unit = float(np.spacing(rounding(float(profile.tooth.tip_radius))))
    if tolerance_mm < 8 * unit:
        raise UsageError(
            f"coordinates of this file resolve {1e3 * unit:.2g} µm, which is too coarse for a"
            f" tolerance of {1e3 * tolerance_mm:g} µm; give --tolerance-um"
            f" {_rounded_up(8e3 * unit):g} or more, or write .step."
        )
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


def section_counts(
    profile: GearProfile, z: Float[np.ndarray, " n"], tolerance_mm: float, teeth: int
) -> tuple[Counts, float]:
    """Return interval counts around the tooth for sections at heights z, and the error, mm.

    Flanks and fillets are within `tolerance_mm` of their chords; lands are drawn as arcs and have
    no error. `teeth` determines the memory.
    """

    def estimate(tolerance: float) -> Counts:
        return _around(profile, z, tolerance)[0]

    counts = estimate(tolerance_mm)
    while True:
        _check_memory(counts, teeth, tolerance_mm, estimate)
        true = section_points(profile, counts, z, _FINER)
        curved = np.repeat([part in CURVED for _, part in ORDER], counts.pieces)
        error = 0.0
        for line in true:
            corners, finer = line[::_FINER], line[:-1].reshape(-1, _FINER, 2)[curved]
            ends = corners[:-1][curved], corners[1:][curved]
            error = max(error, _from_edges(*ends, finer.reshape(-1, 2)))
        if (error := _BETWEEN * error) <= tolerance_mm:
            return counts, error
        counts = _more(counts, CURVED, 1.1)


def _more(counts: Counts, parts: Iterable[str], factor: float) -> Counts:
    return replace(counts, **{part: math.ceil(factor * getattr(counts, part)) for part in parts})


def _check_memory(
    counts: Counts, teeth: int, tolerance_mm: float, estimate: Callable[[float], Counts]
) -> None:
    """Raise `UsageError` if a mesh needs more memory than is free."""

    def triangles(counts: Counts) -> int:
        """Return their approximate number; end faces and bore add a few more."""
        return 2 * teeth * counts.around * (counts.rows + 1)

    needed, most = triangles(counts), free_bytes() // _TRIANGLE_BYTES
    if needed <= most:
        return
    # The number of triangles decreases as 1/tolerance or slower.
    fits = _rounded_up(1e3 * tolerance_mm * needed / most)
    while fits < _COARSEST_UM and 1.3 * triangles(estimate(1e-3 * fits)) > most:
        fits = _rounded_up(1.01 * fits)
    coarser = f"--tolerance-um {fits:g} or more, or " if fits < _COARSEST_UM else ""
    raise UsageError(
        f"a tolerance of {1e3 * tolerance_mm:g} µm needs about {needed:.2g} triangles, more than"
        f" the memory holds ({most:.2g}); give {coarser}fewer --teeth."
    )


def _rounded_up(value: float) -> float:
    """Round up to a number with one significant digit."""
    digits = 10.0 ** math.floor(math.log10(value))
    return math.ceil(value / digits * (1 - 1e-9)) * digits


def _around(
    profile: GearProfile, z: Float[np.ndarray, " n"], tolerance: float
) -> tuple[Counts, float]:
    """Return interval counts around the tooth, and the longest interval of fillet or flank, mm."""
    probe = Counts(_PROBE, _PROBE, _PROBE, _PROBE)
    points, fine = (section_points(profile, probe, z, finer) for finer in (1, 2))
    chord = points[:, 1:] - points[:, :-1]
    length = np.linalg.norm(chord, axis=-1)
    middle = fine[:, 1::2] - points[:, :-1]
    area = np.abs(chord[..., 0] * middle[..., 1] - chord[..., 1] * middle[..., 0])
    sagitta = (area / np.maximum(length, 1e-12)).max(axis=0).reshape(-1, _PROBE).max(axis=1)
    total = length.max(axis=0).reshape(-1, _PROBE).sum(axis=1)
    pieces = np.array([part for _, part in ORDER])
    worst = {part: float(sagitta[pieces == part].max()) for part in PARTS}
    counts: dict[str, Any] = {
        part: max(1, math.ceil(_PROBE * math.sqrt(1.1 * size / tolerance)))
        for part, size in worst.items()
    }
    step = max(total[k] / counts[part] for k, part in enumerate(pieces) if part in CURVED)
    return Counts(**counts), step


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
        joints = section_points(profile, Counts(1, 1, 1, 1), z)
        sagitta = np.linalg.norm(joints[1:-1] - (joints[:-2] + joints[2:]) / 2, axis=-1).max()
        bending = 2 * _PROBE * math.sqrt(sagitta / allowance)
        sections.append(max(1, math.ceil(twist / allowance), math.ceil(bending / 2)))
    return replace(counts, sections=tuple(sections))


def _finer(counts: Counts, error: float, across: float, tolerance: float) -> Counts:
    """Return larger counts: around the tooth if the error in sections is too large, else along it.

    `error` is the total error and `across` the error in sections, both in mm.
    """
    if across > max(_ACROSS, 0.7) * tolerance:
        return _more(counts, PARTS, min(math.sqrt(across / (_ACROSS * tolerance)), 2.0))
    excess = (error - across) / max(tolerance - across, 0.1 * tolerance)
    factor = min(max(1.15, excess**0.7), 2.0)
    return replace(counts, sections=tuple(math.ceil(k * factor) for k in counts.sections))
