"""The generating rack, equations (1) to (4), and the tooth surface that it cuts, (5) to (15).

x₁ runs along the pitch line, y₁ towards the outside of the gear, z₁ = l along its axis. The blank
lies below a part and between AC and DF; the cutter is on the other side. AC is the left flank of
the tooth, DF the right one; the arcs at the tip of the cutter continue them towards the root.

The right half is the left one in a mirror, so (2) is (1) with x₁ → −x₁ and the angles of its own.
The general tooth has a recession δ(l) where the paper has l tan β, and its profile reference line
stands above the pitch line by the profile shift.

The gear turns by +φ (counter-clockwise) while the rack stands at x = −φ r₂, so that the pitch point
is at (φ r₂, 0) in S₁. A point of the rack makes gear where its normal passes through that point,

    y₁ = −(x₁ − φ r₂) tan α    on AC (10),    y₁ = (x₁ − φ r₂) tan α    on DF.

Inside, φ is the paper's. A flank that recedes by δ meets the pitch point later by δ/r₂, so `roll`
is counted from there, φ = roll ± δ(l)/r₂ (left, right): the same roll is then the same height on
the tooth in every section.
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
"""In the order of every array with an axis of flanks."""

Values = Float[Number, "..."]
"""Numbers of any shape."""

Points = Float[Numbers, "... 3"]
"""Points or vectors x, y, z."""


class RackSide(eqx.Module):
    """One half of the rack cutter; coordinates before mirroring are those of the left half.

    **Arguments**
    - `mirror`: 1 for the left half, −1 for the right one.
    - `pressure_angle`: α of its straight flank, rad.
    - `quarter_pitch`: π m/4, from the middle of the tooth to the flank at the reference line, mm.
    - `addendum`, `dedendum`: h_ap and h_ap + c_p, mm.
    - `tip_radius`: radius ρ of the arc, mm.
    - `shift`: distance of the profile reference line from the pitch line, mm.
    - `pitch_radius`: r₂ of the pitch circle that rolls on the pitch line, mm.
    - `recession`: δ(l).
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
        """Height y₁ at which the arc ends and the straight flank starts, mm."""
        sine = namespace(self).sin(self.pressure_angle)
        return self.shift - self.dedendum + self.tip_radius * (1 - sine)

    @property
    def arc_centre(self) -> tuple[Scalar, Scalar]:
        """Centre of the arc where δ = 0, before mirroring, mm."""
        xp = namespace(self)
        height = self.flank_start
        along = (height - self.shift) * xp.tan(self.pressure_angle) - self.quarter_pitch
        normal = self.tip_radius * xp.cos(self.pressure_angle)
        return along - normal, self.shift - self.dedendum + self.tip_radius

    def recedes(self, z: Values) -> Values:
        """δ(l) in mm."""
        return self.recession(namespace(z).asarray(z))

    def slope(self, z: Array) -> Array:
        """dδ/dl, which is tan β of the paper."""
        return jax.jvp(self.recedes, (z,), (jnp.ones_like(z),))[1]

    def flank(self, d: Values, z: Values) -> Points:
        """Point of AC (1) or DF (2) at the distance d from A or F, where y₁ = −h_ap + shift.

        x₁ = ±(d sin α + δ(l) − π m/4 − h_ap tan α),  y₁ = d cos α − h_ap + shift,  z₁ = l
        """
        xp = namespace(self, d, z)
        alpha = self.pressure_angle
        x = d * xp.sin(alpha) + self.recedes(z) - self.quarter_pitch
        x = x - self.addendum * xp.tan(alpha)
        return self._point(x, d * xp.cos(alpha) - self.addendum + self.shift, z)

    def arc(self, steep: Values, z: Values) -> Points:
        """Point of the arc whose normal falls by `steep`: α next to the flank, π/2 at the tip."""
        xp = namespace(self, steep, z)
        x, y = self.arc_centre
        x = x + self.recedes(z) + self.tip_radius * xp.cos(steep)
        return self._point(x, y - self.tip_radius * xp.sin(steep), z)

    def tip_line(self, x: Values, z: Values) -> Points:
        """Point of the line at the tip of the cutter, which makes the root of the gear."""
        return self._point(x, self.shift - self.dedendum, z)

    def root_line(self, x: Values, z: Values) -> Points:
        """Point of the line CD between the flanks, which makes the tip of the gear."""
        return self._point(x, self.shift + self.addendum, z)

    def normal(self, steep: Array, z: Array) -> Points:
        """Normal (4) into the gear, not of unit length, where it falls by `steep` in the section.

        n = (± cos α, −sin α, −cos α dδ/dl), and likewise on the arc, whose centre moves with δ.
        """
        x, y = jnp.cos(steep), -jnp.sin(steep)
        return self._point(x, y, -x * self.slope(z))

    def _point(self, x: Any, y: Any, z: Any) -> Points:
        xp = namespace(x, y, z)
        return xp.stack(xp.broadcast_arrays(self.mirror * x, y, z), axis=-1)


