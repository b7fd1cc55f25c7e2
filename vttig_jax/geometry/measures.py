"""Workshop measures of one gear: tooth thickness, span and distance over balls."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.optimize import minimize_scalar, root_scalar

from ..base.files.text_tables import key_values, text_table
from ..base.units import DEG
from ..pair.gear_pair import GearPair
from ..pair.schema import StatedTable
from .form import form_radius, radius_where, undercut_depth
from .tooth import SHAFTS, SIDES, Taper, Tooth

SIZES_MM = (
    *(0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 1.0, 1.2, 1.5),
    *(half / 2 for half in range(4, 28)),
    *(float(whole) for whole in (*range(14, 27), 28, 30, 32, 34, 35, 36, 38)),
    *(float(whole) for whole in range(40, 105, 5)),
)
"""Diameters in which metric steel balls are sold, mm."""

_LARGEST_ANGLE = 1.4
"""Largest pressure angle at the centre of a ball, rad (chosen); a ball needs less than this."""

_SAME = 1e-9
"""Tolerance for equal base radii (relative) and equal base helix angles (rad); chosen."""


def recession_slopes(tooth: Tooth, z: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape 2"]:
    """Return the slope dδ/dz of the left and the right flank at height z (mm).

    For a straight flank it is tan β. It is positive if the tooth becomes thinner towards +z. The
    slope is a central difference with a step of a thousandth of the module, which is exact for
    straight and for crowned flanks.
    """
    step = 1e-3 * tooth.module_mm
    return np.asarray(tooth.recessions(z + step) - tooth.recessions(z - step)) / (2 * step)


def base_helix_angles(tooth: Tooth, z: float) -> Float[np.ndarray, "2"]:
    """Return the base helix angles of the left and the right flank at height z (mm), rad.

        tan β_b = (r_b/R) dδ/dz

    They are positive if the tooth becomes thinner towards +z; the left flank is then left-handed
    and the right flank right-handed.
    """
    (slopes,) = recession_slopes(tooth, np.array([z]))
    return np.arctan(slopes * (tooth.base_radii / tooth.reference_radius))


def base_half_angles(tooth: Tooth, z: float) -> Float[np.ndarray, "2"]:
    """Return the half angles of the tooth on the base circles at height z (mm), rad."""
    receded = np.asarray(tooth.recessions(np.asarray(z, float))) / tooth.reference_radius
    return np.asarray(tooth.base_half_angles) - receded


class Flanks(NamedTuple):
    """Values of the left and the right flank."""

    left: float
    right: float


@dataclass(frozen=True)
class Span:
    """Base tangent length over several teeth.

    **Arguments**
    - `teeth`: number k of spanned teeth; None if no number is suitable.
    - `value_mm`: distance along the common normal of the two outermost flanks if they have one
      (W cos β_b of helical gears), else in the transverse plane; None with a `reason`.
    - `transverse_mm`: distance W in the transverse plane.
    - `contact_diameter_mm`: diameter at which symmetrically held jaws touch.
    - `measurable`: whether a micrometer can measure `value_mm`.
    - `reason`: sentence that explains why there is no value or why it cannot be measured.
    """

    teeth: int | None
    value_mm: float | None = None
    transverse_mm: float | None = None
    contact_diameter_mm: float | None = None
    measurable: bool = False
    reason: str | None = None


def span(tooth: Tooth, z: float = 0.0, teeth: int | None = None) -> Span:
    """Return the span over k teeth in the section at height z, mm.

        W = (k − 1) p_bt + s_bt = r_b [(k − 1) 2π/z + ψ_bL + ψ_bR]

    ψ_b are the half angles of the tooth at its base circle. The outermost flanks have a common
    normal if their base helices have the same hand and angle, β_bL = −β_bR in the signs of this
    package; the micrometer then reads W cos β_b. On a tapered tooth the hands are opposite, and W
    is only a computed value. Flanks with different base circles have no W: the normals of the two
    flanks are then parallel but offset, and the distance of the jaws depends on the gear's angle.

    **Arguments**
    - `tooth`: gear.
    - `z`: height of the section, mm.
    - `teeth`: number k; by default the jaws touch as close as possible to the V-circle R + x m.

    **Example**
    ```python
    >>> from vttig_jax import Gear, GearPair
    >>> from vttig_jax.geometry import span, tooth_of
    >>> gears = Gear(30, face_width_mm=10.0), Gear(60, face_width_mm=10.0)
    >>> pair = GearPair(*gears, module_mm=1.0, pressure_angles_deg=20.0)
    >>> result = span(tooth_of(pair, "driving"))
    >>> result.teeth, f"{result.value_mm:.4f}", result.measurable
    (4, '10.7526', True)

    ```
    """
    left, right = (float(radius) for radius in tooth.base_radii)
    if not math.isclose(left, right, rel_tol=_SAME):
        return Span(
            teeth,
            reason=f"The flanks have different base circles ({2 * left:.4f} mm and"
            f" {2 * right:.4f} mm in diameter), so parallel jaws rock on them: there is no span.",
        )
    # Outermost flanks have a common normal if their base helices have the same hand and angle; a
    # crowned flank has one only where its helix angle is zero.
    around = [base_helix_angles(tooth, z + k * float(tooth.module_mm)) for k in (-1, 0, 1)]
    left_helix, right_helix = around[1]
    curved = (np.ptp(around, axis=0) > _SAME).any()
    common = abs(left_helix + right_helix) <= _SAME and not (curved and abs(left_helix) > _SAME)
    normal = abs(left_helix) if common else None
    cosine = math.cos(normal or 0.0)
    k = _teeth_spanned(tooth, z, cosine) if teeth is None else teeth
    transverse = _transverse(tooth, z, k)
    value = transverse * cosine
    # The jaws are symmetric: each is half the distance from the tangent point on the base cylinder.
    contact = math.hypot(left, value * cosine / 2)
    if reason := _contact_error(tooth, k, contact):
        return Span(None if teeth is None else teeth, reason=reason)
    reason = _measuring_error(tooth, z, normal, value)
    return Span(k, value, transverse, 2 * contact, measurable=reason is None, reason=reason)


def _transverse(tooth: Tooth, z: float, teeth: int) -> float:
    tooth_angle = float(base_half_angles(tooth, z).sum())
    pitches = (teeth - 1) * 2 * math.pi / tooth.teeth
    return float(tooth.base_radii[0]) * (pitches + tooth_angle)


def _teeth_spanned(tooth: Tooth, z: float, cosine: float) -> int:
    """Return the number k of teeth to span, for which the jaws touch closest to the V-circle.

    The jaws touch the flanks for this k. If no such k is near the V-circle, the k closest to it is
    returned, from 2 to N − 1 for N teeth. `cosine` is that of the base helix angle of the common
    normal at the height z, mm.
    """
    base = float(tooth.base_radii[0])
    circle = float(tooth.reference_radius + tooth.profile_shift_mm)
    target = 2 * math.sqrt(max(circle**2 - base**2, 0.0)) / cosine**2
    pitch = 2 * math.pi * base / tooth.teeth
    ideal = 1 + (target - _transverse(tooth, z, 1)) / pitch
    closest = range(math.floor(ideal) - 1, math.ceil(ideal) + 2)
    possible = [k for k in sorted(closest, key=lambda k: abs(k - ideal)) if 2 <= k < tooth.teeth]
    for k in possible:
        roll = _transverse(tooth, z, k) * cosine**2 / 2
        if _contact_error(tooth, k, math.hypot(base, roll)) is None:
            return k
    return possible[0] if possible else 2


def _contact_error(tooth: Tooth, teeth: int, contact: float) -> str | None:
    """Return a sentence if jaws at radius `contact`, mm, miss the involutes, else None."""
    form = form_radius(tooth, "left")  # equal base circles have equal form circles
    tip = float(tooth.tip_radius)
    over = f"Over {teeth} teeth the jaws would touch at a diameter of {2 * contact:.4f} mm,"
    if contact > tip:
        return f"{over} above the tip circle of {2 * tip:.4f} mm; span fewer teeth."
    if contact < form:
        return f"{over} below the form circle of {2 * form:.4f} mm; span more teeth."
    return None


def _measuring_error(tooth: Tooth, z: float, normal: float | None, value: float) -> str | None:
    """Return a sentence if no micrometer can measure the span, else None."""
    if normal is None:
        left, right = base_helix_angles(tooth, z) / DEG
        if left * right > 0:
            first, second = SIDES if left > 0 else SIDES[::-1]
            cause = (
                f"the base helices of its outermost flanks have opposite hands"
                f" ({abs(left):.4f}° {first}-handed, {abs(right):.4f}° {second}-handed)"
            )
        elif abs(left + right) * DEG > _SAME:
            cause = f"its flanks have base helix angles of {abs(left):.4f}° and {abs(right):.4f}°"
        else:
            cause = "its helical flanks are crowned"
        return (
            f"The span is a computed figure of the transverse plane: {cause}, so no line is"
            " perpendicular to both and no micrometer can take it; measure over balls."
        )
    offset, width = value * math.sin(normal), float(tooth.face_width_mm)
    if offset > width:
        return (
            f"No micrometer can take the span: along the common normal its jaws stand"
            f" {offset:.2f} mm apart on the axis, more than the face of {width:g} mm; measure over"
            " balls."
        )
    return None


@dataclass(frozen=True)
class OverBalls:
    """Distance over two balls in opposite spaces.

    **Arguments**
    - `ball_diameter_mm`: diameter D of the balls.
    - `value_mm`: 2 r_M + D, or 2 r_M cos(π/2z) + D if z is odd; None with a `reason`.
    - `centre_diameter_mm`: 2 r_M, the diameter of the circle of the ball centres.
    - `contact_diameter_mm`, `contact_z_mm`: diameters and heights at which a ball touches the left
      and the right flank.
    - `reason`: sentence that explains a missing value.
    - `per_axial_mm`: change dM/dz of the value per mm by which the balls are held higher.
    """

    ball_diameter_mm: float
    value_mm: float | None = None
    centre_diameter_mm: float | None = None
    contact_diameter_mm: Flanks | None = None
    contact_z_mm: Flanks | None = None
    reason: str | None = None
    per_axial_mm: float | None = None


def over_balls(tooth: Tooth, ball_mm: float, z: float = 0.0) -> OverBalls:
    """Return the measurement over two balls whose centres are held at height z, mm.

    The section of the ball at height z + ζ is a circle of radius √(D²/4 − ζ²). It touches an
    involute if its centre lies on the same involute rotated by that radius over r_b. The angle
    between the flank and the ball centre is therefore

        E = max over ζ of [√(D²/4 − ζ²)/r_b − (δ(z + ζ) − δ(z))/R],

    which is D/(2 r_b cos β_b) for a linear recession δ. The centre lies at the radius r_M for which
    both angles close the space between two teeth:

        inv α_L(r_M) + inv α_R(r_M) = ψ_bL(z) + ψ_bR(z) + E_L + E_R − 2π/z,   cos α(r) = r_b/r

    For equal flanks this is inv α_M = s_t(z)/d + inv αₜ + D/(d_b cos β_b) − π/z. The change of the
    measurement along the axis follows from the slopes of δ at the points of contact.

    **Example**
    ```python
    >>> from vttig_jax import Gear, GearPair
    >>> from vttig_jax.geometry import over_balls, tooth_of
    >>> gears = Gear(20, face_width_mm=10.0), Gear(60, face_width_mm=10.0)
    >>> pair = GearPair(*gears, module_mm=1.0, pressure_angles_deg=20.0)
    >>> print(f"{over_balls(tooth_of(pair, 'driving'), 1.7).value_mm:.4f} mm")
    22.2941 mm

    ```
    """
    if tooth.teeth < 2:
        reason = "A gear with one tooth has no opposite space to measure over."
        return OverBalls(ball_mm, reason=reason)
    seats = [_stand_off(tooth, side, ball_mm / 2, z) for side in (0, 1)]
    space = 2 * math.pi / tooth.teeth - float(base_half_angles(tooth, z).sum())
    centre = radius_where(tooth.base_radii, -space + sum(angle for angle, _ in seats))
    if centre is None:
        reason = f"A ball of {ball_mm:g} mm lies below the base circle; take a larger one."
        return OverBalls(ball_mm, reason=reason)
    rolls = [
        math.sqrt(max(centre**2 - base**2, 0.0)) - math.sqrt(ball_mm**2 / 4 - offset**2)
        for base, (_, offset) in zip(tooth.base_radii, seats, strict=True)
    ]
    contacts = [math.hypot(*pair) for pair in zip(tooth.base_radii, rolls, strict=True)]
    heights = z + seats[0][1], z + seats[1][1]
    tip, root = float(tooth.tip_radius), float(tooth.root_radius)
    forms = [form_radius(tooth, side) for side in SIDES]
    below = [form for form, at in zip(forms, contacts, strict=True) if min(rolls) < 0 or at < form]
    reason = None
    if max(contacts) > tip:
        reason = (
            f"would touch at a diameter of {2 * max(contacts):.4f} mm, above the tip circle of"
            f" {2 * tip:.4f} mm; take a smaller one"
        )
    elif below:
        reason = f"would touch below the form circle of {2 * below[0]:.4f} mm; take a larger one"
    elif centre - ball_mm / 2 < root:
        reason = f"would rest on the root circle of {2 * root:.4f} mm; take a larger one"
    elif max(map(abs, heights)) > float(tooth.face_width_mm) / 2:  # false for an unknown width
        reason = "would touch beyond the end of the face; measure closer to its middle"
    if reason:
        return OverBalls(ball_mm, reason=f"A ball of {ball_mm:g} mm {reason}.")
    askew = math.cos(math.pi / 2 / tooth.teeth) if tooth.teeth % 2 else 1.0
    slopes = recession_slopes(tooth, np.array(heights))
    thinning = float(slopes[0, 0] + slopes[1, 1]) / float(tooth.reference_radius)
    # d(inv α)/dr = tan α / r for either flank
    tangents = np.sqrt((centre / tooth.base_radii) ** 2 - 1)
    slope = float(-2 * askew * thinning * centre / tangents.sum())
    touching = Flanks(2 * contacts[0], 2 * contacts[1]), Flanks(*heights)
    return OverBalls(ball_mm, 2 * centre * askew + ball_mm, 2 * centre, *touching, None, slope)


def usual_ball(tooth: Tooth, z: float = 0.0) -> float:
    """Return the diameter, mm, of a ball that touches near the V-circle R + x m at height z, mm.

    It is the closest of `SIZES_MM` that touches both flanks and projects beyond the tip circle. If
    the ideal diameter is far outside `SIZES_MM`, it is the ideal one rounded to two digits.
    """
    ideal = _ideal_ball(tooth, z)
    if not SIZES_MM[0] / 1.2 < ideal < SIZES_MM[-1] * 1.05:
        digits = 1 - math.floor(math.log10(ideal))
        return round(ideal, digits)
    closest = sorted(SIZES_MM, key=lambda size: abs(size - ideal))[:4]
    measured = [(size, over_balls(tooth, size, z).value_mm) for size in closest]
    tip = 2 * float(tooth.tip_radius)
    beyond_tip = [size for size, value in measured if value is not None and value > tip]
    return [*beyond_tip, *(size for size, value in measured if value is not None), closest[0]][0]


def _ideal_ball(tooth: Tooth, z: float) -> float:
    """Return the diameter, mm, of a ball that touches the flanks at the V-circle at height z, mm.

    It is the mean of two diameters D, one for the right and one for the left flank. Each is the
    diameter of a ball that touches both sides of a symmetric space, whose two flanks equal that
    flank. With the roll length ρ of the V-circle and N teeth, the two equations

        inv α_M = ψ_b + D/(2 r_b cos β_b) − π/N,  r_b tan α_M = ρ + (D/2) cos β_b

    determine α_M and D. For β_b = 0 the solution has a closed form.
    """
    circle = float(tooth.reference_radius + tooth.profile_shift_mm)
    spaces = math.pi / tooth.teeth - base_half_angles(tooth, z)
    diameters = []
    helices = base_helix_angles(tooth, z)
    for base, space, helix in zip(tooth.base_radii, spaces, helices, strict=True):
        roll = math.sqrt(max((circle / base) ** 2 - 1, 0.0))
        target, square = space + roll / math.cos(helix) ** 2, math.tan(helix) ** 2
        target = min(target, _LARGEST_ANGLE)
        angle = root_scalar(
            lambda angle, target=target, square=square: angle + square * math.tan(angle) - target,
            bracket=(0.0, 1.57),
            xtol=1e-14,
        ).root
        diameters.append(2 * base * (math.tan(angle) - roll) / math.cos(helix))
    return float(np.mean(diameters))


def _stand_off(tooth: Tooth, side: int, half: float, z: float) -> tuple[float, float]:
    """Return the angle E, rad, between a flank and a ball centre, and the contact height ζ, mm.

    `half` is the radius of the ball, mm; `side` is 0 for the left flank and 1 for the right one.
    For a curved recession the best of 361 latitudes of the ball, ζ = `half` · sin(latitude), is
    refined.
    """
    base, radius = float(tooth.base_radii[side]), float(tooth.reference_radius)
    flank = tooth.recession[side]
    if isinstance(flank, Taper) and not flank.crowning_mm:
        helix = math.atan(base / radius * float(flank.slope))
        return half / (base * math.cos(helix)), -half * math.sin(helix)
    central = np.asarray(flank(np.array([z]))).item()

    def stand_off(latitude: float | np.ndarray) -> np.ndarray:
        heights = np.atleast_1d(half * np.sin(latitude))
        recession = flank(z + heights) - central
        return half * np.cos(latitude) / base - recession / radius

    latitudes = np.linspace(-math.pi / 2, math.pi / 2, 361)
    best = int(np.argmax(stand_off(latitudes)))
    solution: Any = minimize_scalar(
        lambda latitude: -float(stand_off(latitude)[0]),
        bounds=(latitudes[max(best - 1, 0)], latitudes[min(best + 1, 360)]),
        method="bounded",
        options={"xatol": 1e-10},
    )
    return -float(solution.fun), half * math.sin(float(solution.x))


@dataclass(frozen=True)
class ThicknessAt:
    """Tooth thickness at one radius, as arcs in mm; None where there is no involute.

    **Arguments**
    - `radius_mm`: radius of the circle.
    - `thin_mm`, `thick_mm`: thickness at the two ends of the face, None without face width.
    - `section_mm`: thickness at the measured section.
    """

    radius_mm: float
    thin_mm: float | None = None
    section_mm: float | None = None
    thick_mm: float | None = None


@dataclass(frozen=True)
class GearMeasures:
    """Workshop measures of one gear in mm and degrees, with the names that they have in JSON.

    **Arguments**
    - `section_mm`: height of the measured section. `undercut`: whether a fillet cuts into a flank.
    - `tooth_thickness_thin_mm` … `tip_thickness_thick_mm`: arcs of the reference and the tip circle
      at the thin end of the face, in the section and at the thick end.
    - `tip_diameter_mm` … `form_diameter_mm`: diameters of the circles; the involute of a flank
      begins at its form circle.
    - `base_helix_deg`: base helix angles at the section, positive where the flank thins the tooth
      towards +z.
    - `chordal_thickness_mm`, `chordal_height_mm`: at the reference circle, in the transverse plane.
    - `span_mm`, `over_balls_mm`: results of `span` and `over_balls`.
    - `thickness_at`: thickness at further radii.
    """

    section_mm: float
    undercut: bool
    teeth: int
    tooth_thickness_thin_mm: float | None
    tooth_thickness_mm: float
    tooth_thickness_thick_mm: float | None
    tip_thickness_thin_mm: float | None
    tip_thickness_mm: float
    tip_thickness_thick_mm: float | None
    tip_diameter_mm: float
    root_diameter_mm: float
    reference_diameter_mm: float
    base_diameter_mm: Flanks
    form_diameter_mm: Flanks
    base_helix_deg: Flanks
    chordal_thickness_mm: float
    chordal_height_mm: float
    span_mm: Span
    over_balls_mm: OverBalls
    thickness_at: tuple[ThicknessAt, ...]

    @property
    def notes(self) -> list[str]:
        """Sentences on measures that are missing or need care."""
        form, balls = max(self.form_diameter_mm), self.over_balls_mm
        notes = [
            f"There is no involute at a radius of {arc.radius_mm:g} mm: it reaches from"
            f" {form / 2:.4f} to {self.tip_diameter_mm / 2:.4f} mm."
            for arc in self.thickness_at
            if arc.section_mm is None
        ]
        notes += [reason for reason in (self.span_mm.reason, balls.reason) if reason]
        if self.tooth_thickness_thin_mm is None:
            notes.append("The drawing gives no face_width_mm, so that its teeth have no ends.")
        if self.undercut:
            notes.append(
                f"The teeth are undercut: their involute begins at a diameter of {form:.4f} mm."
            )
        if not form <= self.reference_diameter_mm <= self.tip_diameter_mm:
            notes.append(
                "The reference circle lies outside of the involute; the thickness on it is a"
                " computed figure."
            )
        if balls.value_mm is not None and balls.value_mm <= self.tip_diameter_mm:
            notes.append(
                f"Balls of {balls.ball_diameter_mm:g} mm do not stand above the tip circle; a"
                " micrometer needs larger ones."
            )
        if self.tapered:
            notes.append(
                f"Hold the centres of the balls at z = {self.section_mm:g} mm: where teeth taper,"
                " the measure changes along the axis."
            )
        return notes

    @property
    def tapered(self) -> bool:
        """Whether the measurement over balls changes along the axis by more than 1e-6 mm/mm."""
        return abs(self.over_balls_mm.per_axial_mm or 0.0) > 1e-6

    def to_json(self) -> dict[str, Any]:
        """Return the record of one gear in an object of schema `vttig.measure/1`."""
        fields = asdict(self, dict_factory=_record) | {"notes": self.notes}
        return {key: fields[key] for key in fields if key not in ("section_mm", "undercut")}


def _record(fields: list[tuple[str, Any]]) -> dict[str, Any]:
    """Return the fields of a measure by their names in JSON, values of both flanks by side."""
    short = {"value_mm": "value", "transverse_mm": "transverse"}
    return {
        short.get(name, name): value._asdict() if isinstance(value, Flanks) else value
        for name, value in fields
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
    >>> print(f"{gear.tooth_thickness_thin_mm:.4f} … {gear.tooth_thickness_thick_mm:.4f} mm")
    2.0934 … 4.1897 mm
    >>> balls = gear.over_balls_mm
    >>> print(f"{balls.value_mm:.4f} mm over {balls.ball_diameter_mm} mm")
    94.9666 mm over 3.5 mm

    ```
    """
    half = float(tooth.face_width_mm) / 2
    if abs(section_mm) > half:
        raise ValueError(
            f"Argument `section_mm` must lie within the face, ±{half:g} mm, but is {section_mm:g}."
        )
    radius, tip = float(tooth.reference_radius), float(tooth.tip_radius)
    forms = [form_radius(tooth, side) for side in SIDES]
    diameter = usual_ball(tooth, section_mm) if ball_mm is None else ball_mm
    mean = float(tooth.half_angles(np.array([radius]), np.array([section_mm])).sum() / 2)
    low = max(forms)
    return GearMeasures(
        section_mm,
        any(undercut_depth(tooth, side) > 0 for side in SIDES),
        tooth.teeth,
        *_thickness(tooth, radius, section_mm),
        *_thickness(tooth, tip, section_mm),
        tip_diameter_mm=2 * tip,
        root_diameter_mm=2 * float(tooth.root_radius),
        reference_diameter_mm=2 * radius,
        base_diameter_mm=Flanks(*map(float, 2 * tooth.base_radii)),
        form_diameter_mm=Flanks(*(2 * form for form in forms)),
        base_helix_deg=Flanks(*map(float, base_helix_angles(tooth, section_mm) / DEG)),
        chordal_thickness_mm=2 * radius * math.sin(mean),
        chordal_height_mm=tip - radius * math.cos(mean),
        span_mm=span(tooth, section_mm, span_teeth or span(tooth).teeth),
        over_balls_mm=over_balls(tooth, diameter, section_mm),
        thickness_at=tuple(
            ThicknessAt(r, *(_thickness(tooth, r, section_mm) if low <= r <= tip else ()))
            for r in radii_mm
        ),
    )


