"""Closed forms of transmission error and backlash of an eccentric pair, (17)–(22) of the paper."""

from typing import Literal

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ..base.arrays import Numbers
from ..base.units import DEG
from ..pair.gear_pair import Eccentricities, GearPair
from .flank_table import FirstOrderBounds

PressureAngle = Literal["working", "reference"]


def closed_model(
    pair: GearPair,
    eccentricities: Eccentricities,
    *,
    pressure_angle: PressureAngle = "working",
) -> FirstOrderBounds:
    """Return the first-order flank model of a gear pair with these eccentricities.

    With K = 1/r_b2, ψ₁ = φ₁ + θ₁, χ₂ = i φ₁ + θ₂ and the transverse pressure angle α:

        TE_A = K [e₁ sin(ψ₁ + α) + e₂ sin(χ₂ − α)] + s tan β_L / R₂
        TE_B = K [e₁ sin(ψ₁ − α) + e₂ sin(χ₂ + α)] − s tan β_R / R₂ + j_c

    `pressure_angle` selects α: "working" is α_w at the nominal centre distance and is five times
    closer to the exact relation; "reference" is αₜ of the drawing, as in the paper. K is always
    1/r_b2.
    """
    if pressure_angle not in ("working", "reference"):
        raise ValueError(
            'Argument `pressure_angle` must be "working" or "reference", but is'
            f" {pressure_angle!r}."
        )
    working = pressure_angle == "working"
    alpha = pair.working_pressure_angles if working else pair.pressure_angles_deg * DEG
    driving, driven = eccentricities.cartesian
    turn = jnp.exp(1j * alpha * jnp.array([1.0, -1.0]))
    # Im[p exp(jφ)] = p_r sin φ + p_i cos φ
    phasors = jnp.stack([driving * turn, driven / turn], axis=1) / pair.base_radii[1][:, None]
    return FirstOrderBounds(
        ratio=float(pair.ratio),
        offset=flank_offsets(pair, eccentricities),
        cosine=jnp.imag(phasors),
        sine=jnp.real(phasors),
        closing=pair.taper / pair.reference_radii[1],
    )


def flank_offsets(pair: GearPair, eccentricities: Eccentricities) -> Float[Numbers, "2"]:
    """Return the part of TE_A and TE_B due to constant backlash and axial displacement, rad."""
    slopes = pair.taper * np.array([1.0, -1.0])
    shift = eccentricities.axial_mm * slopes / pair.reference_radii[1]
    return shift + np.array([0.0, 1.0]) * (eccentricities.constant_backlash_deg * DEG)
