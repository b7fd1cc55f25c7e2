"""Which gear can be built as a solid: its teeth, its bore, how much of it."""

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

_BORE_SHARE = 0.3
_LEAST_BORE_MM = 0.1
_SECTIONS = 41

_FINEST_MM = 1e-8
"""Of a tolerance: what a text file still resolves ten times over, a tenth of an atom."""


@dataclass(frozen=True)
class Blank:
    """What is built of a gear.

    **Arguments**
    - `profile`: the curves of the gear.
    - `teeth`: how many.
    - `whole`: all of them; else a sector.
    - `bore_mm`: diameter of the bore, 0 for none.
    - `notes`: what is worth knowing, in sentences.
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
    """Check a gear and what is wanted of it, over its face or in one section; see `gear_mesh`."""
    if not 0 < tolerance_mm < math.inf:
        raise ValueError(f"Argument `tolerance_mm` must be above 0, but is {tolerance_mm}.")
    if tolerance_mm < finest_mm:
        raise UsageError(
            f"a tolerance of {1e3 * tolerance_mm:g} µm is finer than such a file is exact; give"
            f" --tolerance-um {1e3 * finest_mm:g} or more."
        )
    heights = _heights(tooth, section_mm)
    if teeth is not None and not 1 <= teeth <= tooth.teeth:
        raise UsageError(
            f"the gear has {tooth.teeth} teeth, so that --teeth {teeth} cannot be; give 1 to"
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
                "a gear without face width is no solid; give its face_width_mm.",
                where="face_width_mm",
            )
        return np.linspace(-width / 2, width / 2, _SECTIONS)
    if abs(section_mm) > width / 2:
        raise UsageError(
            f"--section-mm {section_mm:g} lies outside of the gear, whose face ends at"
            f" ±{width / 2:g} mm."
        )
    return np.array([section_mm])


def _check_bore(profile: GearProfile, heights: Float[np.ndarray, " n"], bore: float) -> None:
    """The straight lines between the feet of a tooth have to stay outside of the bore."""
    root, turned = float(profile.tooth.root_radius), profile.turned(heights).sum(axis=-1)
    widest = min(profile.feet - float(turned.min()), profile.pitch)
    rim = 2 * root * math.cos(widest / 2)
    if 0 < bore < _LEAST_BORE_MM:
        raise UsageError(
            f"a bore of {bore:g} mm is none; give --bore-mm 0 for a gear without,"
            f" {_LEAST_BORE_MM:g} or more for one with it."
        )
    if not 0 <= bore < 0.99 * rim:
        raise UsageError(
            f"a bore of {bore:g} mm leaves no rim below the teeth, whose root diameter is"
            f" {2 * root:g} mm; give --bore-mm {math.floor(9.8 * rim) / 10:g} or less, 0 for none."
        )


def _notes(profile: GearProfile, heights: Float[np.ndarray, " n"]) -> tuple[str, ...]:
    found, tooth = [], profile.tooth
    overlap = profile.land(heights) < 0
    if overlap.any():
        worst = section_report(tooth, heights).largest_fillet_radius_mm.min()
        low, high = float(heights[overlap].min()), float(heights[overlap].max())
        if len(heights) > 1:
            # Up to the height at which they just touch, which lies between two of those seen.
            ends = [z for z in profile.breaks(heights[0], heights[-1]) if z > high]
            high = min([*ends, float(heights[-1])])
        where = f"at z = {low:g} mm" if low == high else f"from z = {low:.4g} to {high:.4g} mm"
        fits = f"; a cutter with a tip radius of {worst:.3f} mm fits" if worst >= 0 else ""
        found.append(
            f"The fillets of neighbouring teeth overlap {where}; the bottom of the space is there"
            f" where they cross{fits}."
        )
    depth = max(undercut_depth(tooth, side) for side in SIDES)
    if depth > 0:
        found.append(
            f"The teeth are undercut by {depth:.3f} mm; their flanks begin where the fillets cut"
            " them."
        )
    return tuple(found)
