"""Gear, rack, gear pair and drive: nominal transverse data and what is derived from them.

Lengths are in mm and angles in rad unless a suffix states another unit. Flank A is the left flank
of both gears and flank B the right one; arrays with a flank axis are ordered (A, B). Objects are
frozen pytrees with NumPy float64 leaves, so new values never recompile a jitted function.

`Eccentricities` are the errors of an individual rig: of both gears, with the constant backlash.
`pair_from_spec` and `spec_of` convert from and to a pair file, and a `ShaftReading` converts an
encoder reading to the angle of its shaft.
"""

import math
from dataclasses import KW_ONLY, dataclass
from fractions import Fraction
from pathlib import Path

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float

from ..base.arrays import Number, Numbers, float64, namespace, written
from ..base.files.text_tables import key_values
from ..base.units import DEG, REV
from .pair_file import load_pair_spec, transverse
from .schema import (
    DriveTable,
    Encoder,
    GearTable,
    HarmonicOrders,
    LogLayout,
    PairSpec,
    PairTable,
    RackTable,
    UnitTable,
)
from .schema import Flank as Flank

Scalar = Float[Number, ""]


class Rack(eqx.Module):
    """Basic rack with depths in multiples of a module, normal or transverse.

    **Arguments**
    - `addendum`: addendum h_ap, the height of the gear tip above the profile reference line.
    - `clearance`: bottom clearance c_p, the depth of the root below the tip of the mating gear.
    - `tip_radius`: radius of the arcs at the tip of the cutter, in the transverse plane. None means
      c_p/(1 − sin αₜ), the arc tangent to the tip line and to the flank at the mating addendum.
    - `depth_ratio`: the module of depths and profile shifts divided by the transverse module:
      cos β if the normal module is given, else 1.
    """

    addendum: Scalar = eqx.field(converter=float64, default=1.0)
    clearance: Scalar = eqx.field(converter=float64, default=0.25)
    tip_radius: Scalar | None = eqx.field(
        converter=lambda radius: None if radius is None else float64(radius), default=None
    )
    depth_ratio: Scalar = eqx.field(converter=float64, default=1.0)

    __repr__ = written


class Gear(eqx.Module):
    """Involute gear whose tooth thickness decreases by tan β_L + tan β_R per unit length along +z.

    **Arguments**
    - `teeth`: number of teeth z.
    - `helix_left_deg`, `helix_right_deg`: helix angles of the two flanks in degrees, positive if
      the flank makes the tooth thinner towards +z.
    - `face_width_mm`: face width b in mm, or NaN if unknown.
    - `encoder`: encoder on the shaft of this gear.
    - `profile_shift`: profile shift coefficient x, in multiples of `GearPair.depth_module_mm`.
    - `crowning_um`: distance by which each flank recedes at both ends of the face, relative to the
      middle of the face, in µm along the reference circle.
    - `tooth_thinning_mm`: arc by which the tooth is thinner than the rack makes it, half of it on
      each flank, in mm at the reference circle; the drawing's allowance for backlash.
    """

    teeth: int = eqx.field(static=True)
    helix_left_deg: Scalar = eqx.field(converter=float64, default=0.0)
    helix_right_deg: Scalar = eqx.field(converter=float64, default=0.0)
    face_width_mm: Scalar = eqx.field(converter=float64, default=math.nan)
    encoder: Encoder = eqx.field(static=True, default=Encoder())
    profile_shift: Scalar = eqx.field(converter=float64, default=0.0)
    crowning_um: Scalar = eqx.field(converter=float64, default=0.0)
    tooth_thinning_mm: Scalar = eqx.field(converter=float64, default=0.0)

    __repr__ = written

    @property
    def helix_deg(self) -> tuple[float, float]:
        """Helix angles of the left and the right flank in degrees."""
        return float(self.helix_left_deg), float(self.helix_right_deg)


