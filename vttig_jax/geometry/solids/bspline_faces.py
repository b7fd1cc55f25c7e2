"""Faces of one tooth as cubic B-spline surfaces through points of the true surface."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float
from scipy.interpolate import make_interp_spline

from ...base.errors import PairError
from ..tooth.surface import PARTS
from .gear_profile import GearProfile
from .tooth_grid import ORDER, Counts, ToothGrid

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


@dataclass(frozen=True)
class ToothPatches:
    """Surfaces of one tooth, divided along the face into stretches with the same pieces.

    **Arguments**
    - `stretches`: the eight pieces of each stretch in the order `ORDER`, None for a missing piece.
    - `heights`: limits of the stretches, mm.
    - `error_mm`: largest distance of the true surface from the B-splines, measured between the
      points of interpolation.
    """

    stretches: tuple[tuple[Patch | None, ...], ...]
    heights: tuple[float, ...]
    error_mm: float


def tooth_patches(profile: GearProfile, tolerance_mm: float) -> ToothPatches:
    """Return B-splines through points of a tooth, within `tolerance_mm` of the true surface.

    **Raises** `PairError` if this needs too many points.
    """
    half = float(profile.tooth.face_width_mm) / 2
    heights = (-half, *profile.breaks(-half, half), half)
    counts = Counts(_FIRST, _FIRST, _FIRST, _FIRST, sections=(_FIRST,) * (len(heights) - 1))
    worst = math.inf
    for _ in range(_ROUNDS):
        grid = ToothGrid(profile, counts, heights)
        stretches = tuple(_stretches(grid))
        errors = _errors(grid, stretches)
        worst = float(errors[0].max())
        if worst <= tolerance_mm:
            return ToothPatches(stretches, heights, worst)
        counts = _finer(counts, errors, tolerance_mm)
        if max(counts.pieces()) > _MOST or counts.rows > _MOST:
            break
    raise PairError(
        f"B-spline surfaces within {1e3 * tolerance_mm:g} µm need more than {_MOST} intervals in"
        f" one direction (error {1e3 * worst:.3g} µm); give a larger tolerance, or a recession that"
        " is smooth.",
        where="recession",
    )


def _stretches(grid: ToothGrid) -> Iterator[tuple[Patch | None, ...]]:
    points, joints = grid.points(), grid.joints
    start = 0
    for count, open_ in zip(grid.counts.sections, _open(grid), strict=True):
        rows = points[start : start + count + 1]
        yield tuple(
            Patch(rows[:, joints[k] : joints[k + 1] + 1]) if open_[k] else None
            for k in range(len(ORDER))
        )
        start += count


def _open(grid: ToothGrid) -> Bool[np.ndarray, "stretches 8"]:
    """Return which pieces exist in the middle of each stretch."""
    ends = np.array(grid.stretches)
    middle = ToothGrid(
        grid.profile, Counts(1, 1, 1, 1, (1,) * (2 * len(ends) - 2)), tuple(_with_middles(ends))
    )
    columns = middle.point_columns()[1::2]
    return np.diff(columns, axis=1) != 0


def _with_middles(ends: np.ndarray) -> np.ndarray:
    return np.sort(np.concatenate([ends, (ends[1:] + ends[:-1]) / 2]))


def _errors(
    grid: ToothGrid, stretches: tuple[tuple[Patch | None, ...], ...]
) -> Float[np.ndarray, "3 stretches 8"]:
    """Return the largest distance of each surface from the true one at equal parameters, mm.

    The first axis is the error at all points, on interpolated rows and on interpolated columns.
    """
    true, joints = grid.points(_FINER), grid.joints * _FINER
    errors, start = np.zeros((3, len(stretches), len(ORDER))), 0
    for stretch, (count, patches) in enumerate(zip(grid.counts.sections, stretches, strict=True)):
        rows = true[start : start + count * _FINER + 1]
        for k, patch in enumerate(patches):
            if patch is not None:
                difference = patch.at_finer(_FINER) - rows[:, joints[k] : joints[k + 1] + 1]
                error = np.linalg.norm(difference, axis=-1)
                error *= 1 + 2 / _FINER**2  # the peak of t²(1 − t)² may lie between the points
                errors[:, stretch, k] = error.max(), error[::_FINER].max(), error[:, ::_FINER].max()
        start += count * _FINER
    return errors


def _finer(counts: Counts, errors: np.ndarray, tolerance: float) -> Counts:
    """Return more intervals in each direction whose error is too large for the tolerance, mm.

    The error is assumed to decrease with the fourth power of the number of intervals.
    """
    _, across, along = errors

    def refined(count: int, error: float) -> int:
        factor = (error / (0.4 * tolerance)) ** 0.25
        return count if factor <= 1 else max(count + 1, math.ceil(count * min(factor, 2.0)))

    around = {}
    for part in PARTS:
        pieces = [k for k, (_, name) in enumerate(ORDER) if name == part]
        around[part] = refined(counts.of(part), float(across[:, pieces].max()))
    sections = tuple(
        refined(k, float(row.max())) for k, row in zip(counts.sections, along, strict=True)
    )
    return replace(counts, **around, sections=sections)
