"""Measurement over balls: two balls in opposite spaces, their centres held in one section."""

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
"""Diameters in which steel balls are sold by the millimetre."""


_WIDEST = 1.4
"""Pressure angle at the centre of a ball, rad; no ball fills a space that would ask for more."""


@dataclass(frozen=True)
class OverBalls:
    """What stands between the outer sides of two balls in opposite spaces.

    **Arguments**
    - `ball_diameter_mm`: D.
    - `value_mm`: 2 r_M + D, with an odd number of teeth 2 r_M cos(π/2z) + D; None with a `reason`.
    - `centre_diameter_mm`: 2 r_M, on which the centres of the balls lie.
    - `contact_diameters_mm`, `contact_z_mm`: where a ball touches the left and the right flank
      that bound its space.
    - `reason`: a sentence on why there is no value.
    """

    ball_diameter_mm: float
    value_mm: float | None = None
    centre_diameter_mm: float | None = None
    contact_diameters_mm: tuple[float, float] | None = None
    contact_z_mm: tuple[float, float] | None = None
    reason: str | None = None


def over_balls(tooth: Tooth, ball_mm: float, z: float = 0.0) -> OverBalls:
    """Measurement over two balls whose centres are held at height z, mm.

    Cut at height z + ζ, the ball is a circle of radius √(D²/4 − ζ²), which touches an involute
    where its centre lies on the involute turned on by that radius over r_b. Over all ζ the ball so
    stands off by the angle

        E = max over ζ of [√(D²/4 − ζ²)/r_b − (δ(z + ζ) − δ(z))/R]

    from the flank, which is D/(2 r_b cos β_b) where the recession δ is linear. The centre lies at
    the radius r_M that closes the space between two teeth:

        inv α_L(r_M) + inv α_R(r_M) = ψ_bL(z) + ψ_bR(z) + E_L + E_R − 2π/z,   cos α(r) = r_b/r

    For equal flanks that is inv α_M = s_t(z)/d + inv αₜ + D/(d_b cos β_b) − π/z.

    **Example**
    ```python
    >>> from vttig_jax import Gear, GearPair
    >>> from vttig_jax.geometry import over_balls
    >>> from vttig_jax.geometry import tooth_of
    >>> gears = Gear(20, face_width_mm=10.0), Gear(60, face_width_mm=10.0)
    >>> pair = GearPair(*gears, module_mm=1.0, pressure_angles_deg=20.0)
    >>> print(f"{over_balls(tooth_of(pair, 'driving'), 1.7).value_mm:.4f} mm")
    22.2941 mm

    ```
    """
    if tooth.teeth < 2:
        return OverBalls(ball_mm, reason="One tooth has no opposite space to measure over.")
    stands = [_stand_off(tooth, side, ball_mm / 2, z) for side in (0, 1)]
    closing = float(base_half_angles(tooth, np.array([z])).sum()) - 2 * math.pi / tooth.teeth
    centre = radius_where(tooth.base_radii, closing + sum(angle for angle, _ in stands))
    if centre is None:
        refusal = f"A ball of {ball_mm:g} mm lies below the base circle; take a larger one."
        return OverBalls(ball_mm, reason=refusal)
    rolls = [
        math.sqrt(max(centre**2 - base**2, 0.0)) - math.sqrt(ball_mm**2 / 4 - offset**2)
        for base, (_, offset) in zip(tooth.base_radii, stands, strict=True)
    ]
    left, right = (
        math.hypot(base, roll) for base, roll in zip(tooth.base_radii, rolls, strict=True)
    )
    heights = z + stands[0][1], z + stands[1][1]
    found = (left, right), heights
    if refusal := _no_seat(tooth, ball_mm, centre, min(rolls), found):
        return OverBalls(ball_mm, reason=refusal)
    across = 2 * centre * (math.cos(math.pi / 2 / tooth.teeth) if tooth.teeth % 2 else 1.0)
    return OverBalls(
        ball_mm, across + ball_mm, 2 * centre, (2 * left, 2 * right), contact_z_mm=heights
    )


