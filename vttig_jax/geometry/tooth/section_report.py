"""Defects of a tooth by section: undercut, pointed tip and overlapping fillets."""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from scipy.optimize import root_scalar

from ...base.files.text_tables import text_table
from ...pair.gear_pair import involute
from .form_circle import undercut_depth
from .rack_cutter import SIDES, rack_side
from .roll_limits import root_angles
from .tooth import Tooth
from .validation import Heights, check_recessions, section_heights

_ROWS = 11
"""Largest number of sections that are printed (chosen)."""


@dataclass(frozen=True)
class SectionReport:
    """Measures and defects of a tooth by section; flanks are in the order (left, right).

    **Arguments**
    - `z_mm`: heights of the sections.
    - `thickness_mm`: arc of the reference circle inside the tooth.
    - `tip_thickness_mm`: arc of the tip circle inside the tooth; negative where the flanks cross
      below it.
    - `end_radius_mm`: radius at which the flanks meet, below the tip circle for a pointed tooth;
      NaN if they meet already on the base circle.
    - `undercut_depth_mm`: depth of the rack beyond the interference point; positive where the tooth
      is undercut.
    - `root_land_mm`: arc of the root circle between the fillets of neighbouring teeth; negative
      where they overlap because the cutter is narrower than the two arcs at its tip.
    - `largest_fillet_radius_mm`: radius for which the two arcs just fill the tip of the cutter;
      negative where no cutter is narrow enough to reach the root circle.
    """

    z_mm: Float[np.ndarray, " n"]
    thickness_mm: Float[np.ndarray, " n"]
    tip_thickness_mm: Float[np.ndarray, " n"]
    end_radius_mm: Float[np.ndarray, " n"]
    undercut_depth_mm: Float[np.ndarray, "n 2"]
    root_land_mm: Float[np.ndarray, " n"]
    largest_fillet_radius_mm: Float[np.ndarray, " n"]

    @property
    def undercut(self) -> Bool[np.ndarray, "n 2"]:
        """Whether the fillet cuts into the flank, for each section and flank."""
        return self.undercut_depth_mm > 0

    @property
    def pointed(self) -> Bool[np.ndarray, " n"]:
        """Whether the flanks meet on or below the tip circle."""
        return self.tip_thickness_mm <= 0

    @property
    def fillet_overlap(self) -> Bool[np.ndarray, " n"]:
        """Whether the fillets of neighbouring teeth cross above the root circle."""
        return self.root_land_mm < 0

    @property
    def gone(self) -> Bool[np.ndarray, " n"]:
        """Whether the tooth has no thickness at the reference circle."""
        return self.thickness_mm <= 0

    @property
    def sound(self) -> Bool[np.ndarray, " n"]:
        """Whether the section has no defect: no undercut, no overlap, not pointed, not gone."""
        return ~(self.undercut.any(axis=1) | self.pointed | self.fillet_overlap | self.gone)

    def remarks(self, section: int) -> str:
        """Describe the defects of one section in words; return "sound" if it has none."""
        defects = []
        if self.gone[section]:
            defects.append("no tooth at the reference circle")
        undercut = [side for k, side in enumerate(SIDES) if self.undercut[section, k]]
        if undercut:
            flanks = "both flanks" if len(undercut) == 2 else f"{undercut[0]} flank"
            defects.append(f"undercut by {self.undercut_depth_mm[section].max():.3f} mm, {flanks}")
        if self.pointed[section]:
            defects.append(f"pointed at radius {self.end_radius_mm[section]:.3f} mm")
        if self.fillet_overlap[section]:
            largest = self.largest_fillet_radius_mm[section]
            fits = f"radius {largest:.3f} mm fits" if largest >= 0 else "no cutter fits"
            defects.append(f"fillets overlap, {fits}")
        return "; ".join(defects) or "sound"

    def __str__(self) -> str:
        count, bad = len(self.z_mm), int((~self.sound).sum())
        shown = np.unique(np.linspace(0, count - 1, min(count, _ROWS)).round())
        columns = self.thickness_mm, self.tip_thickness_mm, self.root_land_mm
        rows = [
            (
                f"{self.z_mm[section]:.3f}",
                *(f"{column[section]:.4f}" for column in columns),
                self.remarks(section),
            )
            for section in map(int, shown)
        ]
        headers = [("z", "mm"), ("thickness", "mm"), ("at the tip", "mm"), ("root land", "mm"), ""]
        verb = "is" if bad == 1 else "are"
        title = f"{bad or 'none'} of {count} sections {verb} not sound"
        return f"{title}\n{text_table(rows, headers, align='rrrrl')}"