class GearPair(eqx.Module):
    """Driving and driven gear on parallel axes.

    **Arguments**
    - `driving`, `driven`: the gears; each flank has the same helix angle on both gears.
    - `module_mm`: transverse module m in mm.
    - `pressure_angles_deg`: transverse pressure angles of flanks A and B in degrees, shape (2,); a
      single number is used for both.
    - `centre_distance_mm`: nominal centre distance a in mm, or None for the sum of reference radii.
    - `rack`: basic rack of both gears.

    **Example**
    ```python
    >>> from vttig_jax import Gear, GearPair
    >>> pair = GearPair(Gear(45), Gear(80), module_mm=2.0, pressure_angles_deg=20.0)
    >>> pair.ratio, pair.hunting_turns
    (Fraction(9, 16), 16)

    ```
    """

    driving: Gear
    driven: Gear
    _: KW_ONLY
    module_mm: Scalar = eqx.field(converter=float64)
    pressure_angles_deg: Float[Numbers, "2"] = eqx.field(
        converter=lambda angles: float64(angles) + np.zeros(2)
    )
    centre_distance_mm: Scalar = eqx.field(converter=float64, default=None)
    rack: Rack = Rack()
    name: str = eqx.field(static=True, default="")
    log: LogLayout = eqx.field(static=True, default=LogLayout())
    unit: UnitTable = eqx.field(static=True, default=UnitTable())
    fit: HarmonicOrders = eqx.field(static=True, default=HarmonicOrders())

    def __post_init__(self):
        if self.centre_distance_mm is None:
            teeth = self.driving.teeth + self.driven.teeth
            self.centre_distance_mm = float64(self.module_mm) * teeth / 2

    @property
    def ratio(self) -> Fraction:
        """Ratio i = z₁/z₂ of the driven to the driving speed."""
        return Fraction(self.driving.teeth, self.driven.teeth)

    @property
    def hunting_turns(self) -> int:
        """Turns of the driving gear after which the same teeth meet again at the same angles."""
        return self.ratio.denominator

    @property
    def hunting_period(self) -> str:
        """The hunting period in words."""
        return f"{_turns(self.hunting_turns)}, until the same teeth meet again"

    @property
    def reference_radii(self) -> Float[Numbers, "2"]:
        """Reference radii R = m z/2 of the driving and the driven gear in mm."""
        return self.module_mm * np.array([self.driving.teeth, self.driven.teeth]) / 2

    @property
    def base_radii(self) -> Float[Numbers, "gear=2 flank=2"]:
        """Base radii r_b = R cos αₜ in mm; rows are driving and driven, columns flanks A and B."""
        xp = namespace(self.pressure_angles_deg)
        cosines = xp.cos(self.pressure_angles_deg * DEG)
        return self.reference_radii[:, None] * cosines[None, :]

    @property
    def working_pressure_angles(self) -> Float[Numbers, "2"]:
        """α_w of flanks A and B in rad at centre distance a: cos α_w = (r_b1 + r_b2)/a."""
        cosines = self.base_radii.sum(axis=0) / self.centre_distance_mm
        return namespace(cosines).arccos(cosines)

    @property
    def working_radii(self) -> Float[Numbers, "2"]:
        """Working pitch radii of both gears in mm: r_w1 + r_w2 = a and r_w1/r_w2 = z₁/z₂."""
        fraction = float(1 / (1 + 1 / self.ratio))
        return self.centre_distance_mm * np.array([fraction, 1 - fraction])

    @property
    def taper(self) -> Float[Numbers, "2"]:
        """Tangential shift of flanks A and B per axial displacement: tan β_L, tan β_R of gear 2."""
        left, right = self.driven.helix_left_deg, self.driven.helix_right_deg
        xp = namespace(left, right)
        return xp.tan(xp.stack([left, right]) * DEG)

    @property
    def thinning(self) -> Scalar:
        """Backlash at the reference circle per unit of axial displacement, tan β_L + tan β_R."""
        return self.taper.sum()

    @property
    def depth_module_mm(self) -> Scalar:
        """Unit of depths and profile shifts in mm: the normal module if given, else m."""
        return self.module_mm * self.rack.depth_ratio

    @property
    def tip_radii(self) -> Float[Numbers, "2"]:
        """Tip radii R + (h_ap + x) m of both gears in mm; here m is `depth_module_mm`."""
        height = self.rack.addendum + self._profile_shifts
        return self.reference_radii + self.depth_module_mm * height

    @property
    def root_radii(self) -> Float[Numbers, "2"]:
        """Root radii R − (h_ap + c_p − x) m of both gears in mm; here m is `depth_module_mm`."""
        depth = self.rack.addendum + self.rack.clearance
        return self.reference_radii - self.depth_module_mm * (depth - self._profile_shifts)

    @property
    def _profile_shifts(self) -> Float[Numbers, "2"]:
        shifts = self.driving.profile_shift, self.driven.profile_shift
        return namespace(shifts).stack(shifts)

    @property
    def contact_ratios(self) -> Float[Numbers, "2"]:
        """Transverse contact ratios of flanks A and B.

        ε = [√(r_a1² − r_b1²) + √(r_a2² − r_b2²) − a sin α_w] / (π m cos αₜ)
        """
        tips = self.tip_radii[:, None]
        xp = namespace(self)
        paths = xp.sqrt(tips**2 - self.base_radii**2).sum(axis=0)
        paths = paths - self.centre_distance_mm * xp.sin(self.working_pressure_angles)
        return paths / (math.pi * self.module_mm * xp.cos(self.pressure_angles_deg * DEG))

    @property
    def drawing_backlash(self) -> Scalar:
        """Backlash for nominal tooth thickness and centre distance, in rad of the driven gear.

        It is Σ [(r_b1 + r_b2)(inv α_w − inv αₜ) − (x₁ + x₂) m sin αₜ]/r_b2 over both flanks, and
        the thinning of both teeth over R₂.
        """
        angles = self.pressure_angles_deg * DEG
        opening = involute(self.working_pressure_angles) - involute(angles)
        shift = self._profile_shifts.sum() * self.depth_module_mm / self.reference_radii[1]
        thickening = shift * namespace(angles).tan(angles).sum()
        thinning = self.driving.tooth_thinning_mm + self.driven.tooth_thinning_mm
        return (
            opening.sum() * float(1 + self.ratio) - thickening + thinning / self.reference_radii[1]
        )

    __repr__ = written

    def __str__(self) -> str:
        flanks = "{:.4f}° / {:.4f}°".format
        rows = [
            ("teeth", f"{self.driving.teeth} / {self.driven.teeth}"),
            ("ratio i", f"{self.ratio} = {float(self.ratio):.6g}"),
            ("module", f"{self.module_mm:g} mm"),
            ("pressure angle A / B", flanks(*self.pressure_angles_deg)),
            ("working pressure angle A / B", flanks(*(self.working_pressure_angles / DEG))),
            ("helix angle left / right", flanks(*self.driven.helix_deg)),
            ("centre distance", f"{self.centre_distance_mm:g} mm"),
            ("reference radii", "{:g} / {:g} mm".format(*self.reference_radii)),
            ("contact ratio A / B", "{:.3f} / {:.3f}".format(*self.contact_ratios)),
            ("hunting period", self.hunting_period),
            ("drawing backlash", f"{self.drawing_backlash / DEG:.4f}°"),
        ]
        return key_values(rows, title=self.name or "gear pair")


