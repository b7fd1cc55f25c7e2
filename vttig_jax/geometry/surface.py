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
equal radii in every section. More than six digits need 64-bit floats; see `enable_x64`.
"""

import math
from typing import Any, Literal, get_args

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Float, Real

from ..base.arrays import Number, Numbers, compiled, namespace
from .tooth import SIDES, Recession, Scalar, Side, Tooth

Values = Float[Number, "..."]
"""Numbers of any shape."""

Points = Float[Numbers, "... 3"]
"""Points or vectors x, y, z."""

Part = Literal["root", "fillet", "flank", "tip"]
PARTS: tuple[Part, ...] = get_args(Part)
"""Parts of one side of a tooth from the root to the tip."""


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
    def joint_length(self) -> Scalar:
        """Roll length R sin α + y₁/sin α of the flank at that joint, mm."""
        sine = namespace(self).sin(self.pressure_angle)
        return self.pitch_radius * sine + self.flank_start / sine

    @property
    def arc_centre(self) -> tuple[Scalar, Scalar]:
        """Centre of the arc for δ = 0, before mirroring, mm."""
        xp = namespace(self)
        along = (self.flank_start - self.shift) * xp.tan(self.pressure_angle) - self.quarter_pitch
        normal = self.tip_radius * xp.cos(self.pressure_angle)
        return along - normal, self.shift - self.dedendum + self.tip_radius

    @property
    def half_tooth(self) -> Scalar:
        """(π m/4 + shift tan α)/R, rad: half the tooth at the reference circle for δ = 0."""
        tangent = namespace(self).tan(self.pressure_angle)
        return (self.quarter_pitch + self.shift * tangent) / self.pitch_radius

    def recedes(self, z: Values) -> Values:
        """Return the recession δ(l), mm, at the height l = z, mm."""
        return self.recession(namespace(z).asarray(z))

    def flank(self, phi: Values, z: Values) -> Points:
        """Return the point of AC (1) or DF (2) that cuts the gear at φ, mm.

        x₁ = ±(d sin α + δ(l) − π m/4 − h_ap tan α),  y₁ = d cos α − h_ap + shift,  z₁ = l
        d = sin α [π m/4 + h_ap tan α + (h_ap − shift)/tan α ± φ r₂ − δ(l)]        (14)
        """
        xp, alpha = namespace(self, phi, z), self.pressure_angle
        tangent, sine, recession = xp.tan(alpha), xp.sin(alpha), self.recedes(z)
        height = self.addendum * tangent + (self.addendum - self.shift) / tangent
        travel = self.mirror * phi * self.pitch_radius - recession
        d = sine * (self.quarter_pitch + height + travel)
        x = d * sine + recession - self.quarter_pitch - self.addendum * tangent
        return self.point(x, d * xp.cos(alpha) - self.addendum + self.shift, z)

    def arc(self, normal_angle: Values, z: Values) -> Points:
        """Return the arc point, mm, whose normal points `normal_angle`, rad, below the x₁ axis.

        The angle runs from α at the joint with the flank to π/2 at the tip line.
        """
        xp = namespace(self, normal_angle, z)
        x, y = self.arc_centre
        x = x + self.recedes(z) + self.tip_radius * xp.cos(normal_angle)
        return self.point(x, y - self.tip_radius * xp.sin(normal_angle), z)

    def arc_roll(self, normal_angle: Values) -> Values:
        """Return the roll angle, rad, at which the arc point of a normal angle is in contact."""
        (x, y), xp = self.arc_centre, namespace(self, normal_angle)
        return self.mirror * (x + y / xp.tan(normal_angle)) / self.pitch_radius

    def contact(self, part: Part, roll: Array, z: Array) -> tuple[Points, Array]:
        """Return the generating point of a part in S₁, mm, and φ = roll ± δ(z)/r₂, rad.

        On the arc tan θ = −y_c/(x_c + δ ∓ φ r₂) with θ in (0, π), which is (10) at its centre.
        """
        phi = jnp.asarray(roll + self.mirror * self.recedes(z) / self.pitch_radius)
        pitch_point = self.mirror * phi * self.pitch_radius
        if part == "flank":
            return self.flank(phi, z), phi
        if part == "fillet":
            x, y = self.arc_centre
            across = x + self.recedes(z) - pitch_point
            normal_angle = jnp.arctan2(jnp.abs(y), -jnp.sign(y) * across)
            return self.arc(normal_angle, z), phi
        # The normals of the tip line, which cuts the root, and of the root line are vertical.
        height = self.shift + (-self.dedendum if part == "root" else self.addendum)
        return self.point(pitch_point, height, z), phi

    def to_gear(self, point: Points, phi: Values) -> Points:
        """Transform points from S₁ to S₂ by (13) and (15).

        x₂ = x₁ cos φ + y₁ sin φ + r₂ (sin φ − φ cos φ)
        y₂ = −x₁ sin φ + y₁ cos φ + r₂ (cos φ + φ sin φ)
        z₂ = l
        """
        # x₁ nearly cancels φ r₂, so their difference is formed first to keep the digits.
        x, y = point[..., 0] - phi * self.pitch_radius, point[..., 1] + self.pitch_radius
        return turned(x, y, point[..., 2], phi)

    def point(self, x: Any, y: Any, z: Any) -> Points:
        """Return the point or vector of this half with the coordinates of the left half."""
        xp = namespace(x, y, z)
        return xp.stack(xp.broadcast_arrays(self.mirror * x, y, z), axis=-1)


def turned(x: Values, y: Values, z: Values, angle: Values) -> Points:
    """Return vectors x, y, z turned clockwise about the z axis by an angle, rad."""
    xp = namespace(x, y, angle)
    cosine, sine = xp.cos(angle), xp.sin(angle)
    rotated = x * cosine + y * sine, y * cosine - x * sine, z
    return xp.stack(xp.broadcast_arrays(*rotated), axis=-1)


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


@compiled
def tooth_surface(
    tooth: Tooth,
    roll_angle: Real[ArrayLike, "..."],
    z: Real[ArrayLike, "..."],
    *,
    side: Side = "left",
    part: Part = "flank",
) -> Float[Array, "... 3"]:
    """Return points of a tooth surface generated by the rack, (1), (2), (10)–(15).

        x₂ = x₁ cos φ + y₁ sin φ + r₂ (sin φ − φ cos φ)
        y₂ = −x₁ sin φ + y₁ cos φ + r₂ (cos φ + φ sin φ),    φ = roll ± δ(z)/r₂ (left, right)

    (x₁, y₁) is the rack point whose normal passes through the pitch point at the angle φ of the
    paper. It lies on the straight flank, on the arc at the cutter tip or on its tip or root line.

    The roll angle of the gear is counted from the position of the rack that has receded with the
    flank at height z. Equal roll angles therefore give equal radii in every section, and the limits
    of `flank_span` and `fillet_span` hold in all sections. Points are not clipped: beyond its
    limits a part continues as the same curve; `section_report` reports parts that cut each other.

    **Arguments**
    - `tooth`: gear; `tooth_of` takes it from a pair.
    - `roll_angle`: roll angles, rad, any shape; limits are given by `flank_span` and `fillet_span`.
    - `z`: heights along the axis from the middle of the face, mm, broadcast against `roll_angle`.
    - `side`: "left" or "right" flank; each half of a land belongs to the flank next to it.
    - `part`: "flank", "fillet", "root" (land) or "tip" (land).

    **Returns** x, y, z in mm in the frame of the tooth (axis z, tooth up along y), shape (..., 3).

    **Raises** `ValueError` for an unknown side or part.

    **Example**
    ```python
    >>> import numpy as np, vttig_jax
    >>> from vttig_jax import Gear, GearPair
    >>> from vttig_jax.geometry import flank_span, tooth_of, tooth_surface
    >>> vttig_jax.enable_x64()
    >>> gears = Gear(45, 3, 3, 20), Gear(80, 3, 3, 20)
    >>> pair = GearPair(*gears, module_mm=2.0, pressure_angles_deg=20.0)
    >>> tooth = tooth_of(pair, "driving")
    >>> roll = np.linspace(*flank_span(tooth, "left"), 3)
    >>> points = tooth_surface(tooth, roll[:, None], np.array([-10.0, 0.0, 10.0]), side="left")
    >>> points.shape
    (3, 3, 3)
    >>> points[:, 1].round(4)
    Array([[-1.9974, 43.3036,  0.    ],
           [-1.6101, 44.8487,  0.    ],
           [-0.7688, 46.9937,  0.    ]], dtype=float64)

    ```
    """
    if part not in PARTS:
        raise ValueError(
            f'Argument `part` must be "root", "fillet", "flank" or "tip", but is {part!r}.'
        )
    roll, height = jnp.broadcast_arrays(jnp.asarray(roll_angle, float), jnp.asarray(z, float))
    rack = rack_side(tooth, side)
    point, phi = rack.contact(part, roll, height)
    return jnp.asarray(rack.to_gear(point, phi))


def flank_roll(
    tooth: Tooth, radius: Real[ArrayLike, "*shape"], side: Side
) -> Float[Number, "*shape"]:
    """Return the roll angle of a flank point at a radius, rad; NaN below the base circle.

        roll = ± [√(r²/r_b² − 1) − tan α − (π m/4 + shift tan α)/R],    + left, − right flank

    Without recession it is the counter-clockwise rotation of the gear, from the position in which
    the centre line of the tooth passes through the pitch point, to the position in which the rack
    cuts this point. The radius r, the profile shift and the reference radius R are in mm.

    **Example**
    ```python
    >>> import numpy as np, vttig_jax
    >>> from vttig_jax import Gear, GearPair
    >>> from vttig_jax.geometry import flank_roll, tooth_of
    >>> gears = Gear(45, 3, 3, 20), Gear(80, 3, 3, 20)
    >>> pair = GearPair(*gears, module_mm=2.0, pressure_angles_deg=20.0)
    >>> np.degrees(flank_roll(tooth_of(pair, "driving"), np.array([44.0, 47.0]), "left")).round(3)
    array([-6.377,  4.943])

    ```
    """
    rack, index = rack_side(tooth, side), side_index(side)
    xp = namespace(tooth, radius)
    unwound = xp.sqrt((xp.asarray(radius, float) / tooth.base_radii[index]) ** 2 - 1)
    return rack.mirror * (unwound - xp.tan(rack.pressure_angle) - rack.half_tooth)


def flank_span(tooth: Tooth, side: Side) -> Float[Numbers, "2"]:
    """Return the roll angles at the end of the fillet and at the tip circle, rad.

    The first limit belongs to the end of the cutter's arc; on an undercut tooth the fillet removes
    that part of the flank. From root to tip the angle increases on the left flank and decreases on
    the right one.

    **Example**
    ```python
    >>> import numpy as np
    >>> from vttig_jax import Gear, GearPair
    >>> from vttig_jax.geometry import flank_span, tooth_of
    >>> gears = Gear(45, 3, 3, 20), Gear(80, 3, 3, 20)
    >>> pair = GearPair(*gears, module_mm=2.0, pressure_angles_deg=20.0)
    >>> np.degrees(flank_span(tooth_of(pair, "driving"), "right")).round(3)
    array([ 9.923, -4.943])

    ```
    """
    rack, xp = rack_side(tooth, side), namespace(tooth)
    tangent = xp.tan(rack.pressure_angle)
    along = rack.flank_start * (tangent + 1 / tangent) / rack.pitch_radius
    joint = rack.mirror * (along - rack.half_tooth)
    return xp.stack([joint, flank_roll(tooth, tooth.tip_radius, side)])


def fillet_span(tooth: Tooth, side: Side) -> Float[Numbers, "2"]:
    """Return the roll angles at the root circle and at the start of the flank, rad.

    The second limit is the first one of `flank_span`. If the arc centre is below the pitch line,
    which is usual, the roll angle changes in the opposite sense on fillet and flank. If it lies on
    the pitch line, both limits are equal: the fillet is the arc itself, generated at one roll
    angle, so the roll angle does not distinguish its points.

    **Example**
    ```python
    >>> import numpy as np
    >>> from vttig_jax import Gear, GearPair
    >>> from vttig_jax.geometry import fillet_span, tooth_of
    >>> gears = Gear(45, 3, 3, 20), Gear(80, 3, 3, 20)
    >>> pair = GearPair(*gears, module_mm=2.0, pressure_angles_deg=20.0)
    >>> np.degrees(fillet_span(tooth_of(pair, "driving"), "right")).round(3)
    array([3.836, 9.923])

    ```
    """
    root = rack_side(tooth, side).arc_roll(namespace(tooth).asarray(math.pi / 2))
    return namespace(tooth).stack([root, flank_span(tooth, side)[0]])
