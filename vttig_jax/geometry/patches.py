"""Faces of one tooth as cubic B-spline surfaces through points of the true surface."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
from jaxtyping import Float
from scipy.interpolate import make_interp_spline

from ..base.errors import PairError
from .outline import ORDER, Counts, GearProfile, ToothGrid
from .surface import PARTS

_DEGREE = 3
# Chosen values:
_FIRST = 4  # intervals of a piece at the start
_FINER = 4  # parts of an interval in which the error is measured
_ROUNDS = 20  # largest number of refinements
_MOST = 2000  # largest number of intervals of a face in one direction


@dataclass(frozen=True)
class Patch:
    """B-spline surface through rows (along the face) and columns (around the gear) of points.

    Patches with the same points on an edge have bit-identical edge curves.

    **Arguments**
    - `points`: points in mm, equidistant in both parameters, which run from 0 to 1.
    - `degree`: degree around the gear; 1 for a ruled surface.
    """

    points: Float[np.ndarray, "rows columns 3"]
    degree: int = _DEGREE

    @cached_property
    def _around(self):
        share = np.linspace(0.0, 1.0, self.points.shape[1])
        return make_interp_spline(share, self.points, k=self.degree, axis=1)

    @cached_property
    def _along(self):
        share = np.linspace(0.0, 1.0, self.points.shape[0])
        return make_interp_spline(share, np.moveaxis(self._around.c, 0, 1), k=_DEGREE, axis=0)

    @property
    def poles(self) -> Float[np.ndarray, "rows columns 3"]:
        """Control points, mm."""
        return self._along.c

    @property
    def knots(self) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " m"]]:
        """Knots along the face and around the gear, with repeated ends."""
        return self._along.t, self._around.t

    def at_finer(self, finer: int) -> Float[np.ndarray, "rows columns 3"]:
        """Return points of the surface, mm, with every interval divided into `finer` parts."""
        rows, columns = (np.linspace(0.0, 1.0, (n - 1) * finer + 1) for n in self.points.shape[:2])
        along = self._along(rows)
        around = type(self._around)(self._around.t, np.moveaxis(along, 1, 0), self.degree)
        return np.moveaxis(around(columns), 0, 1)


Stretch = Sequence[Patch | None]
"""The eight pieces of a stretch of the face in the order `ORDER`, None for a missing piece."""


def tooth_patches(
    profile: GearProfile, tolerance_mm: float
) -> tuple[list[Stretch], tuple[float, ...], float]:
    """Return B-splines through points of a tooth, within `tolerance_mm` of the true surface.

    The face is divided into stretches with the same pieces. The results are the pieces of each
    stretch, the limits of the stretches, mm, and the largest distance of the true surface, mm,
    measured between the points of interpolation.

    **Raises** `PairError` if this needs too many points.
    """
    half = float(profile.tooth.face_width_mm) / 2
    heights = (-half, *profile.breaks(-half, half), half)
    counts = Counts(_FIRST, _FIRST, _FIRST, _FIRST, sections=(_FIRST,) * (len(heights) - 1))
    worst = math.inf
    for _ in range(_ROUNDS):
        grid = ToothGrid(profile, counts, heights)
        stretches = _stretches(grid)
        errors = _errors(grid, stretches)
        worst = float(errors[0].max())
        if worst <= tolerance_mm:
            return stretches, heights, worst
        counts = _finer(counts, errors, tolerance_mm)
        if max(counts.pieces) > _MOST or counts.rows > _MOST:
            break
    raise PairError(
        f"B-spline surfaces within {1e3 * tolerance_mm:g} µm need more than {_MOST} intervals in"
        f" one direction (error {1e3 * worst:.3g} µm); give a larger tolerance, or a recession that"
        " is smooth.",
        where="recession",
    )


def _rows_of(grid: ToothGrid, finer: int = 1) -> list[slice]:
    """Return the rows of points of each stretch, including both ends."""
    ends = np.cumsum([0, *grid.counts.sections]) * finer
    return [slice(low, high + 1) for low, high in pairwise(ends)]


def _stretches(grid: ToothGrid) -> list[Stretch]:
    # A piece exists in a stretch if it does in the middle.
    ends = np.array(grid.stretches)
    halves = np.sort(np.concatenate([ends, (ends[1:] + ends[:-1]) / 2]))
    middle = ToothGrid(grid.profile, Counts(1, 1, 1, 1, (1,) * (len(halves) - 1)), tuple(halves))
    exists = np.diff(middle.point_columns()[1::2], axis=1) != 0
    points, joints = grid.points(), grid.counts.joints
    return [
        [
            Patch(points[rows, joints[k] : joints[k + 1] + 1]) if exists[stretch, k] else None
            for k in range(len(ORDER))
        ]
        for stretch, rows in enumerate(_rows_of(grid))
    ]


def _errors(grid: ToothGrid, stretches: list[Stretch]) -> Float[np.ndarray, "3 stretches 8"]:
    """Return the largest distance of each surface from the true one at equal parameters, mm.

    The first axis is the error at all points, on interpolated rows and on interpolated columns.
    """
    true, joints = grid.points(_FINER), grid.counts.joints * _FINER
    errors = np.zeros((3, len(stretches), len(ORDER)))
    for stretch, rows in enumerate(_rows_of(grid, _FINER)):
        for k, patch in enumerate(stretches[stretch]):
            if patch is not None:
                difference = patch.at_finer(_FINER) - true[rows, joints[k] : joints[k + 1] + 1]
                error = np.linalg.norm(difference, axis=-1)
                error *= 1 + 2 / _FINER**2  # the peak of t²(1 − t)² may lie between the points
                errors[:, stretch, k] = error.max(), error[::_FINER].max(), error[:, ::_FINER].max()
    return errors


def _finer(counts: Counts, errors: np.ndarray, tolerance: float) -> Counts:
    """Return more intervals in each direction whose error is too large for the tolerance, mm.

    The error is assumed to decrease with the fourth power of the number of intervals.
    """
    _, across, along = errors

    def refined(count: int, error: float) -> int:
        factor = (error / (0.4 * tolerance)) ** 0.25
        return count if factor <= 1 else max(count + 1, math.ceil(count * min(factor, 2.0)))

    pieces = np.array([part for _, part in ORDER])
    around = {
        part: refined(getattr(counts, part), float(across[:, pieces == part].max()))
        for part in PARTS
    }
    rows = zip(counts.sections, along, strict=True)
    sections = tuple(refined(count, float(row.max())) for count, row in rows)
    return replace(counts, **around, sections=sections)