def usual_ball(tooth: Tooth, z: float = 0.0) -> float:
    """Diameter of a ball on sale that touches near the V-circle R + x m at height z, mm.

    The nearest that seats on both flanks and stands above the tip circle; of a size of its own
    where the balls on sale are far from it.
    """
    ideal = _ideal_ball(tooth, z)
    if not SIZES_MM[0] / 1.2 < ideal < SIZES_MM[-1] * 1.05:
        digits = 1 - math.floor(math.log10(ideal))
        return round(ideal, digits)
    near = sorted(SIZES_MM, key=lambda size: abs(size - ideal))[:4]
    seated = [(size, over_balls(tooth, size, z).value_mm) for size in near]
    tip = 2 * float(tooth.tip_radius)
    proud = [size for size, value in seated if value is not None and value > tip]
    return [*proud, *(size for size, value in seated if value is not None), near[0]][0]


def _ideal_ball(tooth: Tooth, z: float) -> float:
    """Mean of the balls that touch either flank at the V-circle, each in a space of two of them.

    With ρ the roll length of the V-circle, inv α_M = ψ_b + D/(2 r_b cos β_b) − π/z and
    r_b tan α_M = ρ + (D/2) cos β_b give α_M, by itself where β_b = 0.
    """
    from scipy.optimize import root_scalar

    height = np.array([z])
    circle = float(tooth.reference_radius + tooth.profile_shift_mm)
    spaces = math.pi / tooth.teeth - base_half_angles(tooth, height)[0]
    diameters = []
    for base, space, helix in zip(
        tooth.base_radii, spaces, base_helix_angles(tooth, height)[0], strict=True
    ):
        rolled = math.sqrt(max((circle / base) ** 2 - 1, 0.0))
        target, square = space + rolled / math.cos(helix) ** 2, math.tan(helix) ** 2
        found = root_scalar(
            lambda angle, target=min(target, _WIDEST), square=square: (
                angle + square * math.tan(angle) - target
            ),
            bracket=(0.0, 1.57),
            xtol=1e-14,
        )
        diameters.append(2 * base * (math.tan(found.root) - rolled) / math.cos(helix))
    return float(np.mean(diameters))


def _stand_off(tooth: Tooth, side: int, half: float, z: float) -> tuple[float, float]:
    """Angle by which the centre of a ball stands off a flank, and the height of the contact over z.

    `half` is the radius of the ball, `side` 0 for the left flank and 1 for the right one.
    """
    base, radius = float(tooth.base_radii[side]), float(tooth.reference_radius)
    flank = tooth.recession[side]
    if isinstance(flank, Taper) and not flank.crowning_mm:
        helix = math.atan(base / radius * float(flank.slope))
        return half / (base * math.cos(helix)), -half * math.sin(helix)
    return _farthest(tooth, side, half, z)


def _farthest(tooth: Tooth, side: int, half: float, z: float) -> tuple[float, float]:
    """The same for any recession: the largest of a sampled arc, made exact around it."""
    from scipy.optimize import minimize_scalar

    base, radius = float(tooth.base_radii[side]), float(tooth.reference_radius)
    flank = tooth.recession[side]
    here = np.asarray(flank(np.array([z]))).item()

    def stand_off(turn: float | np.ndarray) -> np.ndarray:
        heights = np.atleast_1d(half * np.sin(turn))
        receded = flank(z + heights) - here
        return half * np.cos(turn) / base - receded / radius

    turns = np.linspace(-math.pi / 2, math.pi / 2, 361)
    best = int(np.argmax(stand_off(turns)))
    low, high = turns[max(best - 1, 0)], turns[min(best + 1, len(turns) - 1)]
    found = minimize_scalar(
        lambda turn: -float(stand_off(turn)[0]),
        bounds=(low, high),
        method="bounded",
        options={"xatol": 1e-10},
    )
    return -float(found.fun), half * math.sin(float(found.x))


def _no_seat(
    tooth: Tooth,
    ball_mm: float,
    centre: float,
    roll: float,
    found: tuple[tuple[float, float], tuple[float, float]],
) -> str | None:
    """A sentence where the ball does not touch both flanks, and nothing else, inside the face."""
    contacts, heights = found
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
    if max(abs(height) for height in heights) > half:  # never where the face is not known
        return f"{ball} would touch beyond the end of the face; measure nearer to its middle."
    return None
