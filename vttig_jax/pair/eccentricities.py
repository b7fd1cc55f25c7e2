"""Eccentricities of both gears and the constant backlash: the errors of an individual rig."""

from __future__ import annotations

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Complex, Float

from ..base.arrays import Number, float64, written
from ..base.units import DEG

Scalar = Float[Number, ""]


class Eccentricities(eqx.Module):
    """Offsets of the base-circle centres from the rotation axes, and the constant backlash j_c.

    **Arguments**
    - `driving_mm`, `driven_mm`: eccentricities e₁, e₂ in mm.
    - `driving_phase_deg`, `driven_phase_deg`: angles θ₁, θ₂ in degrees from the line of centres to
      the offset at φ = 0, each positive in the direction in which its gear turns for positive φ.
    - `constant_backlash_deg`: backlash j_c for e₁ = e₂ = 0, in degrees of the driven gear.
    - `axial_mm`: axial displacement s of the driven gear in mm, positive towards the end of the
      face where the teeth of the driving gear are thick.
    """

    driving_mm: Scalar = eqx.field(converter=float64, default=0.0)
    driving_phase_deg: Scalar = eqx.field(converter=float64, default=0.0)
    driven_mm: Scalar = eqx.field(converter=float64, default=0.0)
    driven_phase_deg: Scalar = eqx.field(converter=float64, default=0.0)
    constant_backlash_deg: Scalar = eqx.field(converter=float64, default=0.0)
    axial_mm: Scalar = eqx.field(converter=float64, default=0.0)

    __repr__ = written

    @property
    def cartesian(self) -> tuple[Complex[Array, ""], Complex[Array, ""]]:
        """Offsets e·exp(jθ) of the driving and the driven gear in mm."""
        return (
            jnp.asarray(self.driving_mm) * jnp.exp(1j * DEG * self.driving_phase_deg),
            jnp.asarray(self.driven_mm) * jnp.exp(1j * DEG * self.driven_phase_deg),
        )
