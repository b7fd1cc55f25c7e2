"""Closed forms of transmission error and backlash of an eccentric pair, (17)–(22) of the paper."""

from typing import Literal

import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Complex, Float, Real

from ..base.arrays import Numbers
from ..base.numerics.sincos import sincos
from ..base.units import DEG
from ..pair.gear_pair import Eccentricities, Flank, GearPair
from .flank_model import FIRST_ORDERS, FlankModel, GridOrders, flank_index

PressureAngle = Literal["working", "reference"]


class ClosedModel(FlankModel):
    """Flank model of first order in the eccentricities.

    With K = 1/r_b2, ψ₁ = φ₁ + θ₁, χ₂ = i φ₁ + θ₂ and the transverse pressure angle α:

        TE_A = K [e₁ sin(ψ₁ + α) + e₂ sin(χ₂ − α)] + s tan β_L / R₂
        TE_B = K [e₁ sin(ψ₁ − α) + e₂ sin(χ₂ + α)] − s tan β_R / R₂ + j_c

    TE of each flank is a constant plus the imaginary parts of two phasors, one for each shaft.
    """

    ratio: Float[Numbers, ""]
    driving_phasor: Complex[Array, "2"]
    driven_phasor: Complex[Array, "2"]
    offset: Float[Numbers, "2"]

    @property
    def grid_orders(self) -> GridOrders:
        """First orders of both shafts."""
        return FIRST_ORDERS

    def transmission_error(
        self, driving_angle: Real[ArrayLike, "*shape"], flank: Flank
    ) -> Float[Array, "*shape"]:
        """Return TE of `flank`, rad, by the equation of the class."""
        side = flank_index(flank)
        angle = jnp.asarray(driving_angle, float)
        return (
            _imaginary(self.driving_phasor[side], angle)
            + _imaginary(self.driven_phasor[side], jnp.asarray(self.ratio) * angle)
            + self.offset[side]
        )


def closed_model(
    pair: GearPair,
    eccentricities: Eccentricities,
    *,
    pressure_angle: PressureAngle = "working",
) -> ClosedModel:
    """Return the first-order flank model of a gear pair with these eccentricities.

    `pressure_angle` selects α: "working" is α_w at the nominal centre distance and is five times
    closer to the exact relation; "reference" is αₜ of the drawing, as in the paper. K is always
    1/r_b2.
    """
    if pressure_angle not in ("working", "reference"):
        raise ValueError(
            'Argument `pressure_angle` must be "working" or "reference", but is'
            f" {pressure_angle!r}."
        )
    alpha = (
        pair.working_pressure_angles
        if pressure_angle == "working"
        else pair.pressure_angles_deg * DEG
    )
    driving, driven = eccentricities.cartesian
    turn = jnp.exp(1j * alpha * jnp.array([1.0, -1.0]))
    scale = 1 / pair.base_radii[1]
    return ClosedModel(
        ratio=np.asarray(float(pair.ratio)),
        driving_phasor=scale * driving * turn,
        driven_phasor=scale * driven / turn,
        offset=flank_offsets(pair, eccentricities),
    )


def flank_offsets(pair: GearPair, eccentricities: Eccentricities) -> Float[Numbers, "2"]:
    """Return the part of TE_A and TE_B due to constant backlash and axial displacement, rad."""
    slopes = pair.taper * np.array([1.0, -1.0])
    shift = eccentricities.axial_mm * slopes / pair.reference_radii[1]
    return shift + np.array([0.0, 1.0]) * (eccentricities.constant_backlash_deg * DEG)


def _imaginary(phasor: Complex[Array, ""], angle: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
    """Return Im[phasor · exp(j angle)]."""
    sine, cosine = sincos(angle)
    return jnp.real(phasor) * sine + jnp.imag(phasor) * cosine
