"""Two mating flanks: driving flank points, and the driven angle at which the mate touches them.

A flank is the involute of the base circle with the roll angle u. It is rotated in every section by
the recession δ(z) and in every point by the deviation f:

    p = r_b (1 + jσu) exp(jσ(ψ − u)),    ψ = (π m/4 + x m tan α − δ(z))/R + inv α + f(u, z)/r_b

relative to the centre line of its tooth, seen from +z of the fixed frame, σ = 1 on flank A and −1
on flank B. No equation of meshing is used: first contact is an extreme over all points.
"""

import math

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from ...base.arrays import Number
from ...base.numerics.sincos import sincos
from ...pair.gear_pair import involute
from ..mounting import Mounting, Plane, Values
from ..tooth.recession import Recession
from ..tooth.tooth import Tooth
from .deviations import Bicubic

Scalar = Float[Number, ""]


class Flank(eqx.Module):
    """One flank of one gear; lengths in mm, angles in rad.

    **Arguments**
    - `base_radius`, `reference_radius`: r_b and R.
    - `base_half_angle`: ψ without recession and deviation.
    - `start`, `tip`: roll angles at the start of the flank and at the tip circle.
    - `recession`: δ(z) in the gear's own frame.
    - `map`: deviation of all teeth in µm over roll length and height, or None.
    - `pitch`: deviation of each tooth in µm, or None.
    """

    base_radius: Values
    reference_radius: Values
    base_half_angle: Values
    start: Values
    tip: Values
    recession: Recession
    map: Bicubic | None = None
    pitch: Float[Array, " teeth"] | None = None

    def half_angle(self, roll: Values, z: Values, tooth: Values) -> Values:
        """Return ψ, rad, at roll angles, rad, and heights, mm, on teeth counted from 0."""
        angle = self.base_half_angle - self.recession(z) / self.reference_radius
        if self.map is not None:
            roll, z = jnp.broadcast_arrays(roll, z)
            angle = angle + self.map(self.base_radius * roll, z) * (1e-3 / self.base_radius)
        if self.pitch is not None:
            index = jnp.mod(tooth, len(self.pitch)).astype(int)
            angle = angle + self.pitch[index] * (1e-3 / self.base_radius)
        return angle


class Pose(eqx.Module):
    """Position of the driving gear and of one tooth pair; arrays of equal rank, which broadcast.

    **Arguments**
    - `tooth_angle`: angle of the driving tooth's centre line from the line of centres, rad.
    - `tooth`: number of the driving tooth, 0 for the one between the axes at φ = 0.
    - `driving_centre`, `driven_centre`: centres of the base circles relative to the axes, mm.
    """

    tooth_angle: Values
    tooth: Values
    driving_centre: Plane
    driven_centre: Plane


class Reach(eqx.Module):
    """Position of the driven gear at which its flank touches a point of the driving flank.

    **Arguments**
    - `error`: TE at which the driven flank passes through the point, rad.
    - `radius`: distance of the point from the centre of the driven base circle, mm.
    - `roll`: roll angle of the driven flank at the point, rad.
    - `z`: height of the point in the fixed frame, mm.
    - `error_by_driven`, `radius_by_driven`: derivatives of φ₂ and of the radius with respect to the
      φ₂ that rotates the centre of the driven base circle.
    """

    error: Values
    radius: Values
    roll: Values
    z: Values
    error_by_driven: Values
    radius_by_driven: Values


class Mates(eqx.Module):
    """Flank A or flank B of both gears.

    **Arguments**
    - `sense`: σ, 1 for A and −1 for B.
    - `ratio`: i.
    - `pitch`: angle between neighbouring driving teeth, rad.
    - `driving`, `driven`: flanks of the two gears.
    - `standing`: constant part of φ₂ due to the zero of φ₂ and to the backlash, rad.
    """

    sense: Float[Array, ""]
    ratio: Float[Array, ""]
    pitch: Values
    driving: Flank
    driven: Flank
    standing: Values

    def reach(self, mounting: Mounting, pose: Pose, roll: Values, share: Values) -> Reach:
        """Return the driven position for a driving roll angle, rad, and share of the common face.

        φ₂ = standing + σ(ψ₂ − inv v) − arg(−w), where w is the point relative to the centre of the
        driven base circle and v = √(|w|²/r_b2² − 1) is the roll angle of this radius.
        """
        low, high = mounting.face()
        z = low + share * (high - low)
        if mounting.misalignment is not None:
            low, high = mounting.face(self._point(pose, roll, z))
            z = low + share * (high - low)
        x, y, driven_z = mounting.in_driven_frame(self._point(pose, roll, z), z)
        x, y = x - pose.driven_centre[0], y - pose.driven_centre[1]
        squared = x**2 + y**2
        roll_squared = squared / self.driven.base_radius**2 - 1
        outside = roll_squared > 0
        driven_roll = jnp.where(outside, jnp.sqrt(jnp.where(outside, roll_squared, 1.0)), 0.0)
        # The argument of (1 + jσv)·conj(−w) is −arg(−w) plus the arc tangent in inv v.
        signed_roll = self.sense * driven_roll
        real, imaginary = -x - signed_roll * y, y - signed_roll * x
        half = self.driven.half_angle(driven_roll, driven_z, self.driven_tooth(pose.tooth))
        angle = self.standing + self.sense * (half - driven_roll) + jnp.arctan2(imaginary, real)
        along, across = pose.driven_centre
        radius = jnp.sqrt(squared)
        return Reach(
            error=angle - self.ratio * pose.tooth_angle,
            radius=radius,
            roll=driven_roll,
            z=z,
            error_by_driven=(real * along - imaginary * across) / squared,
            radius_by_driven=(y * along - x * across) / radius,
        )

    def driven_tooth(self, number: Values) -> Values:
        """Return the number of the driven tooth that touches the driving tooth `number`.

        It is the same number on flank A and the next number on flank B.
        """
        return number + (1 - self.sense) / 2

    def _point(self, pose: Pose, roll: Values, z: Values) -> Plane:
        half = self.driving.half_angle(roll, z, pose.tooth)
        sine, cosine = sincos(pose.tooth_angle + self.sense * (half - roll))
        base, signed_roll = self.driving.base_radius, self.sense * roll
        x, y = base * (cosine - signed_roll * sine), base * (sine + signed_roll * cosine)
        return x + pose.driving_centre[0], y + pose.driving_centre[1]


def flank_of(tooth: Tooth, index: int, start: Scalar, **deviations) -> Flank:
    """Return the flank of one side (0 left, 1 right) of a gear.

    `start` is the roll angle at the start of the flank, rad; `deviations` are `map` and `pitch`.
    """
    alpha, base = jnp.asarray(tooth.pressure_angles[index]), jnp.asarray(tooth.base_radii[index])
    arc = math.pi * tooth.module_mm / 4 + tooth.profile_shift_mm * jnp.tan(alpha)
    return Flank(
        base_radius=base,
        reference_radius=jnp.asarray(tooth.reference_radius),
        base_half_angle=jnp.asarray(arc / tooth.reference_radius + involute(alpha)),
        start=jnp.asarray(start),
        tip=jnp.sqrt((tooth.tip_radius / base) ** 2 - 1),
        recession=tooth.recession[index],
        **deviations,
    )
