"""Brute force: what a rack cutter that rolls along a gear leaves standing, with no meshing law.

The cutter beside the left flank of a tooth is all that lies within its tip radius of a wedge, whose
edges are its flank and its tip line moved inwards by that radius. The distance of a point from a
wedge is elementary. A point of the blank is put into the frame of the rack for thousands of
positions, and the smallest distance is found by sampling and a bounded minimisation: it is zero on
the surface that the cutter makes, positive where material is left, negative where it was cut.

Half of the cutter is enough for one side of the tooth; right flanks are handed over mirrored.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import minimize_scalar

_POSITIONS = 4001
_REACH = 1.2
"""Positions looked at: the gear turns by this either way, rad."""


@dataclass(frozen=True)
class Cutter:
    """Half of a rack cutter; lengths mm. `flank_offset`: its flank at the reference line, x < 0."""

    pitch_radius: float
    pressure_angle: float
    flank_offset: float
    shift: float
    dedendum: float
    tip_radius: float

    def clearance(self, x: float, y: float) -> float:
        """Smallest distance of a point of the blank from the cutter in all positions, mm."""
        turns = np.linspace(-_REACH, _REACH, _POSITIONS)
        found = self._distance(turns, x, y)
        best, step = turns[np.argmin(found)], turns[1] - turns[0]
        fine: Any = minimize_scalar(
            lambda turn: self._distance(np.array([turn]), x, y)[0],
            bounds=(best - step, best + step),
            method="bounded",
            options={"xatol": 1e-12},
        )
        return min(float(fine.fun), float(found.min()))

    def _distance(self, turns: np.ndarray, x: float, y: float) -> np.ndarray:
        """Distance from the cutter, after the gear turned and the rack went along."""
        cosine, sine = np.cos(turns), np.sin(turns)
        turned = np.stack([cosine * x - sine * y, sine * x + cosine * y], axis=-1)
        on_rack = turned + np.stack([self.pitch_radius * turns, 0 * turns], axis=-1)
        on_rack[:, 1] -= self.pitch_radius
        return self._from_wedge(on_rack) - self.tip_radius

    def _from_wedge(self, points: np.ndarray) -> np.ndarray:
        normals = np.array(
            [[np.cos(self.pressure_angle), -np.sin(self.pressure_angle)], [0.0, -1.0]]
        )
        on_edges = np.array([[self.flank_offset, self.shift], [0.0, self.shift - self.dedendum]])
        levels = (normals * on_edges).sum(axis=1) - self.tip_radius
        apex = np.linalg.solve(normals, levels)
        off = points - apex
        from_edges = off @ normals.T
        shares = np.linalg.solve(normals.T, off.T)
        beyond_apex = np.all(shares >= 0, axis=0)
        return np.where(beyond_apex, np.linalg.norm(off, axis=-1), from_edges.max(axis=-1))
