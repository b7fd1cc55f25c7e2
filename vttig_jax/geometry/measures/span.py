"""Span over several teeth: what a plate micrometer reads, where there is anything to hold it to."""

import math
from dataclasses import dataclass

import numpy as np

from ...base.units import DEG
from ..tooth.form_circle import form_radius
from ..tooth.tooth import Tooth
from .thickness import base_half_angles, base_helix_angles

_SAME = 1e-9
"""Tangents of angles closer than this are the same."""


@dataclass(frozen=True)
class Span:
    """Base tangent length over several teeth.

    **Arguments**
    - `teeth`: number of teeth spanned, k; None where no number serves.
    - `value_mm`: distance along the common normal of the two outermost flanks where they have one
      (W cos β_b of helical gears), else that in the transverse plane; None with a `reason`.
    - `transverse_mm`: the distance W in the transverse plane.
    - `contact_diameter_mm`: where the jaws touch when held evenly.
    - `measurable`: whether a micrometer can take `value_mm`.
    - `reason`: a sentence on why there is no value, or why no micrometer can take it.
    """

    teeth: int | None
    value_mm: float | None = None
    transverse_mm: float | None = None
    contact_diameter_mm: float | None = None
    measurable: bool = False
    reason: str | None = None


def span(tooth: Tooth, z: float = 0.0, teeth: int | None = None) -> Span:
    """Span over k teeth in the section at height z, mm.

        W = (k − 1) p_bt + s_bt = r_b [(k − 1) 2π/z + ψ_bL + ψ_bR]

    with the half angles ψ_b of the tooth at its base circle. The outermost flanks have a common
    normal where their base helices have the same hand and angle, β_bL = −β_bR in the signs of this
    package; there the micrometer reads W cos β_b. On a tapered tooth the hands are opposite, and W
    is a computed figure only. Flanks with different base circles have no W at all: between
    parallel jaws its two normals stand side by side, and the distance depends on how the gear is
    turned.

    **Arguments**
    - `tooth`: the gear; `z`: height of the section, mm.
    - `teeth`: k; by default so that the jaws touch nearest to the V-circle R + x m.

    **Example**
    ```python
    >>> from vttig_jax import Gear, GearPair
    >>> from vttig_jax.geometry import span
    >>> from vttig_jax.geometry import tooth_of
    >>> gears = Gear(30, face_width_mm=10.0), Gear(60, face_width_mm=10.0)
    >>> pair = GearPair(*gears, module_mm=1.0, pressure_angles_deg=20.0)
    >>> found = span(tooth_of(pair, "driving"))
    >>> found.teeth, f"{found.value_mm:.4f}", found.measurable
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
    chosen = _teeth_spanned(tooth, z, normal) if teeth is None else teeth
    transverse = _transverse(tooth, z, chosen)
    value = transverse * math.cos(normal or 0.0)
    # Held evenly: half the distance lies before the point of tangency to the base cylinder.
    roll = value * math.cos(normal or 0.0) / 2
    contact = math.hypot(left, roll)
    if refusal := _off_the_flank(tooth, chosen, contact):
        return Span(None if teeth is None else teeth, reason=refusal)
    why = _unmeasurable(tooth, z, normal, value)
    return Span(chosen, value, transverse, 2 * contact, why is None, why)


def _base_helices(tooth: Tooth, z: float) -> tuple[float, float]:
    left, right = base_helix_angles(tooth, np.array([z]))[0]
    return float(left), float(right)


def _common_normal(tooth: Tooth, z: float) -> float | None:
    """Base helix angle of the common normal, or None where the outermost flanks have none.

    A curved flank has one only where it runs along the axis.
    """
    left, right = _base_helices(tooth, z)
    if abs(left + right) > _SAME:
        return None
    if abs(left) > _SAME and _curved(tooth, z):
        return None
    return abs(left)


def _curved(tooth: Tooth, z: float) -> bool:
    """Whether a helix angle changes within a module of a section."""
    reach = float(tooth.module_mm)
    angles = base_helix_angles(tooth, z + reach * np.array([-1.0, 0.0, 1.0]))
    return bool((np.ptp(angles, axis=0) > _SAME).any())


def _transverse(tooth: Tooth, z: float, teeth: int) -> float:
    tooth_angle = float(base_half_angles(tooth, np.array([z])).sum())
    pitches = (teeth - 1) * 2 * math.pi / tooth.teeth
    return float(tooth.base_radii[0]) * (pitches + tooth_angle)


def _teeth_spanned(tooth: Tooth, z: float, normal: float | None) -> int:
    """The k whose jaws touch nearest to the V-circle, among those that touch flanks at all."""
    base = float(tooth.base_radii[0])
    circle = float(tooth.reference_radius + tooth.profile_shift_mm)
    wanted = 2 * math.sqrt(max(circle**2 - base**2, 0.0)) / math.cos(normal or 0.0) ** 2
    pitch = 2 * math.pi * base / tooth.teeth
    real = 1 + (wanted - _transverse(tooth, z, 1)) / pitch
    near = sorted(range(math.floor(real) - 1, math.ceil(real) + 2), key=lambda k: abs(k - real))
    possible = [k for k in near if 2 <= k < tooth.teeth]
    for k in possible:
        roll = _transverse(tooth, z, k) * math.cos(normal or 0.0) ** 2 / 2
        if _off_the_flank(tooth, k, math.hypot(base, roll)) is None:
            return k
    return possible[0] if possible else 2


def _off_the_flank(tooth: Tooth, teeth: int, contact: float) -> str | None:
    """A sentence where the jaws miss the flanks they should touch."""
    form = form_radius(tooth, "left")  # both are alike where the base circles are
    tip = float(tooth.tip_radius)
    over = f"Over {teeth} teeth the jaws would touch at a diameter of {2 * contact:.4f} mm,"
    if contact > tip:
        return f"{over} above the tip circle of {2 * tip:.4f} mm; span fewer teeth."
    if contact < form:
        return f"{over} below the form circle of {2 * form:.4f} mm; span more teeth."
    return None


def _unmeasurable(tooth: Tooth, z: float, normal: float | None, value: float) -> str | None:
    """Why no micrometer can take the span, or None."""
    if normal is None:
        left, right = (angle / DEG for angle in _base_helices(tooth, z))
        if left * right > 0:
            first, second = ("left", "right") if left > 0 else ("right", "left")
            seen = (
                f"the base helices of its outermost flanks have opposite hands"
                f" ({abs(left):.4f}° {first}-handed, {abs(right):.4f}° {second}-handed)"
            )
        elif abs(left + right) * DEG > _SAME:
            seen = f"its flanks have base helix angles of {abs(left):.4f}° and {abs(right):.4f}°"
        else:
            seen = "its helical flanks are crowned"
        return (
            f"The span is a computed figure of the transverse plane: {seen}, so no line is square"
            " to both and no micrometer can take it; measure over balls."
        )
    apart, width = value * math.sin(normal), float(tooth.face_width_mm)
    if apart > width:
        return (
            f"No micrometer can take the span: along the common normal its jaws stand"
            f" {apart:.2f} mm apart on the axis, more than the face of {width:g} mm; measure over"
            " balls."
        )
    return None
