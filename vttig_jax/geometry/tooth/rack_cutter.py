"""Generating rack, equations (1) to (4), and the tooth surface that it cuts, (5) to (15).

x₁ is along the pitch line, y₁ points to the outside of the gear, z₁ = l is along its axis. The gear
lies below each line of the rack and between AC and DF, the cutter on the other side. AC cuts the
left flank of the tooth, DF the right one; the arcs at the cutter tip connect them to the tip line.

The right half is the mirror image of the left one, so (2) is (1) with x₁ → −x₁ and the angles of
the right flank. The recession δ(l) replaces the l tan β of the paper, and the profile reference
line is above the pitch line by the profile shift.

S₁ is the frame of the rack, S₂ that of the gear. When the gear has turned by +φ
(counter-clockwise), the rack is at x = −φ r₂ and the pitch point is at (φ r₂, 0) in S₁. A rack
point generates the gear when its normal passes through the pitch point:

    y₁ = −(x₁ − φ r₂) tan α    on AC (10),    y₁ = (x₁ − φ r₂) tan α    on DF.

φ is the angle of the paper. A flank that recedes by δ reaches the pitch point later by δ/r₂. The
roll angle is counted from there, φ = roll ± δ(l)/r₂ (left, right), so that equal roll angles give
equal radii in every section.
"""

import math
from typing import Any, Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...base.arrays import Number, Numbers, namespace
from .recession import Recession
from .tooth import Tooth

Side = Literal["left", "right"]
Scalar = Float[Number, ""]

SIDES: tuple[Side, Side] = ("left", "right")
"""Flanks in the order of every array axis of flanks."""

Values = Float[Number, "..."]
"""Numbers of any shape."""

Points = Float[Numbers, "... 3"]
"""Points or vectors x, y, z."""


class RackSide(eqx.Module):
    """One half of the rack cutter; coordinates before mirroring are those of the left half.

    **Arguments**
    - `mirror`: 1 for the left half, −1 for the right one.
    - `pressure_angle`: pressure angle α of the straight flank, rad.
    - `quarter_pitch`: π m/4, from the middle of the tooth to the flank at the reference line, mm.
    - `addendum`, `dedendum`: h_ap and h_ap + c_p, mm.
    - `tip_radius`: radius ρ of the arc, mm.
    - `shift`: distance of the profile reference line from the pitch line, mm.
    - `pitch_radius`: radius r₂ of the pitch circle that rolls on the pitch line, mm.
    - `recession`: recession δ(l) of the flank, mm.
    """

    mirror: float = eqx.field(static=True)
    pressure_angle: Scalar
    quarter_pitch: Scalar
    addendum: Scalar
    dedendum: Scalar
    tip_radius: Scalar
    shift: Scalar
    pitch_radius: Scalar
    recession: Recession

    @property
    def flank_start(self) -> Scalar:
        """Height y₁ of the joint of arc and straight flank, mm."""
        sine = namespace(self).sin(self.pressure_angle)
        return self.shift - self.dedendum + self.tip_radius * (1 - sine)

    @property
    def arc_centre(self) -> tuple[Scalar, Scalar]:
        """Centre of the arc for δ = 0, before mirroring, mm."""
        xp = namespace(self)
        height = self.flank_start
        along = (height - self.shift) * xp.tan(self.pressure_angle) - self.quarter_pitch
        normal = self.tip_radius * xp.cos(self.pressure_angle)
        return along - normal, self.shift - self.dedendum + self.tip_radius

    def recedes(self, z: Values) -> Values:
        """Return the recession δ(l), mm, at the height l = z, mm."""
        return self.recession(namespace(z).asarray(z))

    def slope(self, z: Array) -> Array:
        """Return dδ/dl at height z, mm; it is tan β of the paper."""
        return jax.jvp(self.recedes, (z,), (jnp.ones_like(z),))[1]

    def flank(self, d: Values, z: Values) -> Points:
        """Return the point of AC (1) or DF (2) at distance d from A or F (y₁ = −h_ap + shift), mm.

        x₁ = ±(d sin α + δ(l) − π m/4 − h_ap tan α),  y₁ = d cos α − h_ap + shift,  z₁ = l
        """
        xp = namespace(self, d, z)
        alpha = self.pressure_angle
        x = d * xp.sin(alpha) + self.recedes(z) - self.quarter_pitch
        x = x - self.addendum * xp.tan(alpha)
        return self._point(x, d * xp.cos(alpha) - self.addendum + self.shift, z)

    def arc(self, normal_angle: Values, z: Values) -> Points:
        """Return the arc point, mm, whose normal points `normal_angle`, rad, below the x₁ axis.

        The angle runs from α at the joint with the flank to π/2 at the tip line.
        """
        xp = namespace(self, normal_angle, z)
        x, y = self.arc_centre
        x = x + self.recedes(z) + self.tip_radius * xp.cos(normal_angle)
        return self._point(x, y - self.tip_radius * xp.sin(normal_angle), z)

    def tip_line(self, x: Values, z: Values) -> Points:
        """Return a point, mm, of the tip line of the cutter, which cuts the root of the gear."""
        return self._point(x, self.shift - self.dedendum, z)

    def root_line(self, x: Values, z: Values) -> Points:
        """Return a point, mm, of the root line CD of the cutter, which forms the gear's tip."""
        return self._point(x, self.shift + self.addendum, z)

    def normal(self, normal_angle: Array, z: Array) -> Points:
        """Return the normal (4) into the gear, not of unit length, `normal_angle` below x₁ (rad).

        n = (± cos α, −sin α, −cos α dδ/dl). The same holds on the arc, whose centre moves with δ.
        """
        x, y = jnp.cos(normal_angle), -jnp.sin(normal_angle)
        return self._point(x, y, -x * self.slope(z))

    def _point(self, x: Any, y: Any, z: Any) -> Points:
        xp = namespace(x, y, z)
        return xp.stack(xp.broadcast_arrays(self.mirror * x, y, z), axis=-1)


