"""Gear as drawn: section of a tooth at every height along the axis.

In the frame of a gear z is the axis with 0 in the middle of the face, and y is the centre line of
one tooth (if both flanks are alike); x points to the right. Seen from +z the tooth points up and
its left flank has negative x. A tapered tooth thins towards +z.

Flank A of a driving gear is its left flank. The driven gear is mounted with its z opposite to that
of the driving gear, so its flank A is its right flank, and the thick end of each gear faces the
thin end of the mate.
"""

import math
from typing import Literal, Protocol, get_args, runtime_checkable

import equinox as eqx
from jaxtyping import Float

from ..base.arrays import Number, Numbers, float64, namespace
from ..base.units import DEG
from ..pair.gear_pair import GearPair, involute

Shaft = Literal["driving", "driven"]
Side = Literal["left", "right"]
Scalar = Float[Number, ""]

SHAFTS: tuple[Shaft, Shaft] = get_args(Shaft)
SIDES: tuple[Side, Side] = get_args(Side)
"""Flanks in the order of every array axis of flanks."""


@runtime_checkable
class Recession(Protocol):
    """Smooth function of z: recession of a flank along the reference circle.

    The tangential modification of the paper is x_t(z) = −(δ_left(z) + δ_right(z))/m. The function
    takes arrays, so that it can be jitted and differentiated.
    """

    def __call__(self, z: Float[Numbers, "*shape"]) -> Float[Number, "*shape"]:
        """Return δ(z) in mm, positive where the tooth is thinner than in the middle of the face."""
        ...


class Taper(eqx.Module):
    """Recession of a tapered, crowned and thinned flank: δ(z) = t + z tan β + c (2 z/b)².

    **Arguments**
    - `slope`: tan β, positive where the flank thins the tooth towards +z.
    - `crowning_mm`: recession c due to crowning at both ends of the face.
    - `face_width_mm`: face width b; it is used only with a crowning.
    - `thinning_mm`: recession t in the middle of the face, half the thinning of the tooth.
    """

    slope: Scalar = eqx.field(converter=float64)
    crowning_mm: Scalar = eqx.field(converter=float64, default=0.0)
    face_width_mm: Scalar = eqx.field(converter=float64, default=1.0)
    thinning_mm: Scalar = eqx.field(converter=float64, default=0.0)

    def __call__(self, z: Float[Numbers, "*shape"]) -> Float[Number, "*shape"]:
        """Return δ(z) in mm."""
        crown = self.crowning_mm * (2 * z / self.face_width_mm) ** 2
        return z * self.slope + crown + self.thinning_mm