def _thickness(
    tooth: Tooth, radius: float, section: float
) -> tuple[float | None, float, float | None]:
    """Return the thickness, mm, at the thin end of the face, in a section and at the thick end."""
    width = float(tooth.face_width_mm)
    heights = np.array([section] if np.isnan(width) else [section, -width / 2, width / 2])
    middle, *ends = map(float, tooth.thickness(np.full_like(heights, radius), heights))
    return min(ends, default=None), middle, max(ends, default=None)


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
    return {
        "centre_distance_mm": float(pair.centre_distance_mm),
        "working_pressure_angle_deg": _named("AB", pair.working_pressure_angles / DEG),
        "pitch_diameter_mm": _named(SHAFTS, 2 * pair.working_radii),
        "contact_ratio": _named("AB", pair.contact_ratios),
        "backlash_deg": float(pair.drawing_backlash) / DEG,
        "backlash_mm": float(pair.drawing_backlash * pair.reference_radii[1]),
    }


def _named(names: Iterable[str], values: Any) -> dict[str, float]:
    return dict(zip(names, map(float, values), strict=True))


class Stated(NamedTuple):
    """Stated value and its excess over the computed value (None: not comparable)."""

    value: float
    difference: float | None


def compare_stated(stated: StatedTable, found: GearMeasures) -> tuple[dict[str, Stated], list[str]]:
    """Return the stated values by key, and a sentence for each value that cannot be compared.

    Thickness at the ends needs the face width. Span and measurement over balls are compared only
    in the middle of the face, over the stated number of teeth and the stated ball.

    **Example**
    ```python
    >>> from vttig_jax import Gear, GearPair
    >>> from vttig_jax.geometry import compare_stated, measure_gear, tooth_of
    >>> from vttig_jax.pair import StatedTable
    >>> gears = Gear(45, 3.0, 3.0, 20.0), Gear(80, 3.0, 3.0, 20.0)
    >>> pair = GearPair(*gears, module_mm=2.0, pressure_angles_deg=20.0)
    >>> computed = measure_gear(tooth_of(pair, "driving"))
    >>> stated, notes = compare_stated(StatedTable(tooth_thickness_thick_mm=4.195), computed)
    >>> f"{stated['tooth_thickness_thick_mm'].difference:+.4f}", notes
    ('+0.0053', [])

    ```
    """
    span, balls = found.span_mm, found.over_balls_mm
    computed = {
        "tooth_thickness_thin_mm": found.tooth_thickness_thin_mm,
        "tooth_thickness_thick_mm": found.tooth_thickness_thick_mm,
        "tip_diameter_mm": found.tip_diameter_mm,
        "root_diameter_mm": found.root_diameter_mm,
        "span_mm": span.value_mm,
        "over_balls_mm": balls.value_mm,
    }
    reasons = {}
    if found.section_mm:
        at = f"that of the middle of the face, not of z = {found.section_mm:g} mm."
        reasons["span_mm"] = f"The stated span is {at}"
        reasons["over_balls_mm"] = f"The stated measure over balls is {at}"
    else:
        if stated.span_teeth != span.teeth:
            reasons["span_mm"] = f"The stated span is over {stated.span_teeth} teeth."
        if stated.ball_diameter_mm != balls.ball_diameter_mm:
            reasons["over_balls_mm"] = (
                f"The stated measure over balls is over balls of {stated.ball_diameter_mm} mm."
            )
    comparison = {}
    for name, value in computed.items():
        given = getattr(stated, name)
        if given is not None:
            comparable = value is not None and name not in reasons
            comparison[name] = Stated(given, given - value if comparable else None)
    return comparison, [sentence for name, sentence in reasons.items() if name in comparison]


