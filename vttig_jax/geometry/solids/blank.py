"""Checks of a gear, its bore and its number of teeth before a solid is built."""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ...base.errors import PairError, UsageError
from ..measures.validation import check_measurable
from ..tooth.form_circle import undercut_depth
from ..tooth.rack_cutter import SIDES
from ..tooth.section_report import section_report
from ..tooth.tooth import Tooth
from .gear_profile import GearProfile, gear_profile

_BORE_SHARE = 0.3  # default bore radius as a share of the root radius; chosen
_LEAST_BORE_MM = 0.1  # smallest bore; chosen
_SECTIONS = 41  # sections checked over the face; chosen
_FINEST_MM = 1e-8  # smallest tolerance: ten times the 1e-9 mm resolution of text files


@dataclass(frozen=True)
class Blank:
    """Gear or sector of a gear that is built as a solid.

    **Arguments**
    - `profile`: curves of the gear.
    - `teeth`: number of teeth built.
    - `whole`: whether the whole gear is built, not a sector.
    - `bore_mm`: diameter of the bore, 0 for none.
    - `notes`: sentences on the geometry of the teeth.
    """

    profile: GearProfile
    teeth: int
    whole: bool
    bore_mm: float
    notes: tuple[str, ...]


def blank_of(
    tooth: Tooth,
    *,
    teeth: int | None,
    bore_mm: float | None,
    tolerance_mm: float,
    section_mm: float | None = None,
    finest_mm: float = _FINEST_MM,
) -> Blank:
    """Check a gear and the options of a solid, which are those of `gear_mesh`; return its `Blank`.

    The whole face is checked, or only the section at height `section_mm`. `finest_mm` is the
    smallest permitted tolerance.
    """
    if not 0 < tolerance_mm < math.inf:
        raise ValueError(f"Argument `tolerance_mm` must be above 0, but is {tolerance_mm}.")
    if tolerance_mm < finest_mm:
        raise UsageError(
            f"a tolerance of {1e3 * tolerance_mm:g} µm is below the accuracy of the file; give"
            f" --tolerance-um {1e3 * finest_mm:g} or more."
        )
    heights = _heights(tooth, section_mm)
    if teeth is not None and not 1 <= teeth <= tooth.teeth:
        raise UsageError(
            f"the gear has {tooth.teeth} teeth, so --teeth {teeth} is not possible; give 1 to"
            f" {tooth.teeth}."
        )
    check_measurable(tooth, float(heights[0]))
    profile = gear_profile(tooth)
    profile.check(heights)
    count = tooth.teeth if teeth is None else teeth
    bore = 2 * _BORE_SHARE * float(tooth.root_radius) if bore_mm is None else bore_mm
    _check_bore(profile, heights, bore)
    return Blank(profile, count, count == tooth.teeth, bore, _notes(profile, heights))


def _heights(tooth: Tooth, section_mm: float | None) -> Float[np.ndarray, " n"]:
    width = float(tooth.face_width_mm)
    if section_mm is None:
        if not width > 0:
            raise PairError(
                "a gear without face width has no solid; give its face_width_mm.",
                where="face_width_mm",
            )
        return np.linspace(-width / 2, width / 2, _SECTIONS)
    if abs(section_mm) > width / 2:
        raise UsageError(
            f"--section-mm {section_mm:g} is outside the gear; its face ends at ±{width / 2:g} mm."
        )
    return np.array([section_mm])


def _check_bore(profile: GearProfile, heights: Float[np.ndarray, " n"], bore: float) -> None:
    """Raise `UsageError` if a bore diameter, mm, is too small or leaves no rim below the teeth."""
    root, rotation = float(profile.tooth.root_radius), profile.rotation(heights).sum(axis=-1)
    widest = min(profile.feet_angle - float(rotation.min()), profile.pitch)
    rim = 2 * root * math.cos(widest / 2)
    if 0 < bore < _LEAST_BORE_MM:
        raise UsageError(
            f"a bore of {bore:g} mm is too small; give --bore-mm 0 for a gear without bore, or"
            f" {_LEAST_BORE_MM:g} or more."
        )
    if not 0 <= bore < 0.99 * rim:
        raise UsageError(
            f"a bore of {bore:g} mm leaves no rim below the teeth, whose root diameter is"
            f" {2 * root:g} mm; give --bore-mm {math.floor(9.8 * rim) / 10:g} or less, 0 for none."
        )


def _notes(profile: GearProfile, heights: Float[np.ndarray, " n"]) -> tuple[str, ...]:
    notes, tooth = [], profile.tooth
    overlap = profile.land(heights) < 0
    if overlap.any():
        worst = section_report(tooth, heights).largest_fillet_radius_mm.min()
        low, high = float(heights[overlap].min()), float(heights[overlap].max())
        if len(heights) > 1:
            # The overlap ends between two of the heights, where the fillets just touch.
            ends = [z for z in profile.breaks(heights[0], heights[-1]) if z > high]
            high = min([*ends, float(heights[-1])])
        where = f"at z = {low:g} mm" if low == high else f"from z = {low:.4g} to {high:.4g} mm"
        fits = f"; a cutter with a tip radius of {worst:.3f} mm fits" if worst >= 0 else ""
        notes.append(
            f"The fillets of neighbouring teeth overlap {where}; the bottom of the space is there"
            f" where they cross{fits}."
        )
    depth = max(undercut_depth(tooth, side) for side in SIDES)
    if depth > 0:
        notes.append(
            f"The teeth are undercut by {depth:.3f} mm; their flanks begin where the fillets cut"
            " them."
        )
    return tuple(notes)
