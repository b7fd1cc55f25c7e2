"""Geometry no gear pair can have, each with the key that says it."""

import math
from typing import TYPE_CHECKING

from ..base.errors import PairError
from ..base.units import DEG

if TYPE_CHECKING:
    from .spec import PairSpec


def check_geometry(spec: "PairSpec") -> None:
    """Raise `PairError` whose `where` is the dotted key at fault."""
    pair, driving, driven = spec.pair, spec.driving, spec.driven
    assert pair is not None
    for shaft, gear in (("driving", driving), ("driven", driven)):
        if gear.teeth is None:
            raise PairError("missing; a [pair] needs both tooth counts.", where=f"{shaft}.teeth")
        if gear.helix_angle_deg is not None and (
            gear.helix_left_deg is not None or gear.helix_right_deg is not None
        ):
            raise PairError(
                "given beside helix_left_deg or helix_right_deg; give either one angle for both"
                " flanks or one for each.",
                where=f"{shaft}.helix_angle_deg",
            )
    for first, second in (
        ("module_mm", "normal_module_mm"),
        ("pressure_angle_deg", "normal_pressure_angle_deg"),
    ):
        if (getattr(pair, first) is None) == (getattr(pair, second) is None):
            seen = "neither" if getattr(pair, first) is None else "both"
            raise PairError(
                f"{seen} of `{first}` and `{second}` given; give one.", where=f"pair.{first}"
            )
    if driving.helix_deg != driven.helix_deg:
        raise PairError(
            f"{driven.helix_deg} against {driving.helix_deg} of the driving gear (left, right);"
            " tapered gears on parallel axes touch along a line only when the angles of each"
            " flank are equal.",
            where="driven.helix_angle_deg",
        )
    left, right = (abs(angle) for angle in driving.helix_deg)
    if pair.normal_module_mm is not None and left != right:
        raise PairError(
            "the transverse module is not defined by it when the flanks differ in helix angle; give"
            " module_mm.",
            where="pair.normal_module_mm",
        )
    if spec.driving.profile_shift + spec.driven.profile_shift and pair.centre_distance_mm is None:
        raise PairError(
            "missing; profile shifts move the axes apart, so the drawing has to say how far.",
            where="pair.centre_distance_mm",
        )
    for shaft, gear in (("driving", driving), ("driven", driven)):
        if gear.crowning_um and gear.face_width_mm is None:
            raise PairError(
                "missing; a crowned flank recedes towards the ends of the face.",
                where=f"{shaft}.face_width_mm",
            )
    if pair.centre_distance_mm is not None:
        _check_centre_distance(spec, pair.centre_distance_mm)


def transverse_module_mm(spec: "PairSpec") -> float:
    """Module in the transverse plane, m = mₙ / cos β."""
    assert spec.pair is not None
    if spec.pair.module_mm is not None:
        return spec.pair.module_mm
    assert spec.pair.normal_module_mm is not None
    return spec.pair.normal_module_mm / math.cos(spec.driving.helix_deg[0] * DEG)


def transverse_pressure_angles_deg(spec: "PairSpec") -> tuple[float, float]:
    """Transverse pressure angles of the left and right flank, tan αₜ = tan αₙ / cos β."""
    assert spec.pair is not None
    if spec.pair.pressure_angle_deg is not None:
        return spec.pair.pressure_angle_deg, spec.pair.pressure_angle_deg
    assert spec.pair.normal_pressure_angle_deg is not None
    tangent = math.tan(spec.pair.normal_pressure_angle_deg * DEG)
    left, right = (math.atan(tangent / math.cos(b * DEG)) / DEG for b in spec.driving.helix_deg)
    return left, right


def depth_ratio(spec: "PairSpec") -> float:
    """The module that counts depths and profile shifts over the transverse one."""
    assert spec.pair is not None
    given_normal = spec.pair.normal_module_mm is not None
    return math.cos(spec.driving.helix_deg[0] * DEG) if given_normal else 1.0


def _check_centre_distance(spec: "PairSpec", distance: float) -> None:
    assert spec.driving.teeth and spec.driven.teeth
    where = "pair.centre_distance_mm"
    module = transverse_module_mm(spec)
    reference = module * (spec.driving.teeth + spec.driven.teeth) / 2
    base = reference * math.cos(min(transverse_pressure_angles_deg(spec)) * DEG)
    depth = module * depth_ratio(spec)
    shift = spec.driving.profile_shift + spec.driven.profile_shift
    shifted = reference + depth * shift
    about = _without_backlash(spec, reference, depth * shift)
    contact = shifted - depth * spec.rack.clearance
    apart = shifted + depth * 2 * spec.rack.addendum
    if distance <= base:
        raise PairError(
            f"{distance:g} mm lets the base circles overlap (their radii sum to {base:.3f} mm);"
            f" these tooth counts and this module ask for about {about:.6g} mm.",
            where=where,
        )
    if distance < contact:
        raise PairError(
            f"{distance:g} mm is below contact: tips reach the roots at {contact:g} mm; these tooth"
            f" counts and this module ask for about {about:.6g} mm.",
            where=where,
        )
    if distance >= apart:
        raise PairError(
            f"{distance:g} mm is too far: the tips no longer meet at {apart:g} mm; these tooth"
            f" counts and this module ask for about {about:.6g} mm.",
            where=where,
        )


def _without_backlash(spec: "PairSpec", reference: float, shift_mm: float) -> float:
    """Centre distance at which shifted teeth would just fit, inv α_w = inv α + x m tan α/a₀."""
    alpha = sum(transverse_pressure_angles_deg(spec)) / 2 * DEG
    wanted = math.tan(alpha) - alpha + shift_mm * math.tan(alpha) / reference
    if wanted <= 0:
        return reference + shift_mm
    working = math.atan((3 * wanted) ** (1 / 3))
    for _ in range(20):
        working -= (math.tan(working) - working - wanted) / math.tan(working) ** 2
    return reference * math.cos(alpha) / math.cos(working)
