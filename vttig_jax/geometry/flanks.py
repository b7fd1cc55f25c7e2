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
import numpy as np
from jaxtyping import Array, Float

from ..base.arrays import Numbers, known
from ..base.errors import PairError
from ..base.numerics.sincos import sincos
from .deviations import Bicubic, Deviations
from .form import form_radius, undercut_depth
from .mounting import Mounting, Plane, Values
from .surface import rack_side
from .tooth import SHAFTS, SIDES, Recession, Scalar, Tooth


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
    map: Bicubic | None
    pitch: Float[Array, " teeth"] | None

    @property
    def limits(self) -> Array:
        """Roll angles, rad, at the start, at the tip and, if there is a map, at both its ends."""
        ends = [] if self.map is None else [*self.map.roll[jnp.array([0, -1])] / self.base_radius]
        return jnp.stack([jnp.asarray(end) for end in (self.start, self.tip, *ends)])

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

    def pose(self, mounting: Mounting, driving: Values, driven: Values, tooth: Values) -> Pose:
        """Return the position of tooth pairs at driving and driven angles, rad."""
        centres = mounting.driving_centre(driving), mounting.driven_centre(driven)
        return Pose(driving - tooth * self.pitch, tooth, *centres)

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


def mates_of(
    teeth: tuple[Tooth, Tooth],
    starts: Float[Numbers, "gear=2 flank=2"],
    ratio: Float[Array, ""],
    deviations: Deviations | None,
    side: int,
) -> Mates:
    """Return the flanks A (`side` 0) or B (1) of both gears; their `standing` is still 0."""
    deviations, flanks = deviations or Deviations(), []
    for gear, (tooth, shaft) in enumerate(zip(teeth, SHAFTS, strict=True)):
        index = 1 - side if gear else side
        base = jnp.asarray(tooth.base_radii[index])
        flank_map = getattr(deviations, shaft)[side]
        pitch = getattr(deviations, f"{shaft}_pitch_um")
        flank = Flank(
            base_radius=base,
            reference_radius=jnp.asarray(tooth.reference_radius),
            base_half_angle=jnp.asarray(tooth.base_half_angles[index]),
            start=jnp.asarray(starts[gear, side]),
            tip=jnp.sqrt((tooth.tip_radius / base) ** 2 - 1),
            recession=tooth.recession[index],
            map=None if flank_map is None else flank_map.prepared(),
            pitch=None if pitch is None else jnp.asarray(pitch)[side],
        )
        flanks.append(flank)
    pitch = jnp.asarray(2 * math.pi / teeth[0].teeth)
    return Mates(jnp.asarray(1.0 - 2.0 * side), ratio, pitch, *flanks, standing=jnp.zeros(()))


def flank_starts(teeth: tuple[Tooth, Tooth]) -> Float[Numbers, "gear=2 flank=2"]:
    """Return roll angles √(r²/r_b² − 1), rad, at form circles; rows gears, columns flanks A and B.

    An undercut flank begins where the fillet cuts it; if numbers are traced, on the base circle.

    **Raises** `PairError` if an undercut removes a flank completely.
    """
    xp = np if known(teeth) else jnp
    starts = []
    for gear, flank in np.ndindex(2, 2):
        tooth, index = teeth[gear], flank if gear == 0 else 1 - flank
        side, base = SIDES[index], tooth.base_radii[index]
        if known(tooth) and undercut_depth(tooth, side) > 0:
            radius = form_radius(tooth, side)
            if np.isnan(radius):
                raise PairError(
                    f"undercut removes the whole {side} flank; give more teeth or profile shift.",
                    where=SHAFTS[gear],
                )
            starts.append(np.sqrt(max((radius / float(base)) ** 2 - 1, 0.0)))
        else:
            starts.append(xp.maximum(rack_side(tooth, side).joint_length, 0.0) / base)
    return xp.stack([xp.asarray(start) for start in starts]).reshape(2, 2)


def pitch_point(mates: Mates, distance: Scalar) -> tuple[Values, Values]:
    """Return the driving roll angle at the pitch point of concentric gears, and its tooth angle.

    The latter is the angle from the line of centres to the driving tooth that touches there on
    flank A; both in rad.
    """
    driving = mates.driving
    alpha = jnp.arccos((driving.base_radius + mates.driven.base_radius) / distance)
    half = driving.base_half_angle - driving.recession(jnp.zeros(())) / driving.reference_radius
    return jnp.tan(alpha), jnp.tan(alpha) - alpha - half


def concentric_touch(mates: Mates, distance: Scalar) -> Values:
    """Return TE, rad, at which the flanks of concentric gears touch at their pitch point.

    The gears are as drawn with s = 0 in the section z = 0. The value defines the zero of φ₂ and the
    start of the search; the search does not assume that TE is constant along the path of contact.
    """
    (roll, angle), zero = pitch_point(mates, distance), jnp.zeros(())
    centre = zero.astype(complex)
    mounting = Mounting(distance, zero, centre, centre, jnp.full(2, jnp.nan))
    pose = Pose(mates.sense * angle, zero, (zero, zero), (zero, zero))
    return mates.reach(mounting, pose, roll, zero).error
