"""Form circle of a tooth, where its fillet meets the flank, and interference with the mate."""

import math
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from scipy.optimize import root_scalar

from ..base.arrays import Numbers
from ..base.files.text_tables import text_table
from ..pair.gear_pair import GearPair
from .surface import rack_side, side_index
from .tooth import SHAFTS, SIDES, Side, Taper, Tooth, tooth_of

_STEP = 1e-14
"""Tolerance of the direction of the normal, rad, and of a roll angle in a root search (chosen)."""


def undercut_depth(tooth: Tooth, side: Side) -> float:
    """Return the depth −y_start − R sin² α, mm, of the rack flank beyond the interference point.

    It is positive for an undercut tooth: the straight flank of the rack extends below the point at
    which the involute ends on the base circle, so the fillet cuts into the flank.

    **Example**
    ```python
    >>> from vttig_jax import Gear, GearPair
    >>> from vttig_jax.geometry import tooth_of, undercut_depth
    >>> gears = Gear(12, face_width_mm=20), Gear(80, face_width_mm=20)
    >>> pair = GearPair(*gears, module_mm=2.0, pressure_angles_deg=20.0)
    >>> round(undercut_depth(tooth_of(pair, "driving"), "left"), 4)
    0.5963

    ```
    """
    rack = rack_side(tooth, side)
    limit = tooth.reference_radius * np.sin(rack.pressure_angle) ** 2
    return float(-rack.flank_start - limit)


def form_radius(tooth: Tooth, side: Side) -> float:
    """Return the radius, mm, at which the involute begins: where the fillet touches or cuts it.

    It is the same in every section, because the recession rotates fillet and flank together. It is
    NaN where an undercut removes the flank up to the tip or cuts through the tooth.

    **Example**
    ```python
    >>> from vttig_jax import Gear, GearPair
    >>> from vttig_jax.geometry import form_radius, tooth_of
    >>> gears = Gear(12, face_width_mm=20), Gear(80, face_width_mm=20)
    >>> pair = GearPair(*gears, module_mm=2.0, pressure_angles_deg=20.0)
    >>> round(form_radius(tooth_of(pair, "driving"), "left"), 4)
    11.3027
    >>> round(form_radius(tooth_of(pair, "driven"), "left"), 4)
    78.1933

    ```
    """
    rack = replace(rack_side(tooth, side), recession=Taper(0.0))
    base = float(tooth.base_radii[side_index(side)])
    if undercut_depth(tooth, side) <= 0:
        return math.hypot(base, start_of_flank(tooth, side))
    alpha, height = float(rack.pressure_angle), np.zeros(1)
    at_base = float(rack.half_tooth) + math.tan(alpha) - alpha

    def fillet(normal_angle: float) -> tuple[float, float]:
        """Return the radius, mm, and the angle from the centre line of the tooth, rad."""
        angle = np.array([normal_angle])
        x, y, _ = rack.to_gear(rack.arc(angle, height), rack.arc_roll(angle))[0]
        return math.hypot(x, y), math.atan2(-rack.mirror * x, y)

    def excess(normal_angle: float) -> float:
        """Return the angle, rad, of the fillet outside the involute; negative where it cuts it."""
        radius, angle = fillet(normal_angle)
        roll = math.sqrt(max((radius / base) ** 2 - 1, 0.0))
        return angle - (at_base - roll + math.atan(roll))

    if fillet(alpha)[0] <= base:  # the whole fillet is inside the base circle
        return base
    ends = (alpha, math.pi / 2)
    on_base = root_scalar(lambda angle: fillet(angle)[0] - base, bracket=ends, xtol=_STEP).root
    if excess(on_base) >= 0 or excess(alpha) <= 0:
        return math.nan  # the undercut of a gear with few teeth cuts through the tooth
    radius = fillet(root_scalar(excess, bracket=(alpha, on_base), xtol=_STEP).root)[0]
    return radius if radius < float(tooth.tip_radius) else math.nan


def start_of_flank(tooth: Tooth, side: Side) -> float:
    """Return the roll length R sin α + y_start/sin α, mm, at the start of the rack's flank."""
    rack = rack_side(tooth, side)
    sine = np.sin(rack.pressure_angle)
    return float(tooth.reference_radius * sine + rack.flank_start / sine)


