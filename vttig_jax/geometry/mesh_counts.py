"""How fine a grid has to be for a tolerance: estimated from curvature and twist, then measured."""

import math
import os
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
from jaxtyping import Float

from ..base.errors import PairError, UsageError
from .mesh_error import chordal_error, section_error
from .mesh_grid import ORDER, Counts, ToothGrid, section_curve
from .mesh_profile import GearProfile
from .surface import PARTS

_ACROSS = 0.55
"""Part of the tolerance that the chords of a section may take; the rest is for the way along."""

_PROBE = 8
_ROUNDS = 24
_TRIANGLE_BYTES = 400
"""Memory a triangle takes at most while a gear is built and written, measured."""

_COARSEST_UM = 1e5
"""Of a tolerance that is proposed."""

_FALLBACK_BYTES = 4 * 2**30


def fitting_grid(
    profile: GearProfile,
    tolerance_mm: float,
    teeth: int,
    rounding: type[np.floating] = np.float64,
) -> tuple[ToothGrid, float]:
    """A grid of one tooth whose triangles stay within a tolerance, and the error measured, mm.

    **Arguments**
    - `profile`: the curves of the gear.
    - `tolerance_mm`: largest distance of the true surface from the triangles.
    - `teeth`: how many the mesh will have; only for the memory.
    - `rounding`: to which the coordinates are rounded when written.

    **Raises** `UsageError` where the mesh would not fit into the memory, or where coordinates of
    this rounding cannot hold the tolerance.
    """
    _check_rounding(profile, tolerance_mm, rounding)
    half = float(profile.tooth.face_width_mm) / 2
    stretches = (-half, *profile.breaks(-half, half), half)

    def estimate(tolerance: float) -> Counts:
        return _estimate(profile, stretches, tolerance)

    grid = ToothGrid(profile, estimate(tolerance_mm), stretches)
    error = math.inf
    for _ in range(_ROUNDS):
        _check_memory(grid.counts, teeth, tolerance_mm, estimate)
        points = grid.points().astype(rounding).astype(float)
        error, across = chordal_error(grid, points)
        if error <= tolerance_mm:
            return grid, error
        grid = replace(grid, counts=_finer(grid.counts, error, across, tolerance_mm))
    raise PairError(
        f"triangles within {1e3 * tolerance_mm:g} µm were not found, {1e3 * error:.3g} µm is left;"
        " give a larger tolerance, or a recession that is smooth.",
        where="recession",
    )


def triangles_of(counts: Counts, teeth: int) -> int:
    """Triangles of the teeth, near enough: the end faces and the bore add some."""
    return 2 * teeth * counts.around * (counts.rows + 1)


def _check_memory(
    counts: Counts, teeth: int, tolerance_mm: float, estimate: Callable[[float], Counts]
) -> None:
    """Raise `UsageError` where a mesh needs more memory than there is."""
    wanted, most = triangles_of(counts, teeth), _free_bytes() // _TRIANGLE_BYTES
    if wanted <= most:
        return
    fits = rounded_up(1e3 * tolerance_mm * wanted / most)  # they fall as 1/tolerance, or slower
    while fits < _COARSEST_UM and 1.3 * triangles_of(estimate(1e-3 * fits), teeth) > most:
        fits = rounded_up(1.01 * fits)
    coarser = f"--tolerance-um {fits:g} or more, or " if fits < _COARSEST_UM else ""
    raise UsageError(
        f"a tolerance of {1e3 * tolerance_mm:g} µm takes about {wanted:.2g} triangles, more than"
        f" the memory holds ({most:.2g}); give {coarser}fewer --teeth."
    )


def rounded_up(value: float) -> float:
    """The next number of one digit."""
    digits = 10.0 ** math.floor(math.log10(value))
    return math.ceil(value / digits * (1 - 1e-9)) * digits


def section_counts(
    profile: GearProfile, z: Float[np.ndarray, " n"], tolerance_mm: float, teeth: int
) -> tuple[Counts, float]:
    """A division around the tooth whose chords stay within a tolerance, and their error, mm."""

    def estimate(tolerance: float) -> Counts:
        return _around(profile, z, tolerance)[0]

    counts = estimate(tolerance_mm)
    while True:
        _check_memory(counts, teeth, tolerance_mm, estimate)
        if (error := section_error(profile, counts, z)) <= tolerance_mm:
            return counts, error
        fillet, flank = (math.ceil(1.1 * n) for n in (counts.fillet, counts.flank))
        counts = replace(counts, fillet=fillet, flank=flank)


