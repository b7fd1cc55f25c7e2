"""Exact flank model of two eccentric involute gears, without small-angle approximation."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float

from ..base.arrays import Numbers
from ..base.numerics.sincos import sincos
from ..pair.gear_pair import Eccentricities, Flank, GearPair
from .first_order import flank_offsets
from .flank_model import FIRST_ORDERS, Angles, GridOrders, ImplicitModel, flank_index


class ExactModel(ImplicitModel):
    """Flank model from the common tangent of the two moving base circles.

    C₁, C₂ are the base-circle centres, a = |C₂ − C₁|, δ is the angle from the line between the
    rotation axes to C₁→C₂, and Δinv = inv α_w(a) − inv α_w(a₀) with the nominal centre distance a₀
    and cos α_w(a) = (r_b1 + r_b2)/a. Then

        TE_A = −(1 + i)(δ + Δinv) + s tan β_L / R₂
        TE_B = −(1 + i)(δ − Δinv) − s tan β_R / R₂ + j_c

    Both centres are taken at the actual gear angles: C₂ turns with φ₂ = i φ₁ + TE, so the relation
    is implicit.
    """

    ratio: Float[Numbers, ""]
    centre_distance: Float[Array, ""]
    base_sum: Float[Numbers, "2"]
    driving_offset: Complex[Array, ""]
    driven_offset: Complex[Array, ""]
    offset: Float[Numbers, "2"]

    @property
    def grid_orders(self) -> GridOrders:
        """First orders of both shafts."""
        return FIRST_ORDERS

    def at_both_angles(self, driving_angle: Angles, driven_angle: Angles, flank: Flank) -> Angles:
        """Return TE of `flank`, rad, for given angles of both shafts."""
        side = flank_index(flank)
        sense = 1.0 if side == 0 else -1.0
        return self.offset[side] + self.turned(
            driving_angle, driven_angle, self.base_sum[side], sense
        )

    def turned(self, driving_angle, driven_angle, base_sum, sense):
        """Return −(1 + i)(δ + sense·Δinv), rad; `base_sum` is r_b1 + r_b2 of the flank, mm.

        Angles are in rad. `sense` is 1 for flank A and −1 for flank B. All arguments broadcast.
        """
        driving = turned_offset(self.driving_offset, driving_angle)
        driven = turned_offset(self.driven_offset, driven_angle)
        along = self.centre_distance + driven[0] - driving[0]
        across = -driven[1] - driving[1]
        opening = _involute(along**2 + across**2, base_sum) - _involute(
            self.centre_distance**2, base_sum
        )
        return -(1 + self.ratio) * (jnp.arctan2(across, along) + sense * opening)


def exact_model(pair: GearPair, eccentricities: Eccentricities) -> ExactModel:
    """Return the exact flank model of a gear pair with these eccentricities."""
    driving, driven = eccentricities.cartesian
    return ExactModel(
        ratio=np.asarray(float(pair.ratio)),
        centre_distance=jnp.asarray(pair.centre_distance_mm),
        base_sum=pair.base_radii.sum(axis=0),
        driving_offset=driving,
        driven_offset=driven,
        offset=flank_offsets(pair, eccentricities),
    )


def turned_offset(offset: Complex[Array, ""], angle: Angles):
    """Return the real and imaginary part of offset · exp(j angle)."""
    sine, cosine = sincos(angle)
    real, imaginary = jnp.real(offset), jnp.imag(offset)
    return real * cosine - imaginary * sine, real * sine + imaginary * cosine


def _involute(squared_distance, base_sum):
    """Return inv α_w = tan α_w − α_w for a² and r_b1 + r_b2; tan α_w = √(a²/(r_b1 + r_b2)² − 1)."""
    tangent = jnp.sqrt(squared_distance / base_sum**2 - 1)
    return tangent - jnp.arctan(tangent)
