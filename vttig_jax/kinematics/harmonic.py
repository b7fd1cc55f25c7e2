"""Harmonic flank models: harmonics of both shafts and of the mesh, or on the exact relation."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..base.numerics.sincos import sincos
from ..pair.gear_pair import Flank
from .exact import ExactModel
from .flank_model import ImplicitModel, flank_index

Term = tuple[int, int]
"""Orders (n₁, n₂) of one harmonic: it turns with n₁ φ₁ + n₂ φ₂. Tooth mesh k is (k z₁, 0)."""


class OrderModel(ImplicitModel):
    """Harmonics of both shaft angles on each flank.

        TE_f = offset_f + Σ_t [cosine_ft cos(n₁ φ₁ + n₂ φ₂) + sine_ft sin(n₁ φ₁ + n₂ φ₂)]

    **Arguments**
    - `ratio`: i = z₁/z₂.
    - `terms`: the orders (n₁, n₂) of every harmonic.
    - `offset`: rad, shape (2,), flanks A and B.
    - `cosine`, `sine`: rad, shape (2, len(terms)).
    """

    ratio: Float[Array, ""]
    terms: tuple[Term, ...] = eqx.field(static=True)
    offset: Float[Array, "2"]
    cosine: Float[Array, "2 terms"]
    sine: Float[Array, "2 terms"]

    @property
    def highest_order(self) -> float:
        """Fastest harmonic, in cycles per driving turn."""
        ratio = float(self.ratio)
        return max((abs(driving + driven * ratio) for driving, driven in self.terms), default=1.0)

    def at_both_angles(
        self,
        driving_angle: Float[Array, "*shape"],
        driven_angle: Float[Array, "*shape"],
        flank: Flank,
    ) -> Float[Array, "*shape"]:
        """TE of `flank` where both shaft angles are known, rad."""
        side = flank_index(flank)
        if not self.terms:
            return self.offset[side] + 0.0 * driven_angle
        orders = jnp.asarray(self.terms, driven_angle.dtype)
        phase = driving_angle[..., None] * orders[:, 0] + driven_angle[..., None] * orders[:, 1]
        sine, cosine = sincos(phase)
        return self.offset[side] + cosine @ self.cosine[side] + sine @ self.sine[side]


class CombinedModel(ImplicitModel):
    """TE_f = exact TE_f + orders TE_f, both at the angles the gears really have."""

    ratio: Float[Array, ""]
    exact: ExactModel
    orders: OrderModel

    @property
    def highest_order(self) -> float:
        """Fastest harmonic of both parts, in cycles per driving turn."""
        return max(self.exact.highest_order, self.orders.highest_order)

    def at_both_angles(
        self,
        driving_angle: Float[Array, "*shape"],
        driven_angle: Float[Array, "*shape"],
        flank: Flank,
    ) -> Float[Array, "*shape"]:
        """TE of `flank` where both shaft angles are known, rad."""
        return self.exact.at_both_angles(
            driving_angle, driven_angle, flank
        ) + self.orders.at_both_angles(driving_angle, driven_angle, flank)
