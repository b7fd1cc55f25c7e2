"""Measures of one tooth on arrays: the chord a tooth caliper takes, base helices, base angles."""

import math

import numpy as np
from jaxtyping import Float

from ...base.arrays import Numbers, namespace
from ...pair.gear_pair import involute
from ..tooth.tooth import Tooth


def recession_slopes(tooth: Tooth, z: Float[Numbers, "*shape"]) -> Float[Numbers, "*shape 2"]:
    """Slope dδ/dz of the left and the right flank at height z: tan β of a straight flank.

    Positive where the flank thins the tooth towards +z. A central difference over a thousandth of
    the module: exact for flanks that are straight or crowned.
    """
    step = 1e-3 * tooth.module_mm
    return (tooth.recessions(z + step) - tooth.recessions(z - step)) / (2 * step)


def base_helix_angles(tooth: Tooth, z: Float[Numbers, "*shape"]) -> Float[Numbers, "*shape 2"]:
    """Base helix angles of the left and the right flank at height z, rad.

        tan β_b = (r_b/R) dδ/dz

    Positive where the flank thins the tooth towards +z: then the left flank is left-handed and the
    right one right-handed.
    """
    share = tooth.base_radii / tooth.reference_radius
    return namespace(tooth, z).arctan(share * recession_slopes(tooth, z))


def base_half_angles(tooth: Tooth, z: Float[Numbers, "*shape"]) -> Float[Numbers, "*shape 2"]:
    """Angles from the centre line of the tooth to the feet of its flanks on the base circles, rad.

    ψ_b(z) = (π m/4 + x m tan αₜ − δ(z))/R + inv αₜ
    """
    radius = tooth.reference_radius + 0 * z
    return tooth.half_angles(radius, z) + involute(tooth.pressure_angles)


def radius_where(base_radii: Float[Numbers, "2"], total: float) -> float | None:
    """The radius where the involute functions of two flanks sum to a total, mm.

        inv α_L(r) + inv α_R(r) = total,    cos α(r) = r_b/r

    None where the total is less than that at the larger base circle.
    """
    from scipy.optimize import root_scalar

    base_radii = np.asarray(base_radii)
    largest = float(base_radii.max())

    def excess(roll: float) -> float:
        """`roll` is the roll length on the larger base circle over its radius."""
        tangents = np.sqrt((1 + roll**2) * (largest / base_radii) ** 2 - 1)
        return float((tangents - np.arctan(tangents)).sum()) - total

    if not excess(0.0) <= 0.0:
        return None
    # inv α > tan α − π/2, so that of the larger base circle alone has passed the total there.
    found = root_scalar(excess, bracket=(0.0, total + math.pi / 2), xtol=1e-14, rtol=1e-14)
    return largest * math.hypot(1.0, found.root)


def chordal_thickness(
    tooth: Tooth, radius: Float[Numbers, "*shape"], z: Float[Numbers, "*shape"]
) -> Float[Numbers, "*shape"]:
    """Chord of the circle of a radius inside the tooth at height z, mm.

    2 r sin(ψ_L/2 + ψ_R/2)
    """
    return 2 * radius * namespace(tooth, radius, z).sin(_mean_angles(tooth, radius, z))


def chordal_height(
    tooth: Tooth, radius: Float[Numbers, "*shape"], z: Float[Numbers, "*shape"]
) -> Float[Numbers, "*shape"]:
    """Height of the tip circle above that chord, mm.

    r_a − r cos(ψ_L/2 + ψ_R/2)
    """
    cosines = namespace(tooth, radius, z).cos(_mean_angles(tooth, radius, z))
    return tooth.tip_radius - radius * cosines


def _mean_angles(
    tooth: Tooth, radius: Float[Numbers, "*shape"], z: Float[Numbers, "*shape"]
) -> Float[Numbers, "*shape"]:
    return tooth.half_angles(radius, z).sum(axis=-1) / 2
