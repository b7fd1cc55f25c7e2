"""How far the true surface of a tooth is from the triangles of its grid, measured."""

import numpy as np
from jaxtyping import Float

from .mesh_grid import ORDER, Counts, ToothGrid, section_curve
from .mesh_profile import GearProfile

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
