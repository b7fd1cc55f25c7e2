"""Reads the pair file, and refuses geometry that no gear pair can have, with the key at fault."""

import math
from pathlib import Path
from typing import Any

from ..base.errors import PairError
from ..base.files.toml_io import TomlFile, plain_table
from ..base.units import DEG
from .schema import PairSpec, RackTable, StatedTable, as_fraction

PAIR_FILE = TomlFile(
    PairError,
    noun="a pair file",
    cure="name the TOML of the rig",
    content="names the rig in [pair] and two gears, or in [drive]",
)


def check_geometry(spec: PairSpec) -> None:
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


def transverse_module_mm(spec: PairSpec) -> float:
    """Module in the transverse plane, m = mₙ / cos β."""
    assert spec.pair is not None
    if spec.pair.module_mm is not None:
        return spec.pair.module_mm
    assert spec.pair.normal_module_mm is not None
    return spec.pair.normal_module_mm / math.cos(spec.driving.helix_deg[0] * DEG)


def transverse_pressure_angles_deg(spec: PairSpec) -> tuple[float, float]:
    """Transverse pressure angles of the left and right flank, tan αₜ = tan αₙ / cos β."""
    assert spec.pair is not None
    if spec.pair.pressure_angle_deg is not None:
        return spec.pair.pressure_angle_deg, spec.pair.pressure_angle_deg
    assert spec.pair.normal_pressure_angle_deg is not None
    tangent = math.tan(spec.pair.normal_pressure_angle_deg * DEG)
    left, right = (math.atan(tangent / math.cos(b * DEG)) / DEG for b in spec.driving.helix_deg)
    return left, right


def depth_ratio(spec: PairSpec) -> float:
    """The module that counts depths and profile shifts over the transverse one."""
    assert spec.pair is not None
    given_normal = spec.pair.normal_module_mm is not None
    return math.cos(spec.driving.helix_deg[0] * DEG) if given_normal else 1.0


def _check_centre_distance(spec: PairSpec, distance: float) -> None:
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


def _without_backlash(spec: PairSpec, reference: float, shift_mm: float) -> float:
    """Centre distance at which shifted teeth would just fit, inv α_w = inv α + x m tan α/a₀."""
    alpha = sum(transverse_pressure_angles_deg(spec)) / 2 * DEG
    wanted = math.tan(alpha) - alpha + shift_mm * math.tan(alpha) / reference
    if wanted <= 0:
        return reference + shift_mm
    working = math.atan((3 * wanted) ** (1 / 3))
    for _ in range(20):
        working -= (math.tan(working) - working - wanted) / math.tan(working) ** 2
    return reference * math.cos(alpha) / math.cos(working)


def parse_pair_spec(table: dict[str, Any], source: str = "") -> PairSpec:
    """Validate a parsed TOML table; `source` is the file name for messages."""
    with PAIR_FILE.placed(source):
        spec: PairSpec = PAIR_FILE.convert(table, PairSpec)
        _check_tables(spec)
    return spec


def load_pair_spec(path: str | Path) -> PairSpec:
    """Read and validate a pair file (TOML)."""
    return parse_pair_spec(PAIR_FILE.read(path), str(path))


def spec_table(spec: PairSpec) -> dict[str, Any]:
    """The TOML table of a spec: `parse_pair_spec(spec_table(spec)) == spec`."""
    return plain_table(spec)


def _check_tables(spec: PairSpec) -> None:
    """Refuse combinations of keys that contradict each other or leave the ratio open."""
    if (spec.pair is None) == (spec.drive is None):
        seen = "neither" if spec.pair is None else "both"
        raise PairError(
            f"{seen} of [pair] and [drive] given; write [pair] with both tooth counts, or [drive]"
            " ratio for a drive without gear geometry.",
            where="pair",
        )
    as_fraction(spec.log.driving_scale, "log.driving_scale")
    as_fraction(spec.log.driven_scale, "log.driven_scale")
    if spec.log.time is not None and spec.log.sample_rate_hz is not None:
        raise PairError(
            "both `time` and `sample_rate_hz` given; keep the one the log has.",
            where="log.sample_rate_hz",
        )
    if spec.log.driven is not None and spec.log.transmission_error is not None:
        raise PairError(
            "both `driven` and `transmission_error` given; a log has the second shaft"
            " or the curve.",
            where="log.transmission_error",
        )
    if spec.drive is not None:
        as_fraction(spec.drive.ratio, "drive.ratio")
        if spec.rack != RackTable():
            raise PairError("a [drive] has no teeth; remove this table.", where="rack")
        for shaft, gear in (("driving", spec.driving), ("driven", spec.driven)):
            for key in (
                "teeth",
                "face_width_mm",
                "helix_angle_deg",
                "helix_left_deg",
                "helix_right_deg",
                "profile_shift",
                "crowning_um",
                "stated",
            ):
                if getattr(gear, key):
                    raise PairError(
                        "a [drive] has no gear geometry; remove this key, or replace [drive] by"
                        " [pair] and both tooth counts.",
                        where=f"{shaft}.{key}",
                    )
    else:
        check_geometry(spec)
        _check_stated(spec)


def _check_stated(spec: PairSpec) -> None:
    """Refuse what says nothing without a second number."""
    for shaft, gear in (("driving", spec.driving), ("driven", spec.driven)):
        for value, needed, what in (
            ("span_mm", "span_teeth", "over how many teeth"),
            ("over_balls_mm", "ball_diameter_mm", "over balls of which diameter"),
        ):
            stated = gear.stated or StatedTable()
            if getattr(stated, value) is not None and getattr(stated, needed) is None:
                raise PairError(
                    f"missing; {value} does not say {what}.", where=f"{shaft}.stated.{needed}"
                )