def radius_where(base_radii: Float[Numbers, "2"], total: float) -> float | None:
    """Return the radius, mm, at which the involute functions of two flanks have a given sum, rad.

        inv α_L(r) + inv α_R(r) = total,    cos α(r) = r_b/r

    Return None if the total is less than the sum at the larger base circle.
    """
    base_radii = np.asarray(base_radii)
    largest = float(base_radii.max())

    def excess(roll: float) -> float:
        """Return the sum minus the total at a roll angle, rad, of the larger base circle."""
        tangents = np.sqrt((1 + roll**2) * (largest / base_radii) ** 2 - 1)
        return float((tangents - np.arctan(tangents)).sum()) - total

    if not excess(0.0) <= 0.0:
        return None
    # At the upper limit inv α > tan α − π/2 of the larger base circle alone exceeds the total.
    bracket = (0.0, total + math.pi / 2)
    root = root_scalar(excess, bracket=bracket, xtol=_STEP, rtol=_STEP).root
    return largest * math.hypot(1.0, root)


@dataclass(frozen=True)
class FilletInterference:
    """Radii of both gears in mm; rows are (driving, driven), columns (flank A, flank B).

    **Arguments**
    - `form_radius_mm`: radius at which the involute begins; NaN if undercut removes it completely.
    - `active_radius_mm`: smallest radius that the tip of the mate reaches on the line of action;
      NaN where that point lies beyond the interference point, where no involute exists.
    - `overlap_mm`: length on the line of action by which the mate's tip reaches beyond the form
      circle; positive where it meets the fillet, infinite where there is no involute.
    """

    form_radius_mm: Float[np.ndarray, "gear=2 flank=2"]
    active_radius_mm: Float[np.ndarray, "gear=2 flank=2"]
    overlap_mm: Float[np.ndarray, "gear=2 flank=2"]

    @property
    def interferes(self) -> np.ndarray:
        """Whether the tip of the mate meets the fillet, shape (gear, flank)."""
        return self.overlap_mm > 0

    def __str__(self) -> str:
        values = self.form_radius_mm, self.active_radius_mm, -self.overlap_mm
        rows = []
        for gear, flank in np.ndindex(2, 2):
            numbers = [float(value[gear, flank]) for value in values]
            texts = [f"{one:.3f}" if math.isfinite(one) else None for one in numbers]
            meets = self.interferes[gear, flank]
            remark = "the mate's tip meets the fillet" if meets else "free"
            rows.append((f"{SHAFTS[gear]} {'AB'[flank]}", *texts, remark))
        headers = ["flank", ("form radius", "mm"), ("active from", "mm"), ("clear by", "mm"), ""]
        return text_table(rows, headers, align="lrrrl")


def fillet_interference(pair: GearPair) -> FilletInterference:
    """Compare the start of each involute with the start of its active profile.

        active: √(r² − r_b²) = a sin α_w − √(r_a² − r_b²) of the mate

    The gears have no eccentricity, the nominal centre distance and tip circles as drawn. All
    sections give the same result, because the recession rotates a flank together with its fillet.

    **Example**
    ```python
    >>> from vttig_jax import Gear, GearPair
    >>> from vttig_jax.geometry import fillet_interference
    >>> gears = Gear(12, face_width_mm=20), Gear(80, face_width_mm=20)
    >>> print(fillet_interference(GearPair(*gears, module_mm=2.0, pressure_angles_deg=20.0)))
    flank      form radius [mm]  active from [mm]  clear by [mm]
    driving A            11.303                 –         -2.058  the mate's tip meets the fillet
    driving B            11.303                 –         -2.058  the mate's tip meets the fillet
    driven A             78.193            78.665          1.655  free
    driven B             78.193            78.665          1.655  free

    ```
    """
    form, active, overlap = np.empty((3, 2, 2))
    base, tips = np.asarray(pair.base_radii), np.asarray(pair.tip_radii)
    line = float(pair.centre_distance_mm) * np.sin(np.asarray(pair.working_pressure_angles))
    for gear, flank in np.ndindex(2, 2):
        tooth, side = tooth_of(pair, SHAFTS[gear]), SIDES[flank if gear == 0 else 1 - flank]
        active_length = line[flank] - np.sqrt(tips[1 - gear] ** 2 - base[1 - gear, flank] ** 2)
        base_radius = base[gear, flank]
        form[gear, flank] = form_radius(tooth, side)
        radius = np.hypot(base_radius, active_length)
        active[gear, flank] = radius if active_length >= 0 else np.nan
        form_length = start_of_flank(tooth, side)
        if undercut_depth(tooth, side) > 0:
            form_length = np.sqrt(np.maximum(form[gear, flank] ** 2 - base_radius**2, 0.0))
        overlap[gear, flank] = np.nan_to_num(form_length - active_length, nan=np.inf)
    return FilletInterference(form, active, overlap)
