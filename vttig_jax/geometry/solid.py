"""Solid of a gear with B-spline flanks by Open CASCADE (`OCP`), and its STEP file."""

import math
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..base.errors import PairError, UsageError
from ..base.shown_text import shown_name
from .mesh import bore_rotation, on_circle, rotated
from .outline import Blank, blank_of
from .patches import Patch, Stretch, tooth_patches
from .tooth import Tooth

_FINEST_MM = 2e-6
"""Smallest tolerance, twice the distance at which edges of a valid solid may be from faces."""


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
    cuts: list[list[Patch]] = [[] for _ in around] if blank.whole else []
    bores: list[Patch] = []
    if not blank.whole:
        first, sweep = math.pi / 2 - pitch / 2, blank.teeth * pitch
        sector = (first, first + sweep)
        rows = [row[0].points[:, 0, 2] for row in around]
        rotation = bore_rotation(profile, np.concatenate(rows))
        ends = np.cumsum([len(z) for z in rows])[:-1]
        turns = np.split(rotation[:, None] - pitch / 2, ends)
        step = (20 * tolerance_mm / (2 * radius or math.inf)) ** 0.25  # a cubic is within r h⁴/80
        columns = np.linspace(0.0, sweep, max(4, math.ceil(sweep / step) if step else 4) + 1)
        for row, z, turn in zip(around, rows, turns, strict=True):
            # Cut faces are ruled surfaces between the bottom of an outer space and the bore.
            inner = on_circle(radius, turn + np.array([0.0, sweep]), z)
            line, last = row[0].points[:, 0], row[-1].points[:, -1]
            sides = (inner[:, 0], line), (last, inner[:, 1])
            cuts.append([Patch(np.stack(pair, axis=1), 1) for pair in sides])
            if radius > 0 and rotation.any():  # the cut faces wind around the axis, and so the bore
                bores.append(Patch(on_circle(radius, turn + columns, z)))
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
    right_root, *right, right_tip, left_tip, left_flank, left_fillet, left_root = pieces
    tooth = [*right, _joined(right_tip, left_tip), left_flank, left_fillet]
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
    x, y, _ = np.moveaxis(patch.at_finer(4), -1, 0)
    return float(np.abs(np.hypot(x, y) - radius).max())


def _turned(patch: Patch | None, angle: float) -> Patch | None:
    return None if patch is None else Patch(rotated(patch.points, angle), patch.degree)