def measures_text(
    gears: Mapping[str, GearMeasures],
    stated: Mapping[str, Mapping[str, Stated]],
    notes: Mapping[str, Sequence[str]],
    title: str,
    mesh: Mapping[str, Any],
) -> str:
    """Return a table of the measures with one column for each gear, and the notes below it.

    **Arguments**
    - `gears`: measures by the name of the gear.
    - `stated`: stated values by gear and key; if there are any, the table shows them with their
      differences from the computed values.
    - `notes`: sentences by gear; a sentence that applies to all gears is printed once.
    - `title`: first line.
    - `mesh`: result of `measure_pair`.
    """
    with_stated = any(stated.values())
    headers: list[str] = [""]
    for name in gears:
        headers += [name, "stated", "difference"] if with_stated else [name]
    rows = []
    for label, key, cells in _rows(list(gears.values())):
        row = [label]
        for name, value in zip(gears, cells, strict=True):
            row.append(f"{value:.4f}" if isinstance(value, float) else value)
            if with_stated and (given := stated[name].get(key)):
                excess = "–" if given.difference is None else f"{given.difference:+.4f}"
                row += [f"{given.value:g}", excess]
            elif with_stated:
                row += ["", ""]
        rows.append(row)
    table = [f"  {line}" for line in text_table(rows, headers).splitlines()]

    def both(key: str, digits: int) -> str:
        return " / ".join(f"{value:.{digits}f}" for value in mesh[key].values())

    angle, arc = mesh["backlash_deg"], mesh["backlash_mm"]
    together = [
        ("working pressure angle A / B", f"{both('working_pressure_angle_deg', 4)}°"),
        ("pitch diameters", f"{both('pitch_diameter_mm', 4)} mm"),
        ("contact ratio A / B", both("contact_ratio", 3)),
        ("backlash", f"{angle:z.4f}° of the driven gear = {arc:z.4f} mm"),
    ]
    table.append(key_values(together, title=f"in mesh at a = {mesh['centre_distance_mm']:g} mm"))
    lines: dict[str, None] = {}  # a set in order; notes common to all gears carry no name
    for name, sentences in notes.items():
        for sentence in sentences:
            shared = all(sentence in others for others in notes.values())
            lines[f"  {sentence}" if shared else f"  {name}: {sentence}"] = None
    return "\n".join([title, *table, *(["", "notes:", *lines] if lines else [])])


