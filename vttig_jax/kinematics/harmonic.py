"""Harmonic flank models: Fourier series in both shaft angles, alone or added to the exact model."""

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..base.arrays import Numbers
from ..base.numerics.sincos import sincos
from ..pair.gear_pair import Flank
from .exact import ExactModel
from .flank_model import Angles, GridOrders, ImplicitModel, flank_index

Term = tuple[int, int]
"""Orders (n₁, n₂) of one harmonic with phase n₁ φ₁ + n₂ φ₂; (k z₁, 0) for tooth-mesh order k."""

_MOST_STEPS = 20  # most Newton steps to the driven angle; chosen value, three are needed
_SETTLED = 1e-9
"""Size of the last Newton step, rad (chosen). The remaining error is about its square, which is
below the rounding error."""


class OrderModel(ImplicitModel):
    """Fourier series of the transmission error in both shaft angles, one for each flank.

        TE_f = offset_f + Σ_t [cosine_ft cos(n₁ φ₁ + n₂ φ₂) + sine_ft sin(n₁ φ₁ + n₂ φ₂)]

    **Arguments**
    - `ratio`: i = z₁/z₂.
    - `terms`: the orders (n₁, n₂) of every harmonic.
    - `offset`: constant terms of flanks A and B, rad, shape (2,).
    - `cosine`, `sine`: coefficients, rad, shape (2, len(terms)).
    """

    ratio: Float[Numbers, ""]
    terms: tuple[Term, ...] = eqx.field(static=True)
    offset: Float[Array, "2"]
    cosine: Float[Array, "2 terms"]
    sine: Float[Array, "2 terms"]

    @property
    def grid_orders(self) -> GridOrders:
        """Orders of the terms."""
        return self.terms

    def at_both_angles(self, driving_angle: Angles, driven_angle: Angles, flank: Flank) -> Angles:
        """Return TE of `flank`, rad, for given angles of both shafts."""
        side = flank_index(flank)
        if not self.terms:
            return self.offset[side] + 0.0 * driven_angle
        orders = jnp.asarray(self.terms, driven_angle.dtype).T
        driving, driven = orders.reshape(2, *(1,) * driven_angle.ndim, -1)
        phase = driving_angle[..., None] * driving + driven_angle[..., None] * driven
        sine, cosine = sincos(phase)
        return self.offset[side] + cosine @ self.cosine[side] + sine @ self.sine[side]


class CombinedModel(ImplicitModel):
    """Sum of the exact and the harmonic TE, both at the actual angles of the gears."""

    ratio: Float[Numbers, ""]
    exact: ExactModel
    orders: OrderModel

    @property
    def grid_orders(self) -> GridOrders:
        """Orders of both parts."""
        return *self.exact.grid_orders, *self.orders.grid_orders

    def at_both_angles(self, driving_angle: Angles, driven_angle: Angles, flank: Flank) -> Angles:
        """Return TE of `flank`, rad, for given angles of both shafts."""
        parts = self.exact, self.orders
        exact, orders = (p.at_both_angles(driving_angle, driven_angle, flank) for p in parts)
        return exact + orders


def linearised_series(
    ratio: float,
    terms: tuple[tuple[int, int], ...],
    coefficients: Sequence[Any],
    driving_angle: Float[np.ndarray, " n"],
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, "n c"]]:
    """Return TE of a harmonic series, rad, and its derivatives by all coefficients.

    `terms` are the orders (n₁, n₂) of the harmonics, as in `OrderModel`. `coefficients` are the
    offset, the cosines and the sines of one flank, rad. NumPy finds the driven angle by Newton
    steps, so that JAX need not compile a program for each number of angles.
    """
    offset, cosine, sine = coefficients
    orders = np.asarray(terms, float).reshape(-1, 2)
    ideal = np.outer(driving_angle, orders[:, 0]) + np.outer(ratio * driving_angle, orders[:, 1])
    error, steps = np.zeros(len(ideal)), 0
    while True:
        phase = ideal + np.outer(error, orders[:, 1])
        in_phase, quadrature = np.cos(phase), np.sin(phase)
        slope = in_phase @ (sine * orders[:, 1]) - quadrature @ (cosine * orders[:, 1])
        step = (offset + in_phase @ cosine + quadrature @ sine - error) / (1.0 - slope)
        error, steps = error + step, steps + 1
        moved = np.abs(step).max(initial=0.0)
        if not moved > _SETTLED or steps == _MOST_STEPS:  # `not >` also ends the loop for NaN
            break
    basis = np.concatenate([np.ones((len(ideal), 1)), in_phase, quadrature], axis=1)
    return error, basis / (1.0 - slope)[:, None]
