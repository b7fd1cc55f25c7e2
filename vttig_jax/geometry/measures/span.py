"""Span over several teeth, as a plate micrometer measures it."""

import math
from dataclasses import dataclass

import numpy as np

from ...base.units import DEG
from ..tooth.form_circle import form_radius
from ..tooth.tooth import Tooth
from .thickness import base_half_angles, base_helix_angles

_SAME = 1e-9
"""Tolerance for equal base radii (relative) and equal base helix angles (rad); chosen."""


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
    normal = _common_normal(tooth, z)
    k = _teeth_spanned(tooth, z, normal) if teeth is None else teeth
    transverse = _transverse(tooth, z, k)
    value = transverse * math.cos(normal or 0.0)
    # The jaws are symmetric: each is half the distance from the tangent point on the base cylinder.
    roll = value * math.cos(normal or 0.0) / 2
    contact = math.hypot(left, roll)
    if reason := _contact_error(tooth, k, contact):
        return Span(None if teeth is None else teeth, reason=reason)
    reason = _measuring_error(tooth, z, normal, value)
    return Span(
        teeth=k,
        value_mm=value,
        transverse_mm=transverse,
        contact_diameter_mm=2 * contact,
        measurable=reason is None,
        reason=reason,
    )


def _base_helices(tooth: Tooth, z: float) -> tuple[float, float]:
    left, right = base_helix_angles(tooth, np.array([z]))[0]
    return float(left), float(right)


def _common_normal(tooth: Tooth, z: float) -> float | None:
    """Return the base helix angle, rad, of the common normal of the outermost flanks, or None.

    A crowned flank has a common normal only where its helix angle is zero.
    """
    left, right = _base_helices(tooth, z)
    if abs(left + right) > _SAME:
        return None
    if abs(left) > _SAME and _curved(tooth, z):
        return None
    return abs(left)


def _curved(tooth: Tooth, z: float) -> bool:
    """Return whether a helix angle changes within one module of a section."""
    module = float(tooth.module_mm)
    angles = base_helix_angles(tooth, z + module * np.array([-1.0, 0.0, 1.0]))
    return bool((np.ptp(angles, axis=0) > _SAME).any())


def _transverse(tooth: Tooth, z: float, teeth: int) -> float:
    tooth_angle = float(base_half_angles(tooth, np.array([z])).sum())
    pitches = (teeth - 1) * 2 * math.pi / tooth.teeth
    return float(tooth.base_radii[0]) * (pitches + tooth_angle)


def _teeth_spanned(tooth: Tooth, z: float, normal: float | None) -> int:
    """Return the number k of teeth to span, for which the jaws touch closest to the V-circle.

    The jaws touch the flanks for this k. If no such k is near the V-circle, the k closest to it is
    returned, from 2 to N − 1 for N teeth. `z` is the height, mm. `normal` is the base helix angle
    of the common normal, rad; None counts as 0.
    """
    base = float(tooth.base_radii[0])
    circle = float(tooth.reference_radius + tooth.profile_shift_mm)
    target = 2 * math.sqrt(max(circle**2 - base**2, 0.0)) / math.cos(normal or 0.0) ** 2
    pitch = 2 * math.pi * base / tooth.teeth
    ideal = 1 + (target - _transverse(tooth, z, 1)) / pitch
    closest = range(math.floor(ideal) - 1, math.ceil(ideal) + 2)
    possible = [k for k in sorted(closest, key=lambda k: abs(k - ideal)) if 2 <= k < tooth.teeth]
    for k in possible:
        roll = _transverse(tooth, z, k) * math.cos(normal or 0.0) ** 2 / 2
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
        left, right = (angle / DEG for angle in _base_helices(tooth, z))
        if left * right > 0:
            first, second = ("left", "right") if left > 0 else ("right", "left")
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
