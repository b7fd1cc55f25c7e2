"""Reading and validation of the pair file; every error names the key that is wrong."""

import math
from pathlib import Path
from typing import Any

from ..base.errors import PairError
from ..base.files.toml_io import TomlFile, plain_table
from ..base.units import DEG
from .schema import (
    GearTable,
    LogLayout,
    PairSpec,
    RackTable,
    StatedTable,
    as_cut,
    as_edge,
    as_fraction,
    as_ratio,
)

PAIR_FILE = TomlFile(
    PairError,
    noun="a pair file",
    cure="name the TOML of the rig",
    content="names the rig in [pair] and two gears, or in [drive]",
)


def check_geometry(spec: PairSpec) -> None:
    """Raise `PairError` for impossible gear geometry; its `where` is the dotted key."""
    pair, driving, driven = spec.pair, spec.driving, spec.driven
    assert pair is not None
    for shaft, gear in (("driving", driving), ("driven", driven)):
        if gear.teeth is None:
            message = "this key is missing; a [pair] needs both tooth counts."
            raise PairError(message, where=f"{shaft}.teeth")
        if gear.helix_angle_deg is not None and (
            gear.helix_left_deg is not None or gear.helix_right_deg is not None
        ):
            raise PairError(
                "this key excludes helix_left_deg and helix_right_deg; give either one angle for"
                " both flanks or one for each.",
                where=f"{shaft}.helix_angle_deg",
            )
    modules = "module_mm", "normal_module_mm", "diametral_pitch"
    for keys in (modules, ("pressure_angle_deg", "normal_pressure_angle_deg")):
        given = [key for key in keys if getattr(pair, key) is not None]
        if len(given) != 1:
            first, second = (given or keys)[:2]
            state = f"`{first}` and `{second}` are both {'given' if given else 'missing'}; give one"
            raise PairError(f"{state}.", where=f"pair.{keys[0]}")
    if driving.helix_deg != driven.helix_deg:
        raise PairError(
            f"the helix angles (left, right) are {driven.helix_deg}, but {driving.helix_deg} on the"
            " driving gear; give each flank the same angle on both gears, because otherwise the"
            " flanks have no line contact on parallel axes.",
            where="driven.helix_angle_deg",
        )
    left, right = (abs(angle) for angle in driving.helix_deg)
    if pair.normal_module_mm is not None and left != right:
        raise PairError(
            "a normal module defines no transverse module if the helix angles of the flanks differ;"
            " give module_mm.",
            where="pair.normal_module_mm",
        )
    if spec.driving.profile_shift + spec.driven.profile_shift and pair.centre_distance_mm is None:
        raise PairError(
            "this key is missing; give the centre distance, because profile shifts change it.",
            where="pair.centre_distance_mm",
        )
    for shaft, gear in (("driving", driving), ("driven", driven)):
        if gear.crowning_um and gear.face_width_mm is None:
            raise PairError(
                "this key is missing; give the face width, because the flanks have a crowning.",
                where=f"{shaft}.face_width_mm",
            )
    if pair.centre_distance_mm is not None:
        _check_centre_distance(spec, pair.centre_distance_mm)


def transverse(spec: PairSpec) -> tuple[float, tuple[float, float], float]:
    """Return module, mm, and pressure angles of both flanks, °, in the transverse plane, and mₙ/m.

    m = mₙ / cos β and tan αₜ = tan αₙ / cos β. The last number is that of `Rack.depth_ratio`: cos β
    if the normal module is given, else 1.
    """
    assert spec.pair is not None
    pair, cosines = spec.pair, [math.cos(beta * DEG) for beta in spec.driving.helix_deg]
    depth_ratio = 1.0 if pair.normal_module_mm is None else cosines[0]
    if pair.diametral_pitch is not None:
        module = 25.4 / pair.diametral_pitch
    else:
        module = (pair.module_mm or pair.normal_module_mm or math.nan) / depth_ratio
    left = right = pair.pressure_angle_deg
    if left is None or right is None:
        tangent = math.tan((pair.normal_pressure_angle_deg or math.nan) * DEG)
        left, right = (math.atan(tangent / cosine) / DEG for cosine in cosines)
    return module, (left, right), depth_ratio


def _check_centre_distance(spec: PairSpec, distance: float) -> None:
    assert spec.driving.teeth and spec.driven.teeth
    where = "pair.centre_distance_mm"
    module, angles, depth_ratio = transverse(spec)
    reference = module * (spec.driving.teeth + spec.driven.teeth) / 2
    base = reference * math.cos(min(angles) * DEG)
    depth = module * depth_ratio
    shift = spec.driving.profile_shift + spec.driven.profile_shift
    shifted = reference + depth * shift
    expected = _backlash_free_distance(sum(angles) / 2 * DEG, reference, depth * shift)
    contact = shifted - depth * spec.rack.clearance
    apart = shifted + depth * 2 * spec.rack.addendum
    expectation = f"these tooth counts and this module need about {expected:.6g} mm"
    for wrong, said in (
        (distance <= base, f"lets the base circles overlap (their radii sum to {base:.3f} mm)"),
        (distance < contact, f"is too short: the tips touch the roots at {contact:g} mm"),
        (distance >= apart, f"is too long: the teeth lose contact at {apart:g} mm"),
    ):
        if wrong:
            raise PairError(f"{distance:g} mm {said}; {expectation}.", where=where)


