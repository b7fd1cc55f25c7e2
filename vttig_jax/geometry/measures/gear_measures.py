"""Workshop measures of one gear and their JSON record."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...base.units import DEG
from ...pair.gear_pair import GearPair
from ..tooth.form_circle import form_radius, undercut_depth
from ..tooth.rack_cutter import SIDES
from ..tooth.tooth import Tooth
from .over_balls import OverBalls, over_balls, usual_ball
from .span import Span, span
from .thickness import base_helix_angles, chordal_height, chordal_thickness, recession_slopes


@dataclass(frozen=True)
class FaceThickness:
    """Tooth thickness at one radius, as arcs in mm, in a section and at the ends of the face.

    **Arguments**
    - `radius_mm`: radius of the circle.
    - `thin`, `thick`: thickness at the two ends of the face, None without face width.
    - `section`: thickness at the measured section.
    - `reason`: sentence that explains a missing thickness.
    """

    radius_mm: float
    thin: float | None = None
    section: float | None = None
    thick: float | None = None
    reason: str | None = None


@dataclass(frozen=True)
class GearMeasures:
    """Workshop measures of one gear in mm and degrees; pairs of flanks are (left, right).

    **Arguments**
    - `teeth`: number of teeth; `section_mm`: height of the measured section.
    - `reference_diameter_mm` … `form_diameters_mm`: diameters of the circles; the involute of a
      flank begins at its form circle. `undercut`: whether the fillet cuts into a flank.
    - `base_helix_deg`: base helix angles at the section, positive where the flank thins the tooth
      towards +z.
    - `thickness`, `tip_thickness`: at the reference and the tip circle; `thickness_at`: at further
      radii.
    - `chordal_thickness_mm`, `chordal_height_mm`: at the reference circle, in the transverse plane.
    - `span`, `over_balls`: results of the functions of the same name. `over_balls_slope`: change
      of the measurement over balls per mm of z, mm/mm; None if it has no value.
    """

    teeth: int
    section_mm: float
    reference_diameter_mm: float
    tip_diameter_mm: float
    root_diameter_mm: float
    base_diameters_mm: tuple[float, float]
    form_diameters_mm: tuple[float, float]
    undercut: bool
    base_helix_deg: tuple[float, float]
    thickness: FaceThickness
    tip_thickness: FaceThickness
    thickness_at: tuple[FaceThickness, ...]
    chordal_thickness_mm: float
    chordal_height_mm: float
    span: Span
    over_balls: OverBalls
    over_balls_slope: float | None

    @property
    def notes(self) -> list[str]:
        """Sentences on measures that are missing or need care."""
        notes = [item.reason for item in (*self.thickness_at, self.span, self.over_balls)]
        if self.thickness.thin is None:
            notes.append("The drawing gives no face_width_mm, so that its teeth have no ends.")
        if self.undercut:
            notes.append(
                "The teeth are undercut: their involute begins at a diameter of"
                f" {max(self.form_diameters_mm):.4f} mm."
            )
        if not max(self.form_diameters_mm) <= self.reference_diameter_mm <= self.tip_diameter_mm:
            notes.append(
                "The reference circle lies outside of the involute; the thickness on it is a"
                " computed figure."
            )
        return [note for note in (*notes, *self._notes_on_balls()) if note is not None]

    @property
    def tapered(self) -> bool:
        """Whether the measurement over balls changes along the axis by more than 1e-6 mm/mm."""
        return abs(self.over_balls_slope or 0.0) > 1e-6

    def _notes_on_balls(self) -> list[str]:
        notes, value = [], self.over_balls.value_mm
        if value is not None and value <= self.tip_diameter_mm:
            notes.append(
                f"Balls of {self.over_balls.ball_diameter_mm:g} mm do not stand above the tip"
                " circle; a micrometer needs larger ones."
            )
        if self.tapered:
            notes.append(
                f"Hold the centres of the balls at z = {self.section_mm:g} mm: where teeth taper,"
                " the measure changes along the axis."
            )
        return notes

    def to_json(self) -> dict[str, Any]:
        """Return the record of one gear in an object of schema `vttig.measure/1`."""
        circles = {"tooth_thickness": self.thickness, "tip_thickness": self.tip_thickness}
        thickness = {
            f"{name}_{place}mm": value
            for name, arc in circles.items()
            for place, value in (("thin_", arc.thin), ("", arc.section), ("thick_", arc.thick))
        }
        return {
            "teeth": self.teeth,
            **thickness,
            "tip_diameter_mm": self.tip_diameter_mm,
            "root_diameter_mm": self.root_diameter_mm,
            "reference_diameter_mm": self.reference_diameter_mm,
            "base_diameter_mm": _sides(self.base_diameters_mm),
            "form_diameter_mm": _sides(self.form_diameters_mm),
            "base_helix_deg": _sides(self.base_helix_deg),
            "chordal_thickness_mm": self.chordal_thickness_mm,
            "chordal_height_mm": self.chordal_height_mm,
            "span_mm": _span_json(self.span),
            "over_balls_mm": {
                **_balls_json(self.over_balls),
                "per_axial_mm": self.over_balls_slope,
            },
            "thickness_at": [
                {
                    "radius_mm": arc.radius_mm,
                    "thin_mm": arc.thin,
                    "section_mm": arc.section,
                    "thick_mm": arc.thick,
                }
                for arc in self.thickness_at
            ],
            "notes": self.notes,
        }


def measure_gear(
    tooth: Tooth,
    *,
    section_mm: float = 0.0,
    radii_mm: tuple[float, ...] = (),
    span_teeth: int | None = None,
    ball_mm: float | None = None,
) -> GearMeasures:
    """Measure a gear in one section; `check_measurable` refuses gears that have no measures.

    **Arguments**
    - `tooth`: gear; `tooth_of` takes it from a pair.
    - `section_mm`: height of the section along the axis from the middle of the face.
    - `radii_mm`: further radii at which the thickness is measured.
    - `span_teeth`: number of teeth to span; by default the one suitable in the middle of the face.
    - `ball_mm`: diameter of the balls; by default the one suitable in the section.

    **Raises** `ValueError` for a section beyond the face.

    **Example**
    ```python
    >>> from vttig_jax import Gear, GearPair
    >>> from vttig_jax.geometry import measure_gear, tooth_of
    >>> gears = Gear(45, 3.0, 3.0, 20.0), Gear(80, 3.0, 3.0, 20.0)
    >>> pair = GearPair(*gears, module_mm=2.0, pressure_angles_deg=20.0)
    >>> gear = measure_gear(tooth_of(pair, "driving"))
    >>> print(f"{gear.thickness.thin:.4f} … {gear.thickness.thick:.4f} mm")
    2.0934 … 4.1897 mm
    >>> print(f"{gear.over_balls.value_mm:.4f} mm over {gear.over_balls.ball_diameter_mm} mm")
    94.9666 mm over 3.5 mm

    ```
    """
    _check_section(tooth, section_mm)
    height = np.array([section_mm])
    radius = np.array([float(tooth.reference_radius)])
    helix = base_helix_angles(tooth, height)[0] / DEG
    diameter = usual_ball(tooth, section_mm) if ball_mm is None else ball_mm
    ball = over_balls(tooth, diameter, section_mm)
    return GearMeasures(
        teeth=tooth.teeth,
        section_mm=section_mm,
        reference_diameter_mm=2 * float(tooth.reference_radius),
        tip_diameter_mm=2 * float(tooth.tip_radius),
        root_diameter_mm=2 * float(tooth.root_radius),
        base_diameters_mm=_pair(2 * tooth.base_radii),
        form_diameters_mm=_pair([2 * form_radius(tooth, side) for side in SIDES]),
        undercut=any(undercut_depth(tooth, side) > 0 for side in SIDES),
        base_helix_deg=_pair(helix),
        thickness=_face_thickness(tooth, float(radius[0]), section_mm),
        tip_thickness=_face_thickness(tooth, float(tooth.tip_radius), section_mm),
        thickness_at=tuple(_involute_thickness(tooth, r, section_mm) for r in radii_mm),
        chordal_thickness_mm=float(chordal_thickness(tooth, radius, height)[0]),
        chordal_height_mm=float(chordal_height(tooth, radius, height)[0]),
        span=span(tooth, section_mm, span_teeth or span(tooth).teeth),
        over_balls=ball,
        over_balls_slope=_slope(tooth, ball, section_mm),
    )


def measure_pair(pair: GearPair) -> dict[str, Any]:
    """Return the measures of both gears in mesh at their centre distance; its keys have units.

    Pressure angle and contact ratio are those of flanks A and B, the pitch diameters 2 r_w those
    of the working pitch circles; the backlash is that of the drawn teeth, without eccentricity, as
    an angle of the driven gear and at its reference circle.

    **Example**
    ```python
    >>> from vttig_jax import Gear, GearPair
    >>> from vttig_jax.geometry import measure_pair
    >>> gears = Gear(45, tooth_thinning_mm=0.05), Gear(80, tooth_thinning_mm=0.05)
    >>> found = measure_pair(GearPair(*gears, module_mm=2.0, pressure_angles_deg=20.0))
    >>> round(found["backlash_mm"], 6), found["pitch_diameter_mm"]["driving"]
    (0.1, 90.0)

    ```
    """
    diameters = 2 * pair.working_radii
    return {
        "centre_distance_mm": float(pair.centre_distance_mm),
        "working_pressure_angle_deg": _named("AB", pair.working_pressure_angles / DEG),
        "pitch_diameter_mm": _named(("driving", "driven"), diameters),
        "contact_ratio": _named("AB", pair.contact_ratios),
        "backlash_deg": float(pair.drawing_backlash) / DEG,
        "backlash_mm": float(pair.drawing_backlash * pair.reference_radii[1]),
    }


def _named(names: Iterable[str], values: Any) -> dict[str, float]:
    return dict(zip(names, map(float, values), strict=True))


def _check_section(tooth: Tooth, section: float) -> None:
    half = float(tooth.face_width_mm) / 2
    if abs(section) > half:
        raise ValueError(
            f"Argument `section_mm` must lie within the face, ±{half:g} mm, but is {section:g}."
        )


def _pair(values: Any) -> tuple[float, float]:
    left, right = values
    return float(left), float(right)


def _face_thickness(tooth: Tooth, radius: float, section: float) -> FaceThickness:
    width = float(tooth.face_width_mm)
    heights = np.array([section] if np.isnan(width) else [section, -width / 2, width / 2])
    middle, *ends = map(float, tooth.thickness(np.full_like(heights, radius), heights))
    return FaceThickness(radius, min(ends, default=None), middle, max(ends, default=None))


def _involute_thickness(tooth: Tooth, radius: float, section: float) -> FaceThickness:
    """Return the thickness at a radius, mm, or the reason if the tooth has no involute there."""
    low, high = max(form_radius(tooth, side) for side in SIDES), float(tooth.tip_radius)
    if low <= radius <= high:
        return _face_thickness(tooth, radius, section)
    reason = (
        f"There is no involute at a radius of {radius:g} mm: it reaches from {low:.4f} to"
        f" {high:.4f} mm."
    )
    return FaceThickness(radius, reason=reason)


def _slope(tooth: Tooth, ball: OverBalls, section: float) -> float | None:
    """Return the change dM/dz of the measurement over balls, mm/mm; None without a measurement.

    It follows from the derivative of Σ inv α(r_M) = … − (δ_L + δ_R)/R at the points of contact.
    """
    if ball.centre_diameter_mm is None or ball.contact_z_mm is None:
        return None
    heights = np.array(ball.contact_z_mm)
    slopes = recession_slopes(tooth, heights)
    thinning = float(slopes[0, 0] + slopes[1, 1]) / float(tooth.reference_radius)
    centre = ball.centre_diameter_mm / 2
    # d(inv α)/dr = tan α / r for either flank
    tangents = np.sqrt((centre / tooth.base_radii) ** 2 - 1)
    odd_factor = np.cos(np.pi / 2 / tooth.teeth) if tooth.teeth % 2 else 1.0
    return float(-2 * odd_factor * thinning * centre / tangents.sum())


def _sides(values: tuple[float, float]) -> dict[str, float]:
    return dict(zip(SIDES, values, strict=True))


def _span_json(measure: Span) -> dict[str, Any]:
    return {
        "teeth": measure.teeth,
        "value": measure.value_mm,
        "transverse": measure.transverse_mm,
        "contact_diameter_mm": measure.contact_diameter_mm,
        "measurable": measure.measurable,
        "reason": measure.reason,
    }


def _balls_json(measure: OverBalls) -> dict[str, Any]:
    contacts, heights = measure.contact_diameters_mm, measure.contact_z_mm
    return {
        "ball_diameter_mm": measure.ball_diameter_mm,
        "value": measure.value_mm,
        "centre_diameter_mm": measure.centre_diameter_mm,
        "contact_diameter_mm": None if contacts is None else _sides(contacts),
        "contact_z_mm": None if heights is None else _sides(heights),
        "reason": measure.reason,
    }