def _around(
    profile: GearProfile, z: Float[np.ndarray, " n"], tolerance: float
) -> tuple[Counts, float]:
    """The division, and the longest interval of fillets and flanks, mm."""
    probe = Counts(_PROBE, _PROBE, _PROBE, _PROBE, (1,))
    points, fine = (_plane_curve(profile, probe, z, finer) for finer in (1, 2))
    chord = points[:, 1:] - points[:, :-1]
    length = np.linalg.norm(chord, axis=-1)
    middle = fine[:, 1::2] - points[:, :-1]
    area = np.abs(chord[..., 0] * middle[..., 1] - chord[..., 1] * middle[..., 0])
    sagitta = (area / np.maximum(length, 1e-12)).max(axis=0).reshape(-1, _PROBE).max(axis=1)
    total = length.max(axis=0).reshape(-1, _PROBE).sum(axis=1)
    counts = {}
    for part in PARTS:
        worst = max(s for s, (_, name) in zip(sagitta, ORDER, strict=True) if name == part)
        counts[part] = max(1, math.ceil(_PROBE * math.sqrt(1.1 * worst / tolerance)))
    step = max(
        length / counts[part]
        for length, (_, part) in zip(total, ORDER, strict=True)
        if part in ("fillet", "flank")
    )
    return Counts(**counts, sections=(1,)), step


def _plane_curve(profile: GearProfile, counts: Counts, z: np.ndarray, finer: int = 1) -> np.ndarray:
    radius, clockwise = section_curve(profile, counts, z, finer)
    return np.stack([radius * np.sin(clockwise), radius * np.cos(clockwise)], axis=-1)


def _estimate(profile: GearProfile, stretches: tuple[float, ...], tolerance: float) -> Counts:
    """Around as in sections; along by twist |Δψ| L/(4 n k) and by bending of the joints."""
    ends = np.linspace(stretches[0], stretches[-1], 2 * _PROBE + 1)
    counts, step = _around(profile, np.append(ends, stretches), _ACROSS * tolerance)
    left = 0.5 * (1 - _ACROSS) * tolerance
    sections = []
    for low, high in pairwise(stretches):
        z = np.linspace(low, high, 2 * _PROBE + 1)
        twist = np.abs(np.diff(profile.turned(z), axis=0)).sum(axis=0).max() * step / 4
        coarse = Counts(1, 1, 1, 1, (1,))
        joints = _plane_curve(profile, coarse, z)
        bent = np.linalg.norm(joints[1:-1] - (joints[:-2] + joints[2:]) / 2, axis=-1).max()
        bends = 2 * _PROBE * math.sqrt(bent / left)
        sections.append(max(1, math.ceil(twist / left), math.ceil(bends / 2)))
    return replace(counts, sections=tuple(sections))


def _finer(counts: Counts, error: float, across: float, tolerance: float) -> Counts:
    """The next try: finer sections where these use up their part, else more of them."""
    if across > max(_ACROSS, 0.7) * tolerance:
        factor = math.sqrt(across / (_ACROSS * tolerance))
        return replace(
            counts,
            **{part: math.ceil(counts.of(part) * min(factor, 2.0)) for part in PARTS},
        )
    over = (error - across) / max(tolerance - across, 0.1 * tolerance)
    factor = min(max(1.15, over**0.7), 2.0)
    return replace(counts, sections=tuple(math.ceil(k * factor) for k in counts.sections))


def _check_rounding(profile: GearProfile, tolerance: float, rounding: type[np.floating]) -> None:
    unit = float(np.spacing(rounding(float(profile.tooth.tip_radius))))
    if tolerance < 8 * unit:
        raise UsageError(
            f"coordinates of this file resolve {1e3 * unit:.2g} µm, too coarse for a tolerance of"
            f" {1e3 * tolerance:g} µm; give --tolerance-um {rounded_up(8e3 * unit):g} or more"
            + ("." if rounding is np.float64 else ", or write .ply or .obj.")
        )


def _free_bytes() -> int:
    """Memory that a program can still get, where the system tells it."""
    with suppress(OSError):  # pages that only hold copies of files count here, not in sysconf
        for line in Path("/proc/meminfo").read_text("ascii").splitlines():
            if line.startswith("MemAvailable:"):
                return 1024 * int(line.split()[1])
    with suppress(AttributeError, ValueError, OSError):
        return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") // 2
    return _FALLBACK_BYTES
