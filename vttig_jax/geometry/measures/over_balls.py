"""Measurement over two balls in opposite spaces with their centres in one section."""

import math
from dataclasses import dataclass

import numpy as np

from ..tooth.form_circle import form_radius
from ..tooth.rack_cutter import SIDES
from ..tooth.recession import Taper
from ..tooth.tooth import Tooth
from .thickness import base_half_angles, base_helix_angles, radius_where

SIZES_MM = (
    *(0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 1.0, 1.2, 1.5),
    *(half / 2 for half in range(4, 28)),
    *(float(whole) for whole in (*range(14, 27), 28, 30, 32, 34, 35, 36, 38)),
    *(float(whole) for whole in range(40, 105, 5)),
)
"""Diameters in which metric steel balls are sold, mm."""

_LARGEST_ANGLE = 1.4
"""Largest pressure angle at the centre of a ball, rad (chosen); a ball needs less than this."""


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
    space = 2 * math.pi / tooth.teeth - float(base_half_angles(tooth, np.array([z])).sum())
    centre = radius_where(tooth.base_radii, -space + sum(angle for angle, _ in seats))
    if centre is None:
        reason = f"A ball of {ball_mm:g} mm lies below the base circle; take a larger one."
        return OverBalls(ball_mm, reason=reason)
    rolls = [
        math.sqrt(max(centre**2 - base**2, 0.0)) - math.sqrt(ball_mm**2 / 4 - offset**2)
        for base, (_, offset) in zip(tooth.base_radii, seats, strict=True)
    ]
    left, right = (
        math.hypot(base, roll) for base, roll in zip(tooth.base_radii, rolls, strict=True)
    )
    heights = z + seats[0][1], z + seats[1][1]
    if reason := _seat_error(
        tooth,
        ball_mm=ball_mm,
        centre=centre,
        roll=min(rolls),
        contacts=(left, right),
        heights=heights,
    ):
        return OverBalls(ball_mm, reason=reason)
    distance = 2 * centre * (math.cos(math.pi / 2 / tooth.teeth) if tooth.teeth % 2 else 1.0)
    return OverBalls(
        ball_mm, distance + ball_mm, 2 * centre, (2 * left, 2 * right), contact_z_mm=heights
    )


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
    from scipy.optimize import root_scalar

    height = np.array([z])
    circle = float(tooth.reference_radius + tooth.profile_shift_mm)
    spaces = math.pi / tooth.teeth - base_half_angles(tooth, height)[0]
    diameters = []
    for base, space, helix in zip(
        tooth.base_radii, spaces, base_helix_angles(tooth, height)[0], strict=True
    ):
        roll = math.sqrt(max((circle / base) ** 2 - 1, 0.0))
        target, square = space + roll / math.cos(helix) ** 2, math.tan(helix) ** 2
        solution = root_scalar(
            lambda angle, target=min(target, _LARGEST_ANGLE), square=square: (
                angle + square * math.tan(angle) - target
            ),
            bracket=(0.0, 1.57),
            xtol=1e-14,
        )
        diameters.append(2 * base * (math.tan(solution.root) - roll) / math.cos(helix))
    return float(np.mean(diameters))


def _stand_off(tooth: Tooth, side: int, half: float, z: float) -> tuple[float, float]:
    """Return the angle E, rad, between a flank and a ball centre, and the contact height ζ, mm.

    `half` is the radius of the ball, mm; `side` is 0 for the left flank and 1 for the right one.
    """
    base, radius = float(tooth.base_radii[side]), float(tooth.reference_radius)
    flank = tooth.recession[side]
    if isinstance(flank, Taper) and not flank.crowning_mm:
        helix = math.atan(base / radius * float(flank.slope))
        return half / (base * math.cos(helix)), -half * math.sin(helix)
    return _searched_stand_off(tooth, side, half, z)


def _searched_stand_off(tooth: Tooth, side: int, half: float, z: float) -> tuple[float, float]:
    """Return E, rad, and ζ, mm, as `_stand_off` does, for any recession.

    The maximum over 361 latitudes of the ball, ζ = `half` · sin(latitude), is refined.
    """
    from scipy.optimize import minimize_scalar

    base, radius = float(tooth.base_radii[side]), float(tooth.reference_radius)
    flank = tooth.recession[side]
    central = np.asarray(flank(np.array([z]))).item()

    def stand_off(latitude: float | np.ndarray) -> np.ndarray:
        heights = np.atleast_1d(half * np.sin(latitude))
        recession = flank(z + heights) - central
        return half * np.cos(latitude) / base - recession / radius

    latitudes = np.linspace(-math.pi / 2, math.pi / 2, 361)
    best = int(np.argmax(stand_off(latitudes)))
    low, high = latitudes[max(best - 1, 0)], latitudes[min(best + 1, len(latitudes) - 1)]
    solution = minimize_scalar(
        lambda latitude: -float(stand_off(latitude)[0]),
        bounds=(low, high),
        method="bounded",
        options={"xatol": 1e-10},
    )
    return -float(solution.fun), half * math.sin(float(solution.x))


def _seat_error(
    tooth: Tooth,
    ball_mm: float,
    centre: float,
    roll: float,
    contacts: tuple[float, float],
    heights: tuple[float, float],
) -> str | None:
    """Return None if the ball touches both flanks inside the face and nothing else.

    Otherwise return a sentence. `centre` is r_M, `contacts` and `heights` are the contact radii and
    z on both flanks, and `roll` is the smaller roll length of the contacts, all in mm.
    """
    ball = f"A ball of {ball_mm:g} mm"
    tip, root = float(tooth.tip_radius), float(tooth.root_radius)
    if max(contacts) > tip:
        return (
            f"{ball} would touch at a diameter of {2 * max(contacts):.4f} mm, above the tip circle"
            f" of {2 * tip:.4f} mm; take a smaller one."
        )
    for contact, side in zip(contacts, SIDES, strict=True):
        form = form_radius(tooth, side)
        if roll < 0 or contact < form:
            return (
                f"{ball} would touch below the form circle of {2 * form:.4f} mm; take a larger one."
            )
    if centre - ball_mm / 2 < root:
        return f"{ball} would rest on the root circle of {2 * root:.4f} mm; take a larger one."
    half = float(tooth.face_width_mm) / 2
    if max(abs(height) for height in heights) > half:  # false for an unknown face width (NaN)
        return f"{ball} would touch beyond the end of the face; measure closer to its middle."
    return None