def rack_side(tooth: Tooth, side: Side) -> RackSide:
    """The half of the rack that cuts the left or the right flank of a tooth."""
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
    """0 for the left, 1 for the right flank."""
    if side not in SIDES:
        raise ValueError(f'Argument `side` must be "left" or "right", but is {side!r}.')
    return SIDES.index(side)


def paper_angle(rack: RackSide, roll: Values, z: Values) -> Values:
    """φ of the paper at a roll angle counted from the receded flank, rad."""
    return roll + rack.mirror * rack.recedes(z) / rack.pitch_radius


def flank_distance(rack: RackSide, phi: Values, z: Values) -> Values:
    """Distance d of the contact from A or F: (1) in (10) gives (11), solved for d (14).

    d = sin α [π m/4 + h_ap tan α + (h_ap − shift)/tan α ± φ r₂ − δ(l)]
    """
    xp = namespace(rack, phi, z)
    tangent = xp.tan(rack.pressure_angle)
    height = rack.addendum * tangent + (rack.addendum - rack.shift) / tangent
    travel = rack.mirror * phi * rack.pitch_radius - rack.recedes(z)
    return xp.sin(rack.pressure_angle) * (rack.quarter_pitch + height + travel)


def arc_steepness(rack: RackSide, phi: Values, z: Values) -> Values:
    """By how much the normal at the contact on the arc falls, rad: (10) with the arc's centre.

    tan θ = −y_c/(x_c + δ ∓ φ r₂) with θ in (0, π).
    """
    xp = namespace(rack, phi, z)
    x, y = rack.arc_centre
    across = x + rack.recedes(z) - rack.mirror * phi * rack.pitch_radius
    return xp.arctan2(xp.abs(y), -xp.sign(y) * across)


def arc_roll(rack: RackSide, steep: Values) -> Values:
    """Roll angle at which the arc touches with a normal that falls by `steep`, rad."""
    x, y = rack.arc_centre
    return rack.mirror * (x + y / namespace(rack, steep).tan(steep)) / rack.pitch_radius


def to_gear(rack: RackSide, point: Points, phi: Values) -> Points:
    """From S₁ to S₂, (13) and (15).

    x₂ = x₁ cos φ + y₁ sin φ + r₂ (sin φ − φ cos φ)
    y₂ = −x₁ sin φ + y₁ cos φ + r₂ (cos φ + φ sin φ)
    z₂ = l
    """
    xp = namespace(point, phi)
    x, y, z = point[..., 0], point[..., 1], point[..., 2]
    radius, cosine, sine = rack.pitch_radius, xp.cos(phi), xp.sin(phi)
    # Gathered by φ r₂, which x₁ nearly cancels: the sum of large terms would cost digits.
    across, up = x - phi * radius, y + radius
    turned = across * cosine + up * sine, up * cosine - across * sine, z
    return xp.stack(xp.broadcast_arrays(*turned), axis=-1)


def turn_to_gear(vector: Points, phi: Values) -> Array:
    """A direction from S₁ to S₂: the rotation in (13)."""
    x, y, z = vector[..., 0], vector[..., 1], vector[..., 2]
    cosine, sine = jnp.cos(phi), jnp.sin(phi)
    return jnp.stack([x * cosine + y * sine, y * cosine - x * sine, z], axis=-1)


def contact(rack: RackSide, part: str, roll: Array, z: Array) -> tuple[Points, Array, Array]:
    """Where a part of the rack makes gear: the point in S₁, how its normal falls, and φ."""
    phi = jnp.asarray(paper_angle(rack, roll, z))
    upright = jnp.full_like(phi, jnp.pi / 2)
    if part == "flank":
        point = rack.flank(flank_distance(rack, phi, z), z)
        return point, jnp.broadcast_to(rack.pressure_angle, phi.shape), phi
    if part == "fillet":
        steep = jnp.asarray(arc_steepness(rack, phi, z))
        return rack.arc(steep, z), steep, phi
    pitch_point = rack.mirror * phi * rack.pitch_radius  # normals of the lines are upright
    if part == "root":
        return rack.tip_line(pitch_point, z), upright, phi
    return rack.root_line(pitch_point, z), upright, phi
