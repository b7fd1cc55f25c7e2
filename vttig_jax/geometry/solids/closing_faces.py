"""The faces that close a gear: end faces, bore, and the cut faces of a sector.

The end face of a tooth is filled rung by rung between its right and its left side, the rim below by
going around the feet of the teeth and the bore at once; neither adds a point.
"""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from .blank import Blank
from .gear_profile import GearProfile
from .tooth_grid import ToothGrid, space_middle

Triangles = Int[np.ndarray, "_ 3"]


def zipped(
    first: Int[np.ndarray, " n"],
    second: Int[np.ndarray, " m"],
    first_key: Float[np.ndarray, " n"],
    second_key: Float[np.ndarray, " m"],
) -> Triangles:
    """Triangles between two lines of points, advancing on that whose next edge comes first.

    They go first → its next → second, so that they are counter-clockwise where the second line
    lies to the left of the first.

    **Arguments**
    - `first`, `second`: indices of the points, in the same sense; one point is enough for a fan.
    - `first_key`, `second_key`: how far along each point is, by which the edges are ordered.

    **Example**
    ```python
    >>> import numpy as np
    >>> from vttig_jax.geometry.solids.closing_faces import zipped
    >>> zipped(np.array([0, 1, 2]), np.array([3, 4]), np.arange(3.0), np.array([0.0, 2.0]))
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
    """The end face of one tooth above the line between its feet, seen from +z.

    **Arguments**
    - `points`: one section.
    - `columns`: the point that stands for each.
    - `joints`: where the pieces begin and end; see `ToothGrid`.
    """
    foot, corner, middle, other_corner, other_foot = joints[[1, 3, 4, 5, 7]]
    radius = np.hypot(points[:, 0], points[:, 1])
    key = radius.copy()
    # Along the tip the radius tells nothing: count up to its middle.
    top = max(radius[corner], radius[other_corner])
    key[corner : middle + 1] = top + np.linspace(0.0, 1.0, middle - corner + 1)
    key[middle : other_corner + 1] = top + np.linspace(1.0, 0.0, other_corner - middle + 1)
    right = np.arange(foot, middle + 1)
    left = np.arange(other_foot, middle - 1, -1)
    return columns[zipped(right, left, key[right], key[left])]


def rim_face(
    points: Float[np.ndarray, "columns 3"],
    columns: Int[np.ndarray, " columns"],
    joints: Int[np.ndarray, "9"],
    inner: Int[np.ndarray, " k"],
    pitch: float,
    turned: float = 0.0,
) -> Triangles:
    """The end face of one pitch between the feet and the bore, seen from +z.

    **Arguments**
    - `points`, `columns`, `joints`: as for `tooth_face`.
    - `inner`: indices of the points on the bore, evenly from one space to the next; one for the
      axis.
    - `pitch`: angle between neighbouring teeth, rad.
    - `turned`: by which the points on the bore are turned counter-clockwise, rad.
    """
    foot, other_foot, last = joints[[1, 7, 8]]
    outer = np.concatenate([np.arange(foot + 1), np.arange(other_foot, last + 1)])
    x, y = points[outer, 0], points[outer, 1]
    cosine, sine = np.cos(turned), np.sin(turned)
    angle = np.arctan2(-(x * cosine + y * sine), y * cosine - x * sine)
    inner_angle = np.linspace(-pitch / 2, pitch / 2, len(inner))
    return zipped(columns[outer], inner, angle, inner_angle)


def real(triangles: Triangles) -> Triangles:
    """Those whose three points differ."""
    a, b, c = triangles.T
    return triangles[(a != b) & (b != c) & (c != a)]


_FOLLOWS = 0.5
"""Of a pitch by which the teeth may turn along the face before the bore turns with them."""

_SHARE = 0.9
"""Part of the tolerance that its chords may take."""


@dataclass(frozen=True)
class BoreGrid:
    """Points on the bore; on the axis, one a row, where there is none.

    **Arguments**
    - `radius`: mm, 0 for no bore.
    - `z`: heights of the rows: both ends, or all sections of teeth that wind.
    - `turned`: by which the middle of the first space is turned counter-clockwise from half a pitch
      clockwise of the first tooth, by row, rad.
    - `pitch`: angle between neighbouring teeth, rad.
    - `per_pitch`: intervals from one space to the next.
    - `teeth`, `whole`: of the gear or sector.
    - `start`: number of the first point.
    """

    radius: float
    z: Float[np.ndarray, " rows"]
    turned: Float[np.ndarray, " rows"]
    pitch: float
    per_pitch: int
    teeth: int
    whole: bool
    start: int

    @property
    def width(self) -> int:
        """Points a row."""
        return max(self.teeth * self.per_pitch + (0 if self.whole else 1), 1)

    @property
    def error_mm(self) -> float:
        """Largest distance of the cylinder from its triangles."""
        if not self.per_pitch:
            return 0.0
        step = max(self.pitch / self.per_pitch, float(np.abs(np.diff(self.turned)).max()))
        return self.radius * (1 - math.cos(step / 2))

    def points(self) -> Float[np.ndarray, "n 3"]:
        """Row by row, x, y, z in mm."""
        step = self.pitch / max(self.per_pitch, 1)
        angle = self.turned[:, None] - self.pitch / 2 + np.arange(self.width) * step
        x, y = -self.radius * np.sin(angle), self.radius * np.cos(angle)
        return np.stack(np.broadcast_arrays(x, y, self.z[:, None]), axis=-1).reshape(-1, 3)

    def row(self, row: int, tooth: int) -> Int[np.ndarray, " columns"]:
        """Numbers of the points below one tooth, from one space to the next."""
        along = tooth * self.per_pitch + np.arange(self.per_pitch + 1)
        along = along % self.width if self.whole else along
        return self.start + (row % len(self.z)) * self.width + along

    def edge(self, *, last: bool) -> Int[np.ndarray, " rows"]:
        """Numbers of the points on the first or the last cut face of a sector, upwards."""
        column = self.width - 1 if last else 0
        return self.start + np.arange(len(self.z)) * self.width + column

    def triangles(self) -> list[Triangles]:
        """The bore, seen from the axis."""
        found = []
        for row in range(len(self.z) - 1 if self.per_pitch else 0):
            onward = self.turned[row + 1] > self.turned[row]
            for tooth in range(self.teeth):
                low, high = self.row(row, tooth), self.row(row + 1, tooth)
                a, b, c, d = low[:-1], low[1:], high[1:], high[:-1]
                # The shorter diagonal: no triangle spans more of the circle than its longest side.
                split = ((a, d, b), (b, d, c)) if onward else ((a, c, b), (a, d, c))
                found += [np.stack(corners, axis=-1) for corners in split]
        return found


def bore_turn(profile: GearProfile, z: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """By which the bore turns with the teeth, rad: not at all where these hardly wind."""
    turned = -space_middle(profile, z)
    return turned if np.abs(turned).max() > _FOLLOWS * profile.pitch / 2 else np.zeros_like(turned)


def bore_grid(grid: ToothGrid, blank: Blank, tolerance_mm: float, start: int) -> BoreGrid:
    """The bore of a gear, within a tolerance; its points are numbered from `start`."""
    pitch, radius = grid.profile.pitch, blank.bore_mm / 2
    z, turned, per_pitch = grid.z, np.zeros(len(grid.z)), 0
    if radius > 0:
        turned = bore_turn(grid.profile, z)
        widest = 2 * math.acos(max(1 - _SHARE * tolerance_mm / radius, 0.5))
        per_pitch = math.ceil(pitch / widest)
    if not turned.any():
        z, turned = z[[0, -1]], turned[[0, -1]]
    return BoreGrid(radius, z, turned, pitch, per_pitch, blank.teeth, blank.whole, start)