def section_report(tooth: Tooth, z: Heights = None) -> SectionReport:
    """Report the defects of a tooth in sections of the gear; the tooth is not clipped or repaired.

        undercut: −y_start > R sin² α, where y_start is the height of the start of the rack's flank
        pointed: ψ_left(r_a, z) + ψ_right(r_a, z) ≤ 0, where ψ are the half angles of `Tooth`

    **Arguments**
    - `tooth`: gear.
    - `z`: heights of the sections, mm; 41 over the face width when absent.

    **Returns** `SectionReport`, which prints as a table.

    **Raises** `PairError` if a recession is not finite or its table does not increase in z.

    **Example**
    ```python
    >>> from vttig_jax import Gear, GearPair
    >>> from vttig_jax.geometry import section_report, tooth_of
    >>> gears = Gear(45, 3, 3, 20), Gear(80, 3, 3, 20)
    >>> pair = GearPair(*gears, module_mm=2.0, pressure_angles_deg=20.0)
    >>> print(section_report(tooth_of(pair, "driving"), [-10.0, 0.0, 10.0]))
    1 of 3 sections is not sound
     z [mm]  thickness [mm]  at the tip [mm]  root land [mm]
    -10.000          4.1897           2.6323         -0.7467  fillets overlap, radius 0.195 mm fits
      0.000          3.1416           1.5376          0.2433  sound
     10.000          2.0934           0.4428          1.2332  sound

    ```
    """
    heights = section_heights(tooth, z)
    check_recessions(tooth, heights)
    sections = heights.shape
    radii = (np.full(sections, float(r)) for r in (tooth.reference_radius, tooth.tip_radius))
    thickness, tip = (np.asarray(tooth.thickness(radius, heights)) for radius in radii)
    depths = np.array([undercut_depth(tooth, side) for side in SIDES])
    gap = 2 * math.pi / tooth.teeth - np.asarray(root_angles(tooth, heights)).sum(axis=-1)
    return SectionReport(
        z_mm=heights,
        thickness_mm=thickness,
        tip_thickness_mm=tip,
        end_radius_mm=np.array([_end_radius(tooth, t) for t in thickness]),
        undercut_depth_mm=np.broadcast_to(depths, (*sections, 2)),
        root_land_mm=gap * float(tooth.root_radius),
        largest_fillet_radius_mm=_largest_radius(tooth, gap * float(tooth.reference_radius)),
    )


def _end_radius(tooth: Tooth, thickness: float) -> float:
    """Return the radius, mm, at which the flanks meet, from the thickness at the reference circle.

    It solves thickness/R + Σ inv αₜ = Σ inv α(r); the right side increases with r.
    """
    base = np.asarray(tooth.base_radii)
    reference = involute(np.asarray(tooth.pressure_angles)).sum()
    target = thickness / float(tooth.reference_radius) + reference

    def residual(radius: float) -> float:
        angles = np.arccos(np.minimum(base / radius, 1.0))
        return float(target - involute(angles).sum())

    low = high = float(base.max())
    if residual(low) <= 0:
        return math.nan
    while residual(high) > 0:
        high *= 2
    return root_scalar(residual, bracket=(low, high), xtol=1e-12).root


def _largest_radius(tooth: Tooth, land: np.ndarray) -> np.ndarray:
    """Return the arc radius, mm, for which the tip of the cutter has no land.

    `land` is the width of this land, mm, with the arcs as drawn; it is negative if they overlap.
    An arc takes (1 − sin α)/cos α of its radius from half of the cutter's tip.
    """
    angles = [float(rack_side(tooth, side).pressure_angle) for side in SIDES]
    share = sum((1 - math.sin(a)) / math.cos(a) for a in angles)
    return float(tooth.fillet_radius_mm) + land / share