def _backlash_free_distance(alpha: float, reference: float, shift_mm: float) -> float:
    """Return the centre distance in mm without backlash, inv α_w = inv α + x m tan α/a₀.

    `alpha` is the transverse pressure angle α, rad, `reference` the sum a₀ of the reference radii,
    mm, and `shift_mm` is x m = (x₁ + x₂) m.
    """
    involute = math.tan(alpha) - alpha + shift_mm * math.tan(alpha) / reference
    if involute <= 0:
        return reference + shift_mm
    working = math.atan((3 * involute) ** (1 / 3))
    for _ in range(20):
        working -= (math.tan(working) - working - involute) / math.tan(working) ** 2
    return reference * math.cos(alpha) / math.cos(working)


def parse_pair_spec(table: dict[str, Any], source: str = "") -> PairSpec:
    """Validate a parsed TOML table; error messages name the file `source`."""
    with PAIR_FILE.error_context(source):
        spec: PairSpec = PAIR_FILE.convert(table, PairSpec)
        _check_tables(spec)
    return spec


def load_pair_spec(path: str | Path) -> PairSpec:
    """Read and validate a pair file (TOML)."""
    return parse_pair_spec(PAIR_FILE.read(path), str(path))


def spec_table(spec: PairSpec) -> dict[str, Any]:
    """Return the TOML table of a spec, so that `parse_pair_spec(spec_table(spec)) == spec`."""
    return plain_table(spec)


def stated_table(spec: PairSpec) -> dict[str, Any]:
    """Return the TOML table of a spec without the keys that have their default.

    `parse_pair_spec(stated_table(spec)) == spec` holds, too.

    **Example**
    ```python
    >>> from vttig_jax.pair.pair_file import stated_table
    >>> from vttig_jax.pair.schema import DriveTable, LogLayout, PairSpec
    >>> stated_table(PairSpec(drive=DriveTable(ratio="16:9"), log=LogLayout(time="t_s")))
    {'drive': {'ratio': '16:9'}, 'log': {'time': 't_s'}}

    ```
    """
    return _without(plain_table(spec), plain_table(PairSpec()))


def _without(table: dict[str, Any], defaults: dict[str, Any]) -> dict[str, Any]:
    """Return `table` without the entries of `defaults` and without tables that become empty."""
    kept = {}
    for key, value in table.items():
        usual = defaults.get(key)
        if isinstance(value, dict) and isinstance(usual, dict):
            value = _without(value, usual)
            usual = {}
        if value != usual:
            kept[key] = value
    return kept


def _check_tables(spec: PairSpec) -> None:
    """Raise `PairError` for contradictory keys and for an undefined ratio."""
    if (spec.pair is None) == (spec.drive is None):
        state = "missing" if spec.pair is None else "given"
        raise PairError(
            f"[pair] and [drive] are both {state}; write [pair] with both tooth counts, or [drive]"
            " with the ratio for a drive without gear geometry.",
            where="pair",
        )
    check_rows(spec.log)
    for one, other in (("time", "sample_rate_hz"), ("driven", "transmission_error")):
        if None not in (getattr(spec.log, one), getattr(spec.log, other)):
            raise PairError(
                f"`{one}` and `{other}` are both given; keep only one of them.",
                where=f"log.{other}",
            )
    if spec.drive is not None:
        as_ratio(spec.drive.ratio, "drive.ratio")
        if spec.rack != RackTable():
            raise PairError("a [drive] has no teeth; remove this table.", where="rack")
        for shaft, gear in (("driving", spec.driving), ("driven", spec.driven)):
            for key in GearTable.__struct_fields__[:-1]:  # all but the encoder
                if getattr(gear, key):
                    raise PairError(
                        "a [drive] has no gear geometry; remove this key, or replace [drive] by"
                        " [pair] and both tooth counts.",
                        where=f"{shaft}.{key}",
                    )
    else:
        check_geometry(spec)
        _check_stated(spec)


def check_rows(log: LogLayout) -> None:
    """Raise `PairError` for wrong scales, and for a wrong window or cut of the rows."""
    as_fraction(log.driving_scale, "log.driving_scale")
    as_fraction(log.driven_scale, "log.driven_scale")
    for key, edge in (("from", log.start), ("to", log.stop)):
        if edge is not None:
            as_edge(edge, f"log.{key}")
    for text in log.cut:
        as_cut(text, "log.cut")


def _check_stated(spec: PairSpec) -> None:
    """Raise `PairError` for a measured length without the number that it needs."""
    for shaft, gear in (("driving", spec.driving), ("driven", spec.driven)):
        for value, needed, meaning in (
            ("span_mm", "span_teeth", "the number of teeth spanned"),
            ("over_balls_mm", "ball_diameter_mm", "the diameter of the balls"),
        ):
            stated = gear.stated or StatedTable()
            if getattr(stated, value) is not None and getattr(stated, needed) is None:
                raise PairError(
                    f"this key is missing; {value} needs {meaning}.",
                    where=f"{shaft}.stated.{needed}",
                )
