"""Workshop measures of one gear: tooth thickness, span and distance over balls."""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
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


def base_helix_angles(
    tooth: Tooth, z: Float[np.ndarray, "*shape"]
) -> Float[np.ndarray, "*shape 2"]:
    """Return the base helix angles of the left and the right flank at height z, rad.

        tan β_b = (r_b/R) dδ/dz

    They are positive if the tooth becomes thinner towards +z; the left flank is then left-handed
    and the right flank right-handed.
    """
    return np.arctan(recession_slopes(tooth, z) * (tooth.base_radii / tooth.reference_radius))


def base_half_angles(tooth: Tooth, z: float) -> Float[np.ndarray, "2"]:
    """Return the half angles of the tooth on the base circles at height z (mm), rad."""
    receded = np.asarray(tooth.recessions(np.asarray(z, float))) / tooth.reference_radius
    return np.asarray(tooth.base_half_angles) - receded


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
    left_helix, right_helix = _base_helices(tooth, z)
    around = z + float(tooth.module_mm) * np.array([-1.0, 0.0, 1.0])
    curved = (np.ptp(base_helix_angles(tooth, around), axis=0) > _SAME).any()
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


def _base_helices(tooth: Tooth, z: float) -> Float[np.ndarray, "2"]:
    return base_helix_angles(tooth, np.array([z]))[0]


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
        left, right = _base_helices(tooth, z) / DEG
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
    - `contact_diameters_mm`, `contact_z_mm`: diameters and heights at which a ball touches the left
      and the right flank.
    - `reason`: sentence that explains a missing value.
    """

    ball_diameter_mm: float
    value_mm: float | None = None
    centre_diameter_mm: float | None = None
    contact_diameters_mm: tuple[float, float] | None = None
    contact_z_mm: tuple[float, float] | None = None
    reason: str | None = None


def over_balls(tooth: Tooth, ball_mm: float, z: float = 0.0) -> OverBalls:
    """Return the measurement over two balls whose centres are held at height z, mm.

    The section of the ball at height z + ζ is a circle of radius √(D²/4 − ζ²). It touches an
    involute if its centre lies on the same involute rotated by that radius over r_b. The angle
    between the flank and the ball centre is therefore

        E = max over ζ of [√(D²/4 − ζ²)/r_b − (δ(z + ζ) − δ(z))/R],

    which is D/(2 r_b cos β_b) for a linear recession δ. The centre lies at the radius r_M for which
    both angles close the space between two teeth:

        inv α_L(r_M) + inv α_R(r_M) = ψ_bL(z) + ψ_bR(z) + E_L + E_R − 2π/z,   cos α(r) = r_b/r

    For equal flanks this is inv α_M = s_t(z)/d + inv αₜ + D/(d_b cos β_b) − π/z.

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
    distance = 2 * centre * (math.cos(math.pi / 2 / tooth.teeth) if tooth.teeth % 2 else 1.0)
    left, right = contacts
    return OverBalls(ball_mm, distance + ball_mm, 2 * centre, (2 * left, 2 * right), heights)


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
    helices = _base_helices(tooth, z)
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
        form, balls = max(self.form_diameters_mm), self.over_balls
        if self.thickness.thin is None:
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
        return [note for note in notes if note is not None]

    @property
    def tapered(self) -> bool:
        """Whether the measurement over balls changes along the axis by more than 1e-6 mm/mm."""
        return abs(self.over_balls_slope or 0.0) > 1e-6

    def to_json(self) -> dict[str, Any]:
        """Return the record of one gear in an object of schema `vttig.measure/1`."""
        circles = {"tooth_thickness": self.thickness, "tip_thickness": self.tip_thickness}
        places = ("thin_", "thin"), ("", "section"), ("thick_", "thick")
        return {
            "teeth": self.teeth,
            **{
                f"{name}_{prefix}mm": getattr(arc, place)
                for name, arc in circles.items()
                for prefix, place in places
            },
            "tip_diameter_mm": self.tip_diameter_mm,
            "root_diameter_mm": self.root_diameter_mm,
            "reference_diameter_mm": self.reference_diameter_mm,
            "base_diameter_mm": _named(SIDES, self.base_diameters_mm),
            "form_diameter_mm": _named(SIDES, self.form_diameters_mm),
            "base_helix_deg": _named(SIDES, self.base_helix_deg),
            "chordal_thickness_mm": self.chordal_thickness_mm,
            "chordal_height_mm": self.chordal_height_mm,
            "span_mm": _record(self.span),
            "over_balls_mm": _record(self.over_balls) | {"per_axial_mm": self.over_balls_slope},
            "thickness_at": [
                {"radius_mm": arc.radius_mm} | {f"{p}_mm": getattr(arc, p) for _, p in places}
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
    half = float(tooth.face_width_mm) / 2
    if abs(section_mm) > half:
        raise ValueError(
            f"Argument `section_mm` must lie within the face, ±{half:g} mm, but is {section_mm:g}."
        )
    radius, tip = float(tooth.reference_radius), float(tooth.tip_radius)
    forms = [form_radius(tooth, side) for side in SIDES]
    diameter = usual_ball(tooth, section_mm) if ball_mm is None else ball_mm
    ball = over_balls(tooth, diameter, section_mm)
    mean = float(tooth.half_angles(np.array([radius]), np.array([section_mm])).sum() / 2)
    low = max(forms)
    involutes = f"it reaches from {low:.4f} to {tip:.4f} mm."
    return GearMeasures(
        teeth=tooth.teeth,
        section_mm=section_mm,
        reference_diameter_mm=2 * radius,
        tip_diameter_mm=2 * tip,
        root_diameter_mm=2 * float(tooth.root_radius),
        base_diameters_mm=_both(2 * tooth.base_radii),
        form_diameters_mm=_both([2 * form for form in forms]),
        undercut=any(undercut_depth(tooth, side) > 0 for side in SIDES),
        base_helix_deg=_both(_base_helices(tooth, section_mm) / DEG),
        thickness=_face_thickness(tooth, radius, section_mm),
        tip_thickness=_face_thickness(tooth, tip, section_mm),
        thickness_at=tuple(
            _face_thickness(tooth, r, section_mm)
            if low <= r <= tip
            else FaceThickness(
                r, reason=f"There is no involute at a radius of {r:g} mm: {involutes}"
            )
            for r in radii_mm
        ),
        chordal_thickness_mm=2 * radius * math.sin(mean),
        chordal_height_mm=tip - radius * math.cos(mean),
        span=span(tooth, section_mm, span_teeth or span(tooth).teeth),
        over_balls=ball,
        over_balls_slope=_slope(tooth, ball),
    )


def _both(values: Iterable[Any]) -> tuple[float, float]:
    left, right = values
    return float(left), float(right)


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


def _named(names: Iterable[str], values: Any) -> Any:
    """Return values by their names; None for no values."""
    return None if values is None else dict(zip(names, map(float, values), strict=True))


def _record(found: Span | OverBalls) -> dict[str, Any]:
    """Return the fields of a measure by their names in JSON, pairs of flanks by their side."""
    short = {"value_mm": "value", "transverse_mm": "transverse"}
    named = {k: _named(SIDES, v) if isinstance(v, tuple) else v for k, v in vars(found).items()}
    return {short.get(k, k.replace("diameters", "diameter")): v for k, v in named.items()}


def _face_thickness(tooth: Tooth, radius: float, section: float) -> FaceThickness:
    width = float(tooth.face_width_mm)
    heights = np.array([section] if np.isnan(width) else [section, -width / 2, width / 2])
    middle, *ends = map(float, tooth.thickness(np.full_like(heights, radius), heights))
    return FaceThickness(radius, min(ends, default=None), middle, max(ends, default=None))


def _slope(tooth: Tooth, ball: OverBalls) -> float | None:
    """Return the change dM/dz of the measurement over balls, mm/mm; None without a measurement.

    It follows from the derivative of Σ inv α(r_M) = … − (δ_L + δ_R)/R at the points of contact.
    """
    if ball.centre_diameter_mm is None or ball.contact_z_mm is None:
        return None
    slopes = recession_slopes(tooth, np.array(ball.contact_z_mm))
    thinning = float(slopes[0, 0] + slopes[1, 1]) / float(tooth.reference_radius)
    centre = ball.centre_diameter_mm / 2
    # d(inv α)/dr = tan α / r for either flank
    tangents = np.sqrt((centre / tooth.base_radii) ** 2 - 1)
    odd_factor = np.cos(np.pi / 2 / tooth.teeth) if tooth.teeth % 2 else 1.0
    return float(-2 * odd_factor * thinning * centre / tangents.sum())


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
    span, balls = found.span, found.over_balls
    computed = {
        "tooth_thickness_thin_mm": found.thickness.thin,
        "tooth_thickness_thick_mm": found.thickness.thick,
        "tip_diameter_mm": found.tip_diameter_mm,
        "root_diameter_mm": found.root_diameter_mm,
        "span_mm": span.value_mm,
        "over_balls_mm": balls.value_mm,
    }
    reasons = {}
    if found.section_mm:
        at = f"that of the middle of the face, not of z = {found.section_mm:g} mm"
        reasons = {
            "span_mm": f"The stated span is {at}.",
            "over_balls_mm": f"The stated measure over balls is {at}.",
        }
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


_Cell = Callable[[GearMeasures], Any]


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
    for label, key, cell in _rows(list(gears.values())):
        row = [label]
        for name, measures in gears.items():
            value = cell(measures)
            row.append(f"{value:.4f}" if isinstance(value, float) else value)
            if with_stated and (given := stated[name].get(key)):
                excess = "–" if given.difference is None else f"{given.difference:+.4f}"
                row += [f"{given.value:g}", excess]
            elif with_stated:
                row += ["", ""]
        rows.append(row)
    table = [f"  {line}" for line in text_table(rows, headers).splitlines()]
    angles, ratios, diameters = (
        " / ".join(f"{value:.{digits}f}" for value in mesh[key].values())
        for key, digits in (
            ("working_pressure_angle_deg", 4),
            ("contact_ratio", 3),
            ("pitch_diameter_mm", 4),
        )
    )
    backlash = [round(mesh[f"backlash_{unit}"], 4) + 0.0 for unit in ("deg", "mm")]  # no −0
    together = [
        ("working pressure angle A / B", f"{angles}°"),
        ("pitch diameters", f"{diameters} mm"),
        ("contact ratio A / B", ratios),
        ("backlash", "{:.4f}° of the driven gear = {:.4f} mm".format(*backlash)),
    ]
    table.append(key_values(together, title=f"in mesh at a = {mesh['centre_distance_mm']:g} mm"))
    lines: dict[str, None] = {}  # a set in order; notes common to all gears carry no name
    for name, sentences in notes.items():
        for sentence in sentences:
            shared = all(sentence in others for others in notes.values())
            lines[f"  {sentence}" if shared else f"  {name}: {sentence}"] = None
    return "\n".join([title, *table, *(["", "notes:", *lines] if lines else [])])


def _rows(gears: list[GearMeasures]) -> list[tuple[str, str, _Cell]]:
    """Return label, key of the stated value ("" for none) and a function for each row.

    The function takes the measures of a gear and returns the cell; lengths are in mm.
    """
    radii = [thickness.radius_mm for thickness in gears[0].thickness_at]
    tapered = any(measures.tapered for measures in gears)
    ends = ("thin end", "thin"), ("section", "section"), ("thick end", "thick")
    measurable = any(gear.span.measurable for gear in gears)
    return [
        ("teeth", "", lambda g: str(g.teeth)),
        ("reference diameter", "", lambda g: g.reference_diameter_mm),
        ("tip diameter", "tip_diameter_mm", lambda g: g.tip_diameter_mm),
        ("root diameter", "root_diameter_mm", lambda g: g.root_diameter_mm),
        *_by_side(gears, "base diameter", lambda g: g.base_diameters_mm),
        *_by_side(gears, "form diameter", lambda g: g.form_diameters_mm),
        ("base helix and hand, left flank [°]", "", lambda g: _handed(g.base_helix_deg[0], "LR")),
        ("base helix and hand, right flank [°]", "", lambda g: _handed(g.base_helix_deg[1], "RL")),
        ("thickness, thin end", "tooth_thickness_thin_mm", lambda g: g.thickness.thin),
        ("thickness, section", "", lambda g: g.thickness.section),
        ("thickness, thick end", "tooth_thickness_thick_mm", lambda g: g.thickness.thick),
        ("tip thickness, thin end", "", lambda g: g.tip_thickness.thin),
        ("tip thickness, section", "", lambda g: g.tip_thickness.section),
        *(
            (
                f"thickness at r = {radius:g}, {label}",
                "",
                lambda g, k=k, place=place: getattr(g.thickness_at[k], place),
            )
            for k, radius in enumerate(radii)
            for label, place in ends
        ),
        ("chordal thickness", "", lambda g: g.chordal_thickness_mm),
        ("height above the chord", "", lambda g: g.chordal_height_mm),
        ("teeth spanned", "", lambda g: None if g.span.teeth is None else str(g.span.teeth)),
        ("span" if measurable else "span, a computed figure", "span_mm", lambda g: g.span.value_mm),
        ("ball diameter", "", lambda g: f"{g.over_balls.ball_diameter_mm:g}"),
        ("over balls", "over_balls_mm", lambda g: g.over_balls.value_mm),
        *([("over balls, per mm of z", "", lambda g: g.over_balls_slope)] if tapered else []),
    ]


def _by_side(
    gears: list[GearMeasures], label: str, values: Callable[[GearMeasures], tuple[float, float]]
) -> list[tuple[str, str, _Cell]]:
    """Return one row if left and right value agree in all gears, else one row for each flank."""
    if all(values(g)[0] == values(g)[1] for g in gears):
        return [(label, "", lambda g: values(g)[0])]
    return [
        (f"{label}, left flank", "", lambda g: values(g)[0]),
        (f"{label}, right flank", "", lambda g: values(g)[1]),
    ]


def _handed(degrees: float, hands: str) -> str:
    """Return the absolute angle with L or R, the first of `hands` for a positive angle."""
    if round(degrees, 4) == 0:
        return "0.0000"
    return f"{abs(degrees):.4f} {hands[0] if degrees > 0 else hands[1]}"