def rack_side(tooth: Tooth, side: Side) -> RackSide:
    """Return the half of the rack that cuts the left or the right flank of a tooth."""
    index = side_index(side)
    return RackSide(
        mirror=1.0 - 2.0 * index,
        pressure_angle=tooth.pressure_angles[index],
        quarter_pitch=tooth.module_mm * np.float64(math.pi / 4),
        addendum=tooth.addendum_mm,
        dedendum=tooth.dedendum_mm,
        tip_radius=tooth.fillet_radius_mm,
        shift=tooth.profile_shift_mm,
        pitch_radius=tooth.reference_radius,
        recession=tooth.recession[index],
    )


def side_index(side: Side) -> int:
    """Return 0 for the left flank, 1 for the right flank."""
    if side not in SIDES:
        raise ValueError(f'Argument `side` must be "left" or "right", but is {side!r}.')
    return SIDES.index(side)


def paper_angle(rack: RackSide, roll: Values, z: Values) -> Values:
    """Return φ = roll ± δ(z)/r₂ of the paper, rad, for a roll angle, rad, and a height z, mm."""
    return roll + rack.mirror * rack.recedes(z) / rack.pitch_radius


def flank_distance(rack: RackSide, phi: Values, z: Values) -> Values:
    """Return the distance d of the contact from A or F, mm: (1) in (10) is (11), solved in (14).

    d = sin α [π m/4 + h_ap tan α + (h_ap − shift)/tan α ± φ r₂ − δ(l)]
    """
    xp = namespace(rack, phi, z)
    tangent = xp.tan(rack.pressure_angle)
    height = rack.addendum * tangent + (rack.addendum - rack.shift) / tangent
    travel = rack.mirror * phi * rack.pitch_radius - rack.recedes(z)
    return xp.sin(rack.pressure_angle) * (rack.quarter_pitch + height + travel)


def arc_normal_angle(rack: RackSide, phi: Values, z: Values) -> Values:
    """Return the angle θ, rad, of the arc normal below x₁ at the contact: (10) at the arc centre.

    tan θ = −y_c/(x_c + δ ∓ φ r₂) with θ in (0, π).
    """
    xp = namespace(rack, phi, z)
    x, y = rack.arc_centre
    across = x + rack.recedes(z) - rack.mirror * phi * rack.pitch_radius
    return xp.arctan2(xp.abs(y), -xp.sign(y) * across)


def arc_roll(rack: RackSide, normal_angle: Values) -> Values:
    """Return the roll angle, rad, at which the arc point of normal angle θ, rad, is in contact."""
    x, y = rack.arc_centre
    return (
        rack.mirror * (x + y / namespace(rack, normal_angle).tan(normal_angle)) / rack.pitch_radius
    )


def to_gear(rack: RackSide, point: Points, phi: Values) -> Points:
    """Transform points from S₁ to S₂ by (13) and (15).

    x₂ = x₁ cos φ + y₁ sin φ + r₂ (sin φ − φ cos φ)
    y₂ = −x₁ sin φ + y₁ cos φ + r₂ (cos φ + φ sin φ)
    z₂ = l
    """
    xp = namespace(point, phi)
    x, y, z = point[..., 0], point[..., 1], point[..., 2]
    radius, cosine, sine = rack.pitch_radius, xp.cos(phi), xp.sin(phi)
    # x₁ nearly cancels φ r₂, so their difference is formed first to keep the digits.
    across, up = x - phi * radius, y + radius
    rotated = across * cosine + up * sine, up * cosine - across * sine, z
    return xp.stack(xp.broadcast_arrays(*rotated), axis=-1)


def turn_to_gear(vector: Points, phi: Values) -> Array:
    """Rotate a direction from S₁ to S₂ by the rotation in (13)."""
    x, y, z = vector[..., 0], vector[..., 1], vector[..., 2]
    cosine, sine = jnp.cos(phi), jnp.sin(phi)
    return jnp.stack([x * cosine + y * sine, y * cosine - x * sine, z], axis=-1)


def contact(rack: RackSide, part: str, roll: Array, z: Array) -> tuple[Points, Array, Array]:
    """Return the generating point of a rack part in S₁, mm, its normal angle and φ, both in rad."""
    phi = jnp.asarray(paper_angle(rack, roll, z))
    vertical = jnp.full_like(phi, jnp.pi / 2)
    if part == "flank":
        point = rack.flank(flank_distance(rack, phi, z), z)
        return point, jnp.broadcast_to(rack.pressure_angle, phi.shape), phi
    if part == "fillet":
        normal_angle = jnp.asarray(arc_normal_angle(rack, phi, z))
        return rack.arc(normal_angle, z), normal_angle, phi
    pitch_point = rack.mirror * phi * rack.pitch_radius  # the normals of the lines are vertical
    if part == "root":
        return rack.tip_line(pitch_point, z), vertical, phi
    return rack.root_line(pitch_point, z), vertical, phi
