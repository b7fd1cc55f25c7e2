"""Gear, rack, gear pair and drive: nominal transverse data and what is derived from them.

Basic rack of both gears, with tooth depths in modules.

Gear, gear pair and drive: nominal transverse data and the quantities derived from them.

Lengths are in mm and angles in rad unless a suffix states another unit. Flank A is the left flank
of both gears and flank B the right one; arrays with a flank axis are ordered (A, B). Objects are
frozen pytrees with NumPy float64 leaves, so new values never recompile a jitted function.
"""

import math
from fractions import Fraction
from typing import Literal

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float

from ..base.arrays import Number, Numbers, float64, namespace, written
from ..base.files.text_tables import key_values
from ..base.units import DEG
from .schema import Encoder, GearTable, HarmonicOrders, LogLayout, UnitTable

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


Flank = Literal["A", "B"]


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
    module_mm: Scalar
    pressure_angles_deg: Float[Numbers, "2"]
    centre_distance_mm: Scalar
    rack: Rack
    name: str = eqx.field(static=True)
    log: LogLayout = eqx.field(static=True)
    unit: UnitTable = eqx.field(static=True)
    fit: HarmonicOrders = eqx.field(static=True)

    def __init__(
        self,
        driving: Gear,
        driven: Gear,
        *,
        module_mm: float | Array,
        pressure_angles_deg: float | tuple[float, float] | Array,
        centre_distance_mm: float | Array | None = None,
        rack: Rack = Rack(),
        name: str = "",
        log: LogLayout = LogLayout(),
        unit: UnitTable = UnitTable(),
        fit: HarmonicOrders = HarmonicOrders(),
    ):
        self.driving, self.driven = driving, driven
        self.module_mm = float64(module_mm)
        angles = float64(pressure_angles_deg)
        self.pressure_angles_deg = angles + np.zeros(2)
        reference = self.module_mm * (driving.teeth + driven.teeth) / 2
        self.centre_distance_mm = (
            reference if centre_distance_mm is None else float64(centre_distance_mm)
        )
        self.rack = rack
        self.name, self.log, self.unit, self.fit = name, log, unit, fit

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
