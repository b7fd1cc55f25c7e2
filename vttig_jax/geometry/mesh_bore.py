"""The bore of a gear as rows of points, which follow the teeth where these wind around the axis."""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from .mesh_grid import ToothGrid, space_middle
from .mesh_profile import GearProfile
from .solid_check import Blank
from .web import Triangles

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