def _rows(gears: list[GearMeasures]) -> list[tuple[str, str, list[Any]]]:
    """Return label, key and the cells of all gears for each row; lengths are in mm."""

    def rows(label: str, key: str) -> list[tuple[str, str, list[Any]]]:
        """Return one row, or one for each flank where the flanks of a gear differ."""
        values = [getattr(gear, key) for gear in gears]
        if not isinstance(values[0], Flanks):
            return [(label, key, values)]
        left, right = ([getattr(flanks, side) for flanks in values] for side in SIDES)
        if left == right:
            return [(label, key, left)]
        return [(f"{label}, left flank", key, left), (f"{label}, right flank", key, right)]

    helices = [gear.base_helix_deg for gear in gears]
    spans, balls = [gear.span_mm for gear in gears], [gear.over_balls_mm for gear in gears]
    span_label = "span" if any(s.measurable for s in spans) else "span, a computed figure"
    slopes = ("over balls, per mm of z", "", [b.per_axial_mm for b in balls])
    places = ("thin end", "thin_mm"), ("section", "section_mm"), ("thick end", "thick_mm")
    return [
        ("teeth", "", [str(gear.teeth) for gear in gears]),
        *rows("reference diameter", "reference_diameter_mm"),
        *rows("tip diameter", "tip_diameter_mm"),
        *rows("root diameter", "root_diameter_mm"),
        *rows("base diameter", "base_diameter_mm"),
        *rows("form diameter", "form_diameter_mm"),
        ("base helix and hand, left flank [°]", "", [_handed(b.left, "LR") for b in helices]),
        ("base helix and hand, right flank [°]", "", [_handed(b.right, "RL") for b in helices]),
        *rows("thickness, thin end", "tooth_thickness_thin_mm"),
        *rows("thickness, section", "tooth_thickness_mm"),
        *rows("thickness, thick end", "tooth_thickness_thick_mm"),
        *rows("tip thickness, thin end", "tip_thickness_thin_mm"),
        *rows("tip thickness, section", "tip_thickness_mm"),
        *(
            (f"thickness at r = {at[0].radius_mm:g}, {label}", "", [getattr(a, key) for a in at])
            for at in zip(*(gear.thickness_at for gear in gears), strict=True)
            for label, key in places
        ),
        *rows("chordal thickness", "chordal_thickness_mm"),
        *rows("height above the chord", "chordal_height_mm"),
        ("teeth spanned", "", [None if s.teeth is None else str(s.teeth) for s in spans]),
        (span_label, "span_mm", [s.value_mm for s in spans]),
        ("ball diameter", "", [f"{b.ball_diameter_mm:g}" for b in balls]),
        ("over balls", "over_balls_mm", [b.value_mm for b in balls]),
        *([slopes] if any(gear.tapered for gear in gears) else []),
    ]


def _handed(degrees: float, hands: str) -> str:
    """Return the absolute angle with L or R, the first of `hands` for a positive angle."""
    if round(degrees, 4) == 0:
        return "0.0000"
    return f"{abs(degrees):.4f} {hands[0] if degrees > 0 else hands[1]}"
