"""The two flanks that meet: where a point of one stands, and how far the other must turn to it.

A flank is the involute as the end of a string that unwinds from the base circle by the roll angle
u, in every section turned by the recession δ(z), point by point by the deviation:

    p = r_b (1 + jσu) exp(jσ(ψ − u)),    ψ = (π m/4 + x m tan α − δ(z))/R + inv α + f(u, z)/r_b

about the centre line of its tooth, seen from the +z of the fixed frame, σ = 1 on flank A and −1 on
flank B. No meshing is in here: first touch is an extreme over all points.
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
    """One flank of one gear; lengths in mm.

    **Arguments**
    - `base_radius`, `reference_radius`: r_b and R.
    - `foot`: ψ where nothing recedes or deviates, rad.
    - `start`, `tip`: roll angles at which the flank begins and where it meets the tip circle.
    - `recession`: δ(z) in the gear's own frame.
    - `map`: the deviation of all teeth in µm over roll length and height, or None.
    - `pitch`: the deviation of each tooth in µm, or None.
    """

    base_radius: Values
    reference_radius: Values
    foot: Values
    start: Values
    tip: Values
    recession: Recession
    map: Bicubic | None = None
    pitch: Float[Array, " teeth"] | None = None

    def half_angle(self, roll: Values, z: Values, tooth: Values) -> Values:
        """ψ at roll angles and heights on teeth with these numbers, counted from 0."""
        found = self.foot - self.recession(z) / self.reference_radius
        if self.map is not None:
            roll, z = jnp.broadcast_arrays(roll, z)
            found = found + self.map(self.base_radius * roll, z) * (1e-3 / self.base_radius)
        if self.pitch is not None:
            own = jnp.mod(tooth, len(self.pitch)).astype(int)
            found = found + self.pitch[own] * (1e-3 / self.base_radius)
        return found


class Pose(eqx.Module):
    """A position of the driving gear with one pair of teeth chosen; arrays broadcast.

    **Arguments**
    - `turned`: angle of the driving tooth's centre line from the line of centres, rad.
    - `tooth`: number of the driving tooth, 0 for the one between the axes at φ = 0.
    - `driving_centre`, `driven_centre`: of the base circles, from the axes, mm.
    """

    turned: Values
    tooth: Values
    driving_centre: Plane
    driven_centre: Plane


class Reach(eqx.Module):
    """What the driven gear has to do to bring its flank to a point of the driving flank.

    **Arguments**
    - `error`: TE at which its flank passes through the point, rad.
    - `radius`: distance of the point from the centre of the driven base circle, mm.
    - `roll`: roll angle of the driven flank there.
    - `z`: height of the point in the fixed frame.
    - `lag`, `drift`: ∂φ₂/∂φ₂ and ∂radius/∂φ₂ through the centre of the driven base circle, which
      turns with φ₂.
    """

    error: Values
    radius: Values
    roll: Values
    z: Values
    lag: Values
    drift: Values


class Mates(eqx.Module):
    """Flank A or flank B of both gears.

    **Arguments**
    - `sense`: σ, 1 for A and −1 for B.
    - `ratio`: i.
    - `pitch`: angle from one driving tooth to the next.
    - `standing`: rad of the driven gear by which its flank stands on.
    """

    sense: Float[Array, ""]
    ratio: Float[Array, ""]
    pitch: Values
    driving: Flank
    driven: Flank
    standing: Values

    def reach(self, mounting: Mounting, pose: Pose, roll: Values, share: Values) -> Reach:
        """Point of the driving flank at a roll angle and a share of the common face, and its mate.

        φ₂ = standing + σ(ψ₂ − inv v) − arg(−w), with w the point seen from the centre of the driven
        base circle and v = √(|w|²/r_b2² − 1) the roll angle that has this radius.
        """
        low, high = mounting.face()
        z = low + share * (high - low)
        if mounting.misalignment is not None:
            low, high = mounting.face(self._point(pose, roll, z))
            z = low + share * (high - low)
        x, y, own_z = mounting.seen_from_driven(self._point(pose, roll, z), z)
        x, y = x - pose.driven_centre[0], y - pose.driven_centre[1]
        squared = x**2 + y**2
        unwound = squared / self.driven.base_radius**2 - 1
        beyond = unwound > 0
        mate = jnp.where(beyond, jnp.sqrt(jnp.where(beyond, unwound, 1.0)), 0.0)
        # h = (1 + jσv)·conj(−w) holds arg(−w) and the arc tangent of inv v in one angle.
        real, imaginary = -x - self.sense * mate * y, y - self.sense * mate * x
        half = self.driven.half_angle(mate, own_z, self.driven_tooth(pose.tooth))
        angle = self.standing + self.sense * (half - mate) + jnp.arctan2(imaginary, real)
        along, across = pose.driven_centre
        radius = jnp.sqrt(squared)
        return Reach(
            error=angle - self.ratio * pose.turned,
            radius=radius,
            roll=mate,
            z=z,
            lag=(real * along - imaginary * across) / squared,
            drift=(y * along - x * across) / radius,
        )

    def driven_tooth(self, number: Values) -> Values:
        """Number of the driven tooth that meets a driving one: on flank B the next."""
        return number + (1 - self.sense) / 2

    def _point(self, pose: Pose, roll: Values, z: Values) -> Plane:
        half = self.driving.half_angle(roll, z, pose.tooth)
        sine, cosine = sincos(pose.turned + self.sense * (half - roll))
        base, string = self.driving.base_radius, self.sense * roll
        x, y = base * (cosine - string * sine), base * (sine + string * cosine)
        return x + pose.driving_centre[0], y + pose.driving_centre[1]


def flank_of(tooth: Tooth, index: int, start: Scalar, **deviations) -> Flank:
    """Flank of one side (0 left, 1 right) of a gear."""
    alpha, base = jnp.asarray(tooth.pressure_angles[index]), jnp.asarray(tooth.base_radii[index])
    arc = math.pi * tooth.module_mm / 4 + tooth.profile_shift_mm * jnp.tan(alpha)
    return Flank(
        base_radius=base,
        reference_radius=jnp.asarray(tooth.reference_radius),
        foot=jnp.asarray(arc / tooth.reference_radius + involute(alpha)),
        start=jnp.asarray(start),
        tip=jnp.sqrt((tooth.tip_radius / base) ** 2 - 1),
        recession=tooth.recession[index],
        **deviations,
    )
