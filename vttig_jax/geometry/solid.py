"""Solid of a gear with B-spline flanks by Open CASCADE (`OCP`), and its STEP file."""

import math
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.interpolate import make_interp_spline

from ..base.errors import PairError, UsageError
from ..base.shown_text import shown_name
from .mesh import bore_rotation, on_circle, rotated
from .outline import ORDER, Blank, Counts, GearProfile, ToothGrid, blank_of
from .surface import PARTS
from .tooth import Tooth

_FINEST_MM = 2e-6
"""Smallest tolerance, twice the distance at which edges of a valid solid may be from faces."""

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


@dataclass(frozen=True)
class GearSolid:
    """Valid closed solid of a gear or a sector.

    **Arguments**
    - `shape`: the `TopoDS_Solid`, mm, in the frame of the gear.
    - `teeth`: number of teeth of the solid.
    - `faces`: number of faces.
    - `sections`: number of rows of points that the surfaces interpolate.
    - `error_mm`: measured largest distance of the true surface from the B-splines.
    - `volume_mm3`: volume integrated by Open CASCADE.
    - `notes`: sentences on the geometry of the teeth.
    """

    shape: Any
    teeth: int
    faces: int
    sections: int
    error_mm: float
    volume_mm3: float
    notes: tuple[str, ...] = ()


def gear_solid(
    tooth: Tooth,
    *,
    tolerance_mm: float = 1e-3,
    teeth: int | None = None,
    bore_mm: float | None = None,
    progress: Callable[[], Any] = lambda: None,
) -> GearSolid:
    """Build a gear from B-spline surfaces; arguments and errors are those of `gear_mesh`.

    Every piece of a tooth is a cubic B-spline through points of the true surface. The number of
    points is increased until the measured distance is within the tolerance. The end faces are
    planes, the bore is a cylinder. `progress` is called after interpolation, sewing and measuring.

    **Raises** `UsageError` also without the extra `cad`.
    """
    require_cad()
    blank = blank_of(
        tooth, teeth=teeth, bore_mm=bore_mm, tolerance_mm=tolerance_mm, finest_mm=_FINEST_MM
    )
    profile = blank.profile
    stretches, limits, error = tooth_patches(profile, tolerance_mm)
    progress()
    from .sewing import closed_solid, faces_of, volume

    pitch, radius, sector = profile.pitch, blank.bore_mm / 2, None
    around = [_row(pieces, blank, pitch) for pieces in stretches]
    cuts: list[list[Patch]] = [[] for _ in around]
    bores: list[Patch] = []
    if not blank.whole:
        first, sweep = math.pi / 2 - pitch / 2, blank.teeth * pitch
        sector = (first, first + sweep)
        rows = [row[0].points[:, 0, 2] for row in around]
        turns = bore_rotation(profile, np.concatenate(rows))
        step = (20 * tolerance_mm / (2 * radius or math.inf)) ** 0.25  # a cubic is within r h⁴/80
        columns = np.linspace(0.0, sweep, max(4, math.ceil(sweep / step) if step else 4) + 1)
        for index, row in enumerate(around):
            start = sum(map(len, rows[:index]))
            turn = turns[start : start + len(rows[index]), None] - pitch / 2
            # Cut faces are ruled surfaces between the bottom of an outer space and the bore.
            inner = on_circle(radius, turn + np.array([0.0, sweep]), rows[index])
            line, last = row[0].points[:, 0], row[-1].points[:, -1]
            sides = (inner[:, 0], line), (last, inner[:, 1])
            cuts[index] = [Patch(np.stack(pair, axis=1), 1) for pair in sides]
            if radius > 0 and turns.any():  # the cut faces wind around the axis, and so the bore
                bores.append(Patch(on_circle(radius, turn + columns, rows[index])))
    shape = closed_solid(around, cuts, limits, radius, sector, bores)
    if shape is None:
        raise PairError(
            "Open CASCADE cannot sew the faces to a valid solid; change --tolerance-um, or write"
            " .stl.",
            where="solid",
        )
    progress()
    volume_mm3 = volume(shape)
    progress()
    return GearSolid(
        shape=shape,
        teeth=blank.teeth,
        faces=len(faces_of(shape)),
        sections=sum(len(row[0].points) - 1 for row in around) + 1,
        error_mm=max([error, *(_off_bore(patch, radius) for patch in bores)]),
        volume_mm3=volume_mm3,
        notes=blank.notes,
    )


def require_cad() -> None:
    """Raise `UsageError` if `OCP` is missing or too old."""
    try:
        import OCP.collections  # noqa: F401
    except ImportError as error:
        raise UsageError(
            "a .step file needs the extra `cad` (cadquery-ocp-novtk 8 or later);"
            " pip install vttig-jax[cad], or write .stl."
        ) from error


def step_bytes(solid: GearSolid, name: str) -> bytes:
    """Return a STEP file (AP214, mm) with the solid and its name, as one line of ASCII.

    Quotes, backslashes and semicolons have a meaning in STEP, and not all readers find the end of a
    quoted text that holds them; they become underscores.
    """
    from .sewing import write_step

    plain = shown_name(name).translate(str.maketrans("'\\;", "___"))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "gear.step"
        write_step(solid.shape, path, plain.encode("ascii", "replace").decode())
        return path.read_bytes()


def _row(pieces: Stretch, blank: Blank, pitch: float) -> list[Patch]:
    """Return the surfaces of all teeth in one stretch of the face, counter-clockwise."""
    right_root, *right, right_tip, left_tip, left_fillet_flank, left_fillet, left_root = pieces
    tooth = [*right, _joined(right_tip, left_tip), left_fillet_flank, left_fillet]
    row: list[Patch | None] = [] if blank.whole else [right_root]
    for k in range(blank.teeth):
        at_end = k == blank.teeth - 1 and not blank.whole
        land = left_root if at_end else _joined(left_root, _turned(right_root, pitch))
        row += [_turned(patch, k * pitch) for patch in (*tooth, land)]
    return [patch for patch in row if patch is not None]


def _joined(first: Patch | None, second: Patch | None) -> Patch | None:
    if first is None or second is None:
        return None
    return Patch(np.concatenate([first.points, second.points[:, 1:]], axis=1))


def _off_bore(patch: Patch, radius: float) -> float:
    """Return the largest distance of a bore surface from the cylinder, mm."""
    x, y, _ = np.moveaxis(patch.at_finer(_FINER), -1, 0)
    return float(np.abs(np.hypot(x, y) - radius).max())


def _turned(patch: Patch | None, angle: float) -> Patch | None:
    return None if patch is None else Patch(rotated(patch.points, angle), patch.degree)
