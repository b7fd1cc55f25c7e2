"""Conversion of a pair file to a `GearPair` or `Drive` and back, and of encoder readings.

Conversion of a pair file to a `GearPair` or `Drive`, and of a `GearPair` to a pair file.

Conversion of an encoder reading to the angle of its shaft.
"""

import math
from dataclasses import dataclass
from pathlib import Path

from ..base.units import DEG, REV
from .gear_pair import Drive, Gear, GearPair, Rack
from .pair_file import (
    depth_ratio,
    load_pair_spec,
    transverse_module_mm,
    transverse_pressure_angles_deg,
)
from .schema import DriveTable, Encoder, GearTable, PairSpec, PairTable, RackTable


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
        rack=Rack(spec.rack.addendum, spec.rack.clearance, spec.rack.tip_radius, depth_ratio(spec)),
        **sections,
    )


def spec_of(pair: GearPair | Drive) -> PairSpec:
    """Return the contents of the pair file of a gear pair with equal pressure angles or a drive.

    Depths are written in transverse modules.

    **Raises** `ValueError` for different pressure angles, for which the file has no key.
    """
    sections = {"name": pair.name, "log": pair.log, "unit": pair.unit, "fit": pair.fit}
    if isinstance(pair, Drive):
        drive = DriveTable(ratio=str(pair.ratio))
        return PairSpec(drive=drive, driving=pair.driving, driven=pair.driven, **sections)
    left, right = (float(angle) for angle in pair.pressure_angles_deg)
    if left != right:
        raise ValueError(
            "Argument `pair` must have one pressure angle, but flanks A and B have"
            f" {left:g}° and {right:g}°."
        )
    rack, depth = pair.rack, pair.rack.depth_ratio
    return PairSpec(
        pair=PairTable(
            module_mm=float(pair.module_mm),
            pressure_angle_deg=left,
            centre_distance_mm=float(pair.centre_distance_mm),
        ),
        rack=RackTable(
            addendum=float(rack.addendum * depth),
            clearance=float(rack.clearance * depth),
            tip_radius=None if rack.tip_radius is None else float(rack.tip_radius * depth),
        ),
        driving=_gear_table(pair.driving, rack),
        driven=_gear_table(pair.driven, rack),
        **sections,
    )


def load_pair(path: str | Path) -> GearPair | Drive:
    """Read a pair file (TOML): `[pair]` gives a `GearPair`, `[drive]` gives a `Drive`.

    **Raises** `PairError` naming the file and the missing, unknown or invalid key.
    """
    return pair_from_spec(load_pair_spec(path))


def _gear(table: GearTable) -> Gear:
    assert table.teeth is not None
    return Gear(
        teeth=table.teeth,
        helix_left_deg=table.helix_deg[0],
        helix_right_deg=table.helix_deg[1],
        face_width_mm=math.nan if table.face_width_mm is None else table.face_width_mm,
        encoder=table.encoder,
        profile_shift=table.profile_shift,
        crowning_um=table.crowning_um,
        tooth_thinning_mm=table.tooth_thinning_mm,
    )


def _gear_table(gear: Gear, rack: Rack) -> GearTable:
    width = float(gear.face_width_mm)
    return GearTable(
        teeth=gear.teeth,
        face_width_mm=None if math.isnan(width) else width,
        helix_left_deg=gear.helix_deg[0],
        helix_right_deg=gear.helix_deg[1],
        profile_shift=float(gear.profile_shift * rack.depth_ratio),
        crowning_um=float(gear.crowning_um),
        tooth_thinning_mm=float(gear.tooth_thinning_mm),
        encoder=gear.encoder,
    )


@dataclass(frozen=True)
class ShaftReading:
    """Linear relation of shaft angle and reading, φ = `radians_per_unit` · (reading − `origin`).

    **Arguments**
    - `unit`: unit of the reading: "counts", or "rad" if the counts per revolution are unknown.
    - `radians_per_unit`: factor in rad per `unit` with the sign and scale of the log channel.
    - `origin`: reading at which φ is zero, in `unit`.

    **Example**
    ```python
    >>> from vttig_jax.pair import ShaftReading, shaft_reading
    >>> from vttig_jax.pair import Encoder
    >>> shaft = shaft_reading(Encoder(counts_per_rev=3600, sign=-1), origin_rad=0.0)
    >>> round(shaft.angle(900), 4), round(shaft.angle_of_deg(90.0), 4)
    (-1.5708, -1.5708)

    ```
    """

    unit: str
    radians_per_unit: float
    origin: float

    def angle(self, reading: float | int) -> float:
        """Return φ in rad for a reading in `unit`."""
        return self.radians_per_unit * (reading - self.origin)

    def angle_of_deg(self, reading_deg: float) -> float:
        """Return φ in rad for a reading in degrees of the shaft.

        `reading_deg` increases with the counts of the encoder. The scale of the log column is
        already applied to it.
        """
        sign = math.copysign(1.0, self.radians_per_unit)
        return sign * reading_deg * DEG - self.radians_per_unit * self.origin


def shaft_reading(encoder: Encoder, origin_rad: float, scale: float = 1.0) -> ShaftReading:
    """Return the relation of shaft angle and reading for an encoder.

    **Arguments**
    - `origin_rad`: reading at which φ is zero, in rad of the encoder, before its sign and `scale`
      are applied.
    - `scale`: scale of the log column, `driving_scale` or `driven_scale` of the pair file.
    """
    if encoder.counts_per_rev is None:
        return ShaftReading("rad", encoder.sign * scale, origin_rad)
    count = REV / encoder.counts_per_rev
    return ShaftReading("counts", encoder.sign * scale * count, origin_rad / count)
