"""Faces that close a gear: end faces and bore.

The end face of a tooth is a strip of triangles between its right and its left side. The rim below
is a strip between the feet of the teeth and the bore. The strips use only existing points.
"""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from .blank import Blank
from .gear_profile import GearProfile
from .tooth_grid import ToothGrid, space_middle

Triangles = Int[np.ndarray, "_ 3"]


def triangle_strip(
    first: Int[np.ndarray, " n"],
    second: Int[np.ndarray, " m"],
    first_key: Float[np.ndarray, " n"],
    second_key: Float[np.ndarray, " m"],
) -> Triangles:
    """Return triangles between two lines of points, in the order of the edges of both lines.

    A triangle has a point of the first line, the next point and a point of the second line. It is
    counter-clockwise if the second line lies to the left of the first.

    **Arguments**
    - `first`, `second`: indices of the points, in the same sense; a single point gives a fan.
    - `first_key`, `second_key`: position of each point along the lines, which orders the edges.

    **Example**
    ```python
    >>> import numpy as np
    >>> from vttig_jax.geometry.solids.closing_faces import triangle_strip
    >>> triangle_strip(np.array([0, 1, 2]), np.array([3, 4]), np.arange(3.0), np.array([0.0, 2.0]))
    array([[0, 1, 3],
           [1, 4, 3],
           [1, 2, 4]])

    ```
    """
    ends = (first_key[1:] + first_key[:-1]) / 2, (second_key[1:] + second_key[:-1]) / 2
    order = np.argsort(np.concatenate(ends), kind="stable")
    on_first = order < len(ends[0])
    a = np.concatenate([[0], np.cumsum(on_first)])[:-1]
    b = np.concatenate([[0], np.cumsum(~on_first)])[:-1]
    after = np.where(on_first, first[np.minimum(a + 1, len(first) - 1)], 0)
    after = np.where(on_first, after, second[np.minimum(b + 1, len(second) - 1)])
    return np.stack([first[a], after, second[b]], axis=-1)


def tooth_face(
    points: Float[np.ndarray, "columns 3"],
    columns: Int[np.ndarray, " columns"],
    joints: Int[np.ndarray, "9"],
) -> Triangles:
    """Return the triangles of the end face of one tooth, above the line between its two feet.

    The triangles are counter-clockwise seen from +z. A column is a place around the profile in the
    grid of points of a tooth (`ToothGrid`).

    **Arguments**
    - `points`: points of one section, one for each column, mm.
    - `columns`: index of the mesh point of each column. Columns at one place share a point.
    - `joints`: columns at which the pieces of the profile begin and end; see `ToothGrid.joints`.
    """
    foot, corner, middle, other_corner, other_foot = joints[[1, 3, 4, 5, 7]]
    radius = np.hypot(points[:, 0], points[:, 1])
    key = radius.copy()
    # The radius is constant along the tip, so the key increases there to its middle.
    top = max(radius[corner], radius[other_corner])
    key[corner : middle + 1] = top + np.linspace(0.0, 1.0, middle - corner + 1)
    key[middle : other_corner + 1] = top + np.linspace(1.0, 0.0, other_corner - middle + 1)
    right = np.arange(foot, middle + 1)
    left = np.arange(other_foot, middle - 1, -1)
    return columns[triangle_strip(right, left, key[right], key[left])]


def rim_face(
    points: Float[np.ndarray, "columns 3"],
    columns: Int[np.ndarray, " columns"],
    joints: Int[np.ndarray, "9"],
    inner: Int[np.ndarray, " k"],
    pitch: float,
    rotation: float = 0.0,
) -> Triangles:
    """Return the triangles of the end face of one pitch between the tooth feet and the bore.

    The triangles are counter-clockwise seen from +z.

    **Arguments**
    - `points`, `columns`, `joints`: as for `tooth_face`.
    - `inner`: indices of the points on the bore, evenly from one space to the next; one for the
      axis.
    - `pitch`: angle between neighbouring teeth, rad.
    - `rotation`: counter-clockwise rotation of the points on the bore, rad.
    """
    foot, other_foot, last = joints[[1, 7, 8]]
    outer = np.concatenate([np.arange(foot + 1), np.arange(other_foot, last + 1)])
    x, y = points[outer, 0], points[outer, 1]
    cosine, sine = np.cos(rotation), np.sin(rotation)
    angle = np.arctan2(-(x * cosine + y * sine), y * cosine - x * sine)
    inner_angle = np.linspace(-pitch / 2, pitch / 2, len(inner))
    return triangle_strip(columns[outer], inner, angle, inner_angle)


def nondegenerate(triangles: Triangles) -> Triangles:
    """Return the triangles without those that have the same point at two corners."""
    a, b, c = triangles.T
    return triangles[(a != b) & (b != c) & (c != a)]


