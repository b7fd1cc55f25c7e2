"""Conversion of a pair file to a `GearPair` or `Drive`, and of a `GearPair` to a pair file."""

import math
from pathlib import Path

from .gear_pair import Drive, Gear, GearPair
from .pair_file import (
    depth_ratio,
    load_pair_spec,
    transverse_module_mm,
    transverse_pressure_angles_deg,
)
from .rack import Rack
from .schema import DriveTable, GearTable, PairSpec, PairTable, RackTable


def pair_from_spec(spec: PairSpec) -> GearPair | Drive:
    """Build a `GearPair` or `Drive` from a validated pair file."""
    sections = {"name": spec.name, "log": spec.log, "unit": spec.unit, "fit": spec.fit}
    if spec.drive is not None:
        return Drive(spec.ratio, spec.driving, spec.driven, **sections)
    assert spec.pair is not None
    driving, driven = (_gear(table) for table in (spec.driving, spec.driven))
    return GearPair(
        driving,
        driven,
        module_mm=transverse_module_mm(spec),
        pressure_angles_deg=transverse_pressure_angles_deg(spec),
        centre_distance_mm=spec.pair.centre_distance_mm,
        rack=_rack(spec),
        **sections,
    )


def pair_spec(pair: GearPair) -> PairSpec:
    """Return the contents of the pair file of a gear pair with equal pressure angles.

    **Raises** `ValueError` for different pressure angles, for which the file has no key.
    """
    left, right = (float(angle) for angle in pair.pressure_angles_deg)
    if left != right:
        raise ValueError(
            "Argument `pair` must have one pressure angle, but flanks A and B have"
            f" {left:g}° and {right:g}°."
        )
    return PairSpec(
        name=pair.name,
        pair=PairTable(
            module_mm=float(pair.module_mm),
            pressure_angle_deg=left,
            centre_distance_mm=float(pair.centre_distance_mm),
        ),
        rack=_rack_table(pair.rack),
        driving=_gear_table(pair.driving, pair.rack),
        driven=_gear_table(pair.driven, pair.rack),
        log=pair.log,
        unit=pair.unit,
        fit=pair.fit,
    )


def spec_of(pair: GearPair | Drive) -> PairSpec:
    """Return the contents of the pair file of a gear pair with equal pressure angles or a drive.

    **Raises** `ValueError` for different pressure angles, for which the file has no key.
    """
    if isinstance(pair, GearPair):
        return pair_spec(pair)
    return PairSpec(
        name=pair.name,
        drive=DriveTable(ratio=str(pair.ratio)),
        driving=pair.driving,
        driven=pair.driven,
        log=pair.log,
        unit=pair.unit,
        fit=pair.fit,
    )


def load_pair(path: str | Path) -> GearPair | Drive:
    """Read a pair file (TOML): `[pair]` gives a `GearPair`, `[drive]` gives a `Drive`.

    **Raises** `PairError` naming the file and the missing, unknown or invalid key.
    """
    return pair_from_spec(load_pair_spec(path))


def _gear(table: GearTable) -> Gear:
    assert table.teeth is not None
    left, right = table.helix_deg
    width = math.nan if table.face_width_mm is None else table.face_width_mm
    return Gear(
        teeth=table.teeth,
        helix_left_deg=left,
        helix_right_deg=right,
        face_width_mm=width,
        encoder=table.encoder,
        profile_shift=table.profile_shift,
        crowning_um=table.crowning_um,
        tooth_thinning_mm=table.tooth_thinning_mm,
    )


def _rack(spec: PairSpec) -> Rack:
    rack = spec.rack
    return Rack(rack.addendum, rack.clearance, rack.tip_radius, depth_ratio(spec))


def _rack_table(rack: Rack) -> RackTable:
    """Return table `[rack]` with depths in transverse modules, as `pair_spec` writes m."""
    addendum, clearance = (
        float(depth * rack.depth_ratio) for depth in (rack.addendum, rack.clearance)
    )
    radius = None if rack.tip_radius is None else float(rack.tip_radius * rack.depth_ratio)
    return RackTable(addendum=addendum, clearance=clearance, tip_radius=radius)


def _gear_table(gear: Gear, rack: Rack) -> GearTable:
    left, right = gear.helix_deg
    width = float(gear.face_width_mm)
    return GearTable(
        teeth=gear.teeth,
        face_width_mm=None if math.isnan(width) else width,
        helix_left_deg=left,
        helix_right_deg=right,
        profile_shift=float(gear.profile_shift * rack.depth_ratio),
        crowning_um=float(gear.crowning_um),
        tooth_thinning_mm=float(gear.tooth_thinning_mm),
        encoder=gear.encoder,
    )
