"""Base helix angles, base half angles and chordal thickness of a tooth, on arrays."""

import math

import numpy as np
from jaxtyping import Float

from ...base.arrays import Numbers, namespace
from ...pair.gear_pair import involute
from ..tooth.tooth import Tooth


def recession_slopes(tooth: Tooth, z: Float[Numbers, "*shape"]) -> Float[Numbers, "*shape 2"]:
    """Return the slope dδ/dz of the left and the right flank at height z (mm).

    For a straight flank it is tan β. It is positive if the tooth becomes thinner towards +z. The
    slope is a central difference with a step of a thousandth of the module, which is exact for
    straight and for crowned flanks.
    """
    step = 1e-3 * tooth.module_mm
    return (tooth.recessions(z + step) - tooth.recessions(z - step)) / (2 * step)


def base_helix_angles(tooth: Tooth, z: Float[Numbers, "*shape"]) -> Float[Numbers, "*shape 2"]:
    """Return the base helix angles of the left and the right flank at height z, rad.

        tan β_b = (r_b/R) dδ/dz

    They are positive if the tooth becomes thinner towards +z; the left flank is then left-handed
    and the right flank right-handed.
    """
    xp, slopes = namespace(tooth, z), recession_slopes(tooth, z)
    ratio = xp.broadcast_to(tooth.base_radii / tooth.reference_radius, slopes.shape)
    return xp.arctan(ratio * slopes)


def base_half_angles(tooth: Tooth, z: Float[Numbers, "*shape"]) -> Float[Numbers, "*shape 2"]:
    """Return the half angles of the tooth on the base circles at height z (mm), rad.

        ψ_b(z) = (π m/4 + x m tan αₜ − δ(z))/R + inv αₜ

    They are the angles from the centre line of the tooth to its left and its right flank, each on
    the base circle of this flank. x m is the profile shift, R the reference radius and δ the
    recession of the flank, all in mm. See `Tooth.half_angles` for other radii.
    """
    radius = tooth.reference_radius + 0 * z
    angles = tooth.half_angles(radius, z)
    reference = involute(tooth.pressure_angles)
    return angles + namespace(reference).broadcast_to(reference, angles.shape)


def radius_where(base_radii: Float[Numbers, "2"], total: float) -> float | None:
    """Return the radius, mm, at which the involute functions of two flanks have a given sum, rad.

        inv α_L(r) + inv α_R(r) = total,    cos α(r) = r_b/r

    Return None if the total is less than the sum at the larger base circle.
    """
    from scipy.optimize import root_scalar

    base_radii = np.asarray(base_radii)
    largest = float(base_radii.max())

    def excess(roll: float) -> float:
        """Return the sum minus the total at a roll angle, rad, of the larger base circle."""
        tangents = np.sqrt((1 + roll**2) * (largest / base_radii) ** 2 - 1)
        return float((tangents - np.arctan(tangents)).sum()) - total

    if not excess(0.0) <= 0.0:
        return None
    # At the upper limit inv α > tan α − π/2 of the larger base circle alone exceeds the total.
    solution = root_scalar(excess, bracket=(0.0, total + math.pi / 2), xtol=1e-14, rtol=1e-14)
    return largest * math.hypot(1.0, solution.root)


def chordal_thickness(
    tooth: Tooth, radius: Float[Numbers, "*shape"], z: Float[Numbers, "*shape"]
) -> Float[Numbers, "*shape"]:
    """Return the chordal thickness 2 r sin(ψ_L/2 + ψ_R/2), mm, at a radius and height z, mm."""
    return 2 * radius * namespace(tooth, radius, z).sin(_mean_angles(tooth, radius, z))


def chordal_height(
    tooth: Tooth, radius: Float[Numbers, "*shape"], z: Float[Numbers, "*shape"]
) -> Float[Numbers, "*shape"]:
    """Return the height r_a − r cos(ψ_L/2 + ψ_R/2), mm, of the tip circle above the chord."""
    cosines = namespace(tooth, radius, z).cos(_mean_angles(tooth, radius, z))
    return tooth.tip_radius - radius * cosines


def _mean_angles(
    tooth: Tooth, radius: Float[Numbers, "*shape"], z: Float[Numbers, "*shape"]
) -> Float[Numbers, "*shape"]:
    return tooth.half_angles(radius, z).sum(axis=-1) / 2