class Tooth(eqx.Module):
    """Gear with constant radial and varying tangential modification; sides are (left, right).

    **Arguments**
    - `teeth`: number of teeth.
    - `module_mm`: transverse module.
    - `pressure_angles_deg`: transverse pressure angles of the left and the right flank, shape (2,).
    - `recession`: recession of the left and the right flank at height z; see `Recession`.
    - `addendum_mm`, `dedendum_mm`: height of the tip above and depth of the root below the profile
      reference line, which is displaced by the profile shift.
    - `fillet_radius_mm`: radius of the arcs at the tip of the rack cutter.
    - `profile_shift_mm`: distance of the profile reference line from the reference circle.
    - `face_width_mm`: width of the face, NaN if it is not drawn.
    """

    teeth: int = eqx.field(static=True)
    module_mm: Scalar = eqx.field(converter=float64)
    pressure_angles_deg: Float[Numbers, "2"] = eqx.field(converter=float64)
    recession: tuple[Recession, Recession]
    addendum_mm: Scalar = eqx.field(converter=float64)
    dedendum_mm: Scalar = eqx.field(converter=float64)
    fillet_radius_mm: Scalar = eqx.field(converter=float64)
    profile_shift_mm: Scalar = eqx.field(converter=float64, default=0.0)
    face_width_mm: Scalar = eqx.field(converter=float64, default=math.nan)

    @property
    def pressure_angles(self) -> Float[Numbers, "2"]:
        """Transverse pressure angles of the left and the right flank, rad."""
        return self.pressure_angles_deg * DEG

    @property
    def reference_radius(self) -> Scalar:
        """R = m z/2, mm."""
        return self.module_mm * self.teeth / 2

    @property
    def base_radii(self) -> Float[Numbers, "2"]:
        """R cos αₜ of the left and the right flank, mm."""
        return self.reference_radius * namespace(self).cos(self.pressure_angles)

    @property
    def base_half_angles(self) -> Float[Numbers, "2"]:
        """Half angles (π m/4 + x m tan αₜ)/R + inv αₜ on the base circles without recession, rad.

        They are the angles from the centre line of the tooth to its left and its right flank.
        """
        shift = self.profile_shift_mm * namespace(self).tan(self.pressure_angles)
        arc = math.pi * self.module_mm / 4 + shift
        return arc / self.reference_radius + involute(self.pressure_angles)

    @property
    def tip_radius(self) -> Scalar:
        """R + x m + h_ap, mm."""
        return self.reference_radius + self.profile_shift_mm + self.addendum_mm

    @property
    def root_radius(self) -> Scalar:
        """R + x m − h_ap − c_p, mm."""
        return self.reference_radius + self.profile_shift_mm - self.dedendum_mm

    def recessions(self, z: Float[Numbers, "*shape"]) -> Float[Numbers, "*shape 2"]:
        """Return δ of the left and the right flank at height z, mm along the reference circle."""
        left, right = (flank(z) for flank in self.recession)
        return namespace(left, right).stack([left, right], axis=-1)

    def half_angles(
        self, radius: Float[Numbers, "*shape"], z: Float[Numbers, "*shape"]
    ) -> Float[Numbers, "*shape 2"]:
        """Return the angles from the centre line of the tooth to its left and right flank, rad.

            ψ(r, z) = (π m/4 + x m tan αₜ − δ(z))/R + inv αₜ − inv α(r),    cos α(r) = r_b/r

        If the sum of both is negative, the tooth ends below r. NaN below the base circle.
        """
        xp, recessions = namespace(self, radius, z), self.recessions(z)
        base_radii, on_base = (
            xp.broadcast_to(of_flanks, recessions.shape)
            for of_flanks in (self.base_radii, self.base_half_angles)
        )
        at_radius = xp.arccos(base_radii / xp.asarray(radius)[..., None])
        return on_base - recessions / self.reference_radius - involute(at_radius)

    def thickness(
        self, radius: Float[Numbers, "*shape"], z: Float[Numbers, "*shape"]
    ) -> Float[Numbers, "*shape"]:
        """Return the arc, mm, inside the tooth at a radius, mm, and height z, mm."""
        return radius * self.half_angles(radius, z).sum(axis=-1)


def tooth_of(pair: GearPair, shaft: Shaft) -> Tooth:
    """Return the gear of one shaft of a pair in its own frame."""
    gear, xp = getattr(pair, shaft), namespace(pair)
    order = [0, 1] if shaft == "driving" else [1, 0]
    angles = pair.pressure_angles_deg[xp.asarray(order)]
    slopes = xp.tan(xp.stack([gear.helix_left_deg, gear.helix_right_deg]) * DEG)
    width = xp.where(xp.isnan(gear.face_width_mm), 1.0, gear.face_width_mm)  # no crowning then
    shape = gear.crowning_um * 1e-3, width, gear.tooth_thinning_mm / 2
    taper = [Taper(slopes[side], *shape) for side in order]
    rack, depth = pair.rack, pair.depth_module_mm
    # The smaller pressure angle gives an arc that is valid for both flanks.
    default = rack.clearance / (1 - xp.sin(pair.pressure_angles_deg * DEG).min())
    return Tooth(
        teeth=gear.teeth,
        module_mm=pair.module_mm,
        pressure_angles_deg=angles,
        recession=(taper[0], taper[1]),
        addendum_mm=rack.addendum * depth,
        dedendum_mm=(rack.addendum + rack.clearance) * depth,
        fillet_radius_mm=(default if rack.tip_radius is None else rack.tip_radius) * depth,
        profile_shift_mm=gear.profile_shift * depth,
        face_width_mm=gear.face_width_mm,
    )