_FOLLOWS = 0.5
"""Rotation of the spaces, in half pitches, above which the bore rotates with them (chosen)."""

_SHARE = 0.9
"""Part of the tolerance that the chords of the bore may use (chosen)."""


@dataclass(frozen=True)
class BoreGrid:
    """Points on the bore; without bore there is one point on the axis in each row.

    **Arguments**
    - `radius`: radius of the bore, mm, 0 for no bore.
    - `z`: heights of the rows, mm: both ends, or all sections of helical teeth.
    - `rotation`: counter-clockwise rotation of the first space in each row, rad, from its position
      half a pitch clockwise of the first tooth.
    - `pitch`: angle between neighbouring teeth, rad.
    - `per_pitch`: intervals from one space to the next.
    - `teeth`, `whole`: number of teeth, and whether they are the whole gear.
    - `start`: index of the first point.
    """

    radius: float
    z: Float[np.ndarray, " rows"]
    rotation: Float[np.ndarray, " rows"]
    pitch: float
    per_pitch: int
    teeth: int
    whole: bool
    start: int

    @property
    def width(self) -> int:
        """Number of points on the bore in each section."""
        return max(self.teeth * self.per_pitch + (0 if self.whole else 1), 1)

    @property
    def error_mm(self) -> float:
        """Largest distance of the cylinder from its triangles, mm."""
        if not self.per_pitch:
            return 0.0
        step = max(self.pitch / self.per_pitch, float(np.abs(np.diff(self.rotation)).max()))
        return self.radius * (1 - math.cos(step / 2))

    def points(self) -> Float[np.ndarray, "n 3"]:
        """Return x, y, z in mm, row by row."""
        step = self.pitch / max(self.per_pitch, 1)
        angle = self.rotation[:, None] - self.pitch / 2 + np.arange(self.width) * step
        x, y = -self.radius * np.sin(angle), self.radius * np.cos(angle)
        return np.stack(np.broadcast_arrays(x, y, self.z[:, None]), axis=-1).reshape(-1, 3)

    def row(self, row: int, tooth: int) -> Int[np.ndarray, " columns"]:
        """Return the indices of the bore points below `tooth` in row `row`, from space to space."""
        along = tooth * self.per_pitch + np.arange(self.per_pitch + 1)
        along = along % self.width if self.whole else along
        return self.start + (row % len(self.z)) * self.width + along

    def edge(self, *, last: bool) -> Int[np.ndarray, " rows"]:
        """Return the indices of bore points on the first or last cut face of a sector by z."""
        column = self.width - 1 if last else 0
        return self.start + np.arange(len(self.z)) * self.width + column

    def triangles(self) -> list[Triangles]:
        """Return the triangles of the bore, counter-clockwise seen from the axis."""
        triangles = []
        for row in range(len(self.z) - 1 if self.per_pitch else 0):
            increasing = self.rotation[row + 1] > self.rotation[row]
            for tooth in range(self.teeth):
                low, high = self.row(row, tooth), self.row(row + 1, tooth)
                a, b, c, d = low[:-1], low[1:], high[1:], high[:-1]
                # With the shorter diagonal no triangle spans a larger arc than its longest side.
                split = ((a, d, b), (b, d, c)) if increasing else ((a, c, b), (a, d, c))
                triangles += [np.stack(corners, axis=-1) for corners in split]
        return triangles


def bore_rotation(profile: GearProfile, z: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Return the rotation of the bore with the teeth, rad; 0 if the teeth hardly rotate."""
    rotation = -space_middle(profile, z)
    follows = np.abs(rotation).max() > _FOLLOWS * profile.pitch / 2
    return rotation if follows else np.zeros_like(rotation)


def bore_grid(grid: ToothGrid, blank: Blank, tolerance_mm: float, start: int) -> BoreGrid:
    """Return the points of the bore within a tolerance, mm; their indices begin at `start`."""
    pitch, radius = grid.profile.pitch, blank.bore_mm / 2
    z, rotation, per_pitch = grid.z, np.zeros(len(grid.z)), 0
    if radius > 0:
        rotation = bore_rotation(grid.profile, z)
        widest = 2 * math.acos(max(1 - _SHARE * tolerance_mm / radius, 0.5))
        per_pitch = math.ceil(pitch / widest)
    if not rotation.any():
        z, rotation = z[[0, -1]], rotation[[0, -1]]
    return BoreGrid(
        radius=radius,
        z=z,
        rotation=rotation,
        pitch=pitch,
        per_pitch=per_pitch,
        teeth=blank.teeth,
        whole=blank.whole,
        start=start,
    )
