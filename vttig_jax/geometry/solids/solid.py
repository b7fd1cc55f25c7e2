"""Solid of a gear with B-spline flanks by Open CASCADE (`OCP`), and its STEP file."""

import math
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ...base.errors import PairError, UsageError
from ...base.shown_text import shown_name
from ..tooth.tooth import Tooth
from .blank import Blank, blank_of
from .bspline_faces import Patch, tooth_patches
from .closing_faces import bore_rotation

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
    patches = tooth_patches(profile, tolerance_mm)
    progress()
    from .sewing import closed_solid, faces_of, volume

    pitch, sector = profile.pitch, None
    around = [_row(pieces, blank, pitch) for pieces in patches.stretches]
    cuts: list[list[Patch]] = [[] for _ in around]
    bores: list[Patch] = []
    if not blank.whole:
        first = math.pi / 2 - pitch / 2
        sector = (first, first + blank.teeth * pitch)
        heights = [row[0].points[:, 0, 2] for row in around]
        ends = np.cumsum([len(z) for z in heights])[:-1]
        angles = np.split(bore_rotation(profile, np.concatenate(heights)), ends)
        cuts = [_cuts(row, blank, pitch, angle) for row, angle in zip(around, angles, strict=True)]
        if blank.bore_mm > 0 and any(angle.any() for angle in angles):
            rows = zip(heights, angles, strict=True)
            bores = [_bore(blank, pitch, z, angle, tolerance_mm) for z, angle in rows]
    shape = closed_solid(
        around,
        cuts=cuts,
        heights=patches.heights,
        bore_radius=blank.bore_mm / 2,
        sector=sector,
        bores=bores,
    )
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
        sections=sum(row[2].points.shape[0] - 1 for row in patches.stretches if row[2]) + 1,
        error_mm=max([patches.error_mm, *(_off_bore(patch, blank) for patch in bores)]),
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


_STEP_MARKS = str.maketrans("'\\;", "___")
"""Quotes, backslashes and semicolons have a meaning in STEP, and not all readers find the end of a
quoted text that holds them."""


def _step_name(name: str) -> str:
    """Return the name as one line of ASCII without characters that have a meaning in STEP."""
    return shown_name(name).translate(_STEP_MARKS).encode("ascii", "replace").decode()


def step_bytes(solid: GearSolid, name: str) -> bytes:
    """Return a STEP file (AP214, mm) with the solid and its name."""
    from .sewing import write_step

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "gear.step"
        write_step(solid.shape, path, _step_name(name))
        return path.read_bytes()


def _row(pieces: Sequence[Patch | None], blank: Blank, pitch: float) -> list[Patch]:
    """Return the surfaces of all teeth in one stretch of the face, counter-clockwise."""
    right_root, *middle, left_root = pieces
    right_tip, left_tip = middle[2], middle[3]
    assert right_tip is not None and left_tip is not None  # pointed teeth are refused
    tooth = [*middle[:2], _joined(right_tip, left_tip), *middle[4:]]
    row: list[Patch | None] = []
    for k in range(blank.teeth):
        if k == 0 and not blank.whole:
            row.append(right_root)
        row += [_turned(patch, k * pitch) for patch in tooth]
        if left_root is None or right_root is None:
            continue
        at_end = k == blank.teeth - 1 and not blank.whole
        following = None if at_end else _turned(right_root, pitch)
        land = left_root if following is None else _joined(left_root, following)
        row.append(_turned(land, k * pitch))
    return [patch for patch in row if patch is not None]


def _cuts(row: list[Patch], blank: Blank, pitch: float, turned: np.ndarray) -> list[Patch]:
    """Return the first and last cut face of a sector in one stretch, with outward normals.

    They are ruled surfaces between the bottom of an outer space and the bore. `turned` is the
    rotation of the bore in each row, rad.
    """
    line, last_line = row[0].points[:, 0], row[-1].points[:, -1]
    sweep = np.array([0.0, blank.teeth * pitch])
    inner = _on_bore(blank, line[:, 2], turned - pitch / 2, sweep)
    return [
        Patch(np.stack([inner[:, 0], line], axis=1), 1),
        Patch(np.stack([last_line, inner[:, 1]], axis=1), 1),
    ]


def _bore(blank: Blank, pitch: float, z: np.ndarray, turned: np.ndarray, tolerance: float) -> Patch:
    """Return the bore surface of a sector whose cut faces wind around the axis.

    `z` and `turned` are the height, mm, and the rotation of the bore, rad, of each row.
    """
    step = (20 * tolerance / blank.bore_mm) ** 0.25  # a cubic leaves less than r h⁴/80
    sweep = blank.teeth * pitch
    around = np.linspace(0.0, sweep, max(4, math.ceil(sweep / step)) + 1)
    return Patch(_on_bore(blank, z, turned - pitch / 2, around))


def _on_bore(blank: Blank, z: np.ndarray, start: np.ndarray, around: np.ndarray) -> np.ndarray:
    """Return bore points x, y, z, mm, at angles `start` of each row plus `around`, rad."""
    angle, radius = start[:, None] + around, blank.bore_mm / 2
    x, y = -radius * np.sin(angle), radius * np.cos(angle)
    return np.stack(np.broadcast_arrays(x, y, z[:, None]), axis=-1)


def _off_bore(patch: Patch, blank: Blank) -> float:
    """Return the largest distance of a bore surface from the cylinder, mm."""
    x, y, _ = np.moveaxis(patch.at_finer(4), -1, 0)
    return float(np.abs(np.hypot(x, y) - blank.bore_mm / 2).max())


def _joined(first: Patch, second: Patch) -> Patch:
    return Patch(np.concatenate([first.points, second.points[:, 1:]], axis=1))


def _turned(patch: Patch | None, angle: float) -> Patch | None:
    """Rotate a patch counter-clockwise about the axis by an angle, rad."""
    if patch is None:
        return None
    x, y, z = np.moveaxis(patch.points, -1, 0)
    cosine, sine = math.cos(angle), math.sin(angle)
    turned = np.stack([x * cosine - y * sine, x * sine + y * cosine, z], axis=-1)
    return Patch(turned, patch.degree)
