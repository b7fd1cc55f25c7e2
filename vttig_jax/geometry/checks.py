"""Checks of a gear or a pair before something is computed from it, and a report by section."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Bool, Float, Real

from ..base.errors import PairError
from ..base.files.text_tables import text_table
from ..pair.gear_pair import involute
from .form import form_radius, radius_where, undercut_depth
from .surface import rack_side
from .tooth import SIDES, Tooth

Heights = Real[ArrayLike, "..."] | Sequence[float] | None
"""Heights of sections in mm, or None for sections over the face width."""

_SECTIONS = 41  # sections checked by default; a chosen number
_ROWS = 11  # largest number of sections that are printed; chosen


def check_tooth(tooth: Tooth, z: Heights = None) -> None:
    """Raise `PairError` if a gear has no tooth surface; `section_report` reports other defects.

    The function checks the numbers of the drawing, the recession of each flank (finite values,
    differentiable by JAX) and the thickness at the reference circle,
    which must be positive in every section.

    **Arguments**
    - `tooth`: gear.
    - `z`: heights of the checked sections, mm; over the face width when absent.

    **Example**
    ```python
    >>> import vttig_jax
    >>> from vttig_jax import Gear, GearPair
    >>> from vttig_jax.base import PairError
    >>> from vttig_jax.geometry import check_tooth, tooth_of
    >>> wide = Gear(45, 3, 3, 80)
    >>> pair = GearPair(wide, wide, module_mm=2.0, pressure_angles_deg=20.0)
    >>> try:
    ...     check_tooth(tooth_of(pair, "driving"))
    ... except PairError as error:
    ...     print(error)
    thickness: the tooth is -1.051 mm thick on the reference circle at z = 40 mm; make the face
    narrower (the tooth vanishes at z = 30 mm), the helix angles smaller or the profile shift
    larger.

    ```
    """
    limits = {
        "module_mm": (tooth.module_mm, 0.0, np.inf),
        "pressure_angles_deg": (tooth.pressure_angles_deg, 0.0, 90.0),
        "addendum_mm": (tooth.addendum_mm, 0.0, np.inf),
        "dedendum_mm": (tooth.dedendum_mm, 0.0, np.inf),
        "root radius": (tooth.root_radius, 0.0, np.inf),
        "fillet_radius_mm": (tooth.fillet_radius_mm, -5e-324, np.inf),  # 0 is a sharp cutter
    }
    for name, (value, low, high) in limits.items():
        for number in np.ravel(value):
            if not low < number < high:
                limit = "above 0" if high == np.inf else f"between {low:g} and {high:g}"
                raise PairError(f"{number:g} is not possible; give a value {limit}.", where=name)
    base = np.max(np.asarray(tooth.base_radii))
    if not tooth.tip_radius > base:
        raise PairError(
            f"the tip circle ({float(tooth.tip_radius):.3f} mm) lies inside the base circle"
            f" ({base:.3f} mm), so there is no flank; give more teeth, addendum or profile shift.",
            where="tip radius",
        )
    heights = section_heights(tooth, z)
    check_recessions(tooth, heights)
    radius = np.full(heights.shape, float(tooth.reference_radius))
    thickness = np.asarray(tooth.thickness(radius, heights))
    vanished = heights[thickness <= 0]
    if len(vanished):
        worst = int(np.argmin(thickness))
        raise PairError(
            f"the tooth is {thickness[worst]:.3f} mm thick on the reference circle at z ="
            f" {heights[worst]:g} mm; make the face narrower (the tooth vanishes at z ="
            f" {vanished[np.argmin(np.abs(vanished))]:g} mm), the helix angles smaller or the"
            " profile shift larger.",
            where="thickness",
        )


def check_recessions(tooth: Tooth, heights: Float[np.ndarray, " n"]) -> None:
    """Raise `PairError` if δ of a flank is not finite or not differentiable by JAX."""
    for recession, side in zip(tooth.recession, SIDES, strict=True):
        where = f"recession of the {side} flank"
        values = np.asarray(recession(heights), float)
        if values.shape != heights.shape:
            raise PairError(
                f"the function returns shape {values.shape} for heights of shape {heights.shape};"
                " return one value for each height.",
                where=where,
            )
        if not np.all(finite := np.isfinite(values)):
            first = int(np.argmin(finite))
            raise PairError(
                f"δ is not finite at z = {heights[first]:g} mm ({values[first]:g}); give a function"
                " that is smooth over the whole face (a crowned gear needs its face width).",
                where=where,
            )
        try:
            shape = jax.ShapeDtypeStruct(heights.shape, heights.dtype)
            jax.eval_shape(lambda z, recession=recession: jnp.asarray(recession(z)), shape)
        except jax.errors.JAXTypeError as error:
            raise PairError(
                "the function cannot be differentiated by JAX; write it with `jax.numpy` instead of"
                " `numpy` and without `if` on z.",
                where=where,
            ) from error


def section_heights(tooth: Tooth, z: Heights) -> Float[np.ndarray, " n"]:
    """Return the given heights, or equidistant heights over the face width, mm."""
    if z is not None:
        heights = np.atleast_1d(np.asarray(z, float)).ravel()
        if not len(heights) or not np.all(np.isfinite(heights)):
            raise ValueError(f"Argument `z` must be finite heights in mm, but is {z!r}.")
        return heights
    width = float(tooth.face_width_mm)
    if not width > 0:
        raise ValueError(
            "Argument `z` must be given for a gear without a face width, but is None; or give the"
            " gear its face_width_mm."
        )
    return np.linspace(-width / 2, width / 2, _SECTIONS)


def check_pointed(tooth: Tooth, heights: Float[np.ndarray, " n"]) -> None:
    """Raise `PairError` if the flanks of a tooth meet on or below the tip circle."""
    tip = float(tooth.tip_radius)
    angles = tooth.half_angles(np.full_like(heights, tip), heights).sum(axis=-1)
    worst = int(np.argmin(angles))
    if angles[worst] > 0:
        return
    total = float(angles[worst]) + float(
        involute(np.arccos(np.asarray(tooth.base_radii) / tip)).sum()
    )
    radius = radius_where(tooth.base_radii, total)
    end = "" if radius is None else f": its flanks meet at a diameter of {2 * radius:.3f} mm"
    recession = tooth.recessions(heights).sum(axis=-1)
    tapers = np.ptp(recession) and recession[worst] > 0
    cure = "the face narrower, the helix angles smaller" if tapers else "the profile shift lower"
    raise PairError(
        f"the tooth is pointed at z = {heights[worst]:g} mm{end}, below the tip circle of"
        f" {2 * tip:g} mm; make {cure} or the addendum lower.",
        where="tip circle",
    )


def check_measurable(tooth: Tooth, section_mm: float = 0.0) -> None:
    """Raise `PairError` for a tooth without thickness, a pointed tooth or a closed tooth space.

    The function checks the section and, if the face width is given, sections over the face. An
    undercut tooth is accepted.

    **Example**
    ```python
    >>> from vttig_jax import Gear, GearPair
    >>> from vttig_jax.base import PairError
    >>> from vttig_jax.geometry import check_measurable
    >>> from vttig_jax.geometry import tooth_of
    >>> wide = Gear(45, 3.0, 3.0, 30.0)
    >>> pair = GearPair(wide, wide, module_mm=2.0, pressure_angles_deg=20.0)
    >>> try:
    ...     check_measurable(tooth_of(pair, "driving"))
    ... except PairError as error:
    ...     print(error)
    tip circle: the tooth is pointed at z = 15 mm: its flanks meet at a diameter of 93.783 mm, below
    the tip circle of 94 mm; make the face narrower, the helix angles smaller or the addendum lower.

    ```
    """
    heights = np.array([section_mm])
    if not np.isnan(float(tooth.face_width_mm)):
        heights = np.append(section_heights(tooth, None), heights)
    check_tooth(tooth, heights)
    forms = [form_radius(tooth, side) for side in SIDES]
    if not all(form < float(tooth.tip_radius) for form in forms):
        raise PairError(
            f"the fillet leaves no flank below the tip circle of {2 * float(tooth.tip_radius):g}"
            " mm; take more teeth, more profile shift or a smaller tip radius of the rack.",
            where="form circle",
        )
    check_pointed(tooth, heights)
    radius = max(forms)
    angles = tooth.half_angles(np.full_like(heights, radius), heights).sum(axis=-1)
    spaces = radius * (2 * np.pi / tooth.teeth - angles)
    worst = int(np.argmin(spaces))
    if not spaces[worst] > 0:
        raise PairError(
            f"the teeth leave no space between them at z = {heights[worst]:g} mm"
            f" ({spaces[worst]:.3f} mm at a diameter of {2 * radius:.3f} mm); make the face"
            " narrower, the helix angles smaller or the rack less deep.",
            where="space",
        )


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
        columns = self.z_mm, self.thickness_mm, self.tip_thickness_mm, self.root_land_mm
        rows = [
            (*(f"{column[k]:.{3 if column is self.z_mm else 4}f}" for column in columns), remarks)
            for k in map(int, np.unique(np.linspace(0, count - 1, min(count, _ROWS)).round()))
            if (remarks := self.remarks(k))
        ]
        headers = [("z", "mm"), ("thickness", "mm"), ("at the tip", "mm"), ("root land", "mm"), ""]
        title = f"{bad or 'none'} of {count} sections {'is' if bad == 1 else 'are'} not sound"
        return f"{title}\n{text_table(rows, headers, align='rrrrl')}"


def section_report(tooth: Tooth, z: Heights = None) -> SectionReport:
    """Report the defects of a tooth in sections of the gear; the tooth is not clipped or repaired.

        undercut: −y_start > R sin² α, where y_start is the height of the start of the rack's flank
        pointed: ψ_left(r_a, z) + ψ_right(r_a, z) ≤ 0, where ψ are the half angles of `Tooth`

    **Arguments**
    - `tooth`: gear.
    - `z`: heights of the sections, mm; 41 over the face width when absent.

    **Returns** `SectionReport`, which prints as a table.

    **Raises** `PairError` if a recession is not finite.

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
    reference, ones = float(tooth.reference_radius), np.ones(heights.shape)
    thickness, tip = (
        np.asarray(tooth.thickness(float(radius) * ones, heights))
        for radius in (reference, tooth.tip_radius)
    )
    base = involute(np.asarray(tooth.pressure_angles)).sum()
    ends = [radius_where(tooth.base_radii, arc / reference + base) for arc in thickness]
    racks = [rack_side(tooth, side) for side in SIDES]
    feet = [
        rack.mirror * -rack.arc_roll(np.asarray(math.pi / 2)) - rack.recedes(heights) / reference
        for rack in racks
    ]
    gap = 2 * math.pi / tooth.teeth - np.asarray(feet[0] + feet[1])
    # An arc takes (1 − sin α)/cos α of its radius from half of the cutter's tip.
    share = sum((1 - np.sin(r.pressure_angle)) / np.cos(r.pressure_angle) for r in racks)
    depths = np.array([undercut_depth(tooth, side) for side in SIDES])
    return SectionReport(
        z_mm=heights,
        thickness_mm=thickness,
        tip_thickness_mm=tip,
        end_radius_mm=np.array([math.nan if end is None else end for end in ends]),
        undercut_depth_mm=np.broadcast_to(depths, (*heights.shape, 2)),
        root_land_mm=gap * float(tooth.root_radius),
        largest_fillet_radius_mm=float(tooth.fillet_radius_mm) + gap * reference / share,
    )