class Drive(eqx.Module):
    """Two-shaft drive with known ratio and unknown gear geometry; all its results are angles."""

    ratio: Fraction = eqx.field(static=True)
    driving: GearTable = eqx.field(static=True, default=GearTable())
    driven: GearTable = eqx.field(static=True, default=GearTable())
    name: str = eqx.field(static=True, default="")
    log: LogLayout = eqx.field(static=True, default=LogLayout())
    unit: UnitTable = eqx.field(static=True, default=UnitTable())
    fit: HarmonicOrders = eqx.field(static=True, default=HarmonicOrders())

    @property
    def hunting_turns(self) -> int:
        """Turns of the driving shaft after which both shafts have made whole turns."""
        return self.ratio.denominator

    @property
    def hunting_period(self) -> str:
        """The hunting period in words."""
        return f"{_turns(self.hunting_turns)}, until both shafts have made whole turns"

    def __str__(self) -> str:
        rows = [
            ("ratio i", f"{self.ratio} = {float(self.ratio):.6g}"),
            ("hunting period", self.hunting_period),
        ]
        return key_values(rows, title=self.name or "drive")


def _turns(count: int) -> str:
    return f"{count} driving turn{'' if count == 1 else 's'} = {360 * count}°"


def involute(angle: Float[Numbers, "..."]) -> Float[Numbers, "..."]:
    """Return the involute function inv α = tan α − α in rad."""
    return namespace(angle).tan(angle) - angle


def pair_from_spec(spec: PairSpec) -> GearPair | Drive:
    """Build a `GearPair` or `Drive` from a validated pair file."""
    sections = {"name": spec.name, "log": spec.log, "unit": spec.unit, "fit": spec.fit}
    if spec.drive is not None:
        return Drive(spec.ratio, spec.driving, spec.driven, **sections)
    assert spec.pair is not None
    module, angles, depth_ratio = transverse(spec)
    return GearPair(
        _gear(spec.driving),
        _gear(spec.driven),
        module_mm=module,
        pressure_angles_deg=angles,
        centre_distance_mm=spec.pair.centre_distance_mm,
        rack=Rack(spec.rack.addendum, spec.rack.clearance, spec.rack.tip_radius, depth_ratio),
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
    width = math.nan if table.face_width_mm is None else table.face_width_mm
    shape = table.profile_shift, table.crowning_um, table.tooth_thinning_mm
    return Gear(table.teeth, *table.helix_deg, width, table.encoder, *shape)


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


class Eccentricities(eqx.Module):
    """Offsets of the base-circle centres from the rotation axes, and the constant backlash j_c.

    **Arguments**
    - `driving_mm`, `driven_mm`: eccentricities e₁, e₂ in mm.
    - `driving_phase_deg`, `driven_phase_deg`: angles θ₁, θ₂ in degrees from the line of centres to
      the offset at φ = 0, each positive in the direction in which its gear turns for positive φ.
    - `constant_backlash_deg`: backlash j_c for e₁ = e₂ = 0, in degrees of the driven gear.
    - `axial_mm`: axial displacement s of the driven gear in mm, positive towards the end of the
      face where the teeth of the driving gear are thick.
    """

    driving_mm: Scalar = eqx.field(converter=float64, default=0.0)
    driving_phase_deg: Scalar = eqx.field(converter=float64, default=0.0)
    driven_mm: Scalar = eqx.field(converter=float64, default=0.0)
    driven_phase_deg: Scalar = eqx.field(converter=float64, default=0.0)
    constant_backlash_deg: Scalar = eqx.field(converter=float64, default=0.0)
    axial_mm: Scalar = eqx.field(converter=float64, default=0.0)

    __repr__ = written

    @property
    def cartesian(self) -> tuple[Complex[Array, ""], Complex[Array, ""]]:
        """Offsets e·exp(jθ) of the driving and the driven gear in mm."""
        return (
            jnp.asarray(self.driving_mm) * jnp.exp(1j * DEG * self.driving_phase_deg),
            jnp.asarray(self.driven_mm) * jnp.exp(1j * DEG * self.driven_phase_deg),
        )
