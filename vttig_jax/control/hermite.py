"""Cubic Hermite interpolation within one time step, and the root of the cubic.

A share τ is the elapsed fraction of the step, 0 … 1.
"""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

_HALLEY = 3  # Halley iterations; for the nearly straight curves of a step the root is then exact


class Cubic(eqx.Module):
    """Cubic polynomial c₀ + c₁ τ + c₂ τ² + c₃ τ³ for the share τ of the step, 0 … 1."""

    c0: Float[Array, "*shape"]
    c1: Float[Array, "*shape"]
    c2: Float[Array, "*shape"]
    c3: Float[Array, "*shape"]

    def at(self, share: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
        """Return the value at the share τ of the step."""
        return self.c0 + share * (self.c1 + share * (self.c2 + share * self.c3))

    def slope(self, share: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
        """Return the derivative with respect to the share τ."""
        return self.c1 + share * (2 * self.c2 + 3 * share * self.c3)

    def bend(self, share: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
        """Return the second derivative with respect to the share τ."""
        return 2 * self.c2 + 6 * share * self.c3


def cubic(start, end, start_rate, end_rate, step) -> Cubic:
    """Return the cubic with the given values and rates (per s) at both ends of a step (s)."""
    first, last, change = start_rate * step, end_rate * step, end - start
    return Cubic(start, first, 3 * change - 2 * first - last, first + last - 2 * change)


def first_root(curve: Cubic) -> Float[Array, "*shape"]:
    """Return the share at which a curve with start ≥ 0 and end < 0 crosses zero (Halley's method).

    The iteration starts at the root of the chord. Curves of one short step are nearly straight, so
    three iterations reach full precision. For a curve without this change of sign, the result is
    an arbitrary share in [0, 1].
    """
    end = curve.at(jnp.ones_like(curve.c0))
    share = jnp.clip(curve.c0 / nonzero(curve.c0 - end), 0.0, 1.0)
    for _ in range(_HALLEY):
        value, slope, bend = curve.at(share), curve.slope(share), curve.bend(share)
        denominator = slope * slope - 0.5 * value * bend
        share = jnp.clip(share - value * slope / nonzero(denominator), 0.0, 1.0)
    return share


def nonzero(value: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
    """Return a divisor: the value, or 1 where it is 0."""
    return jnp.where(value == 0, 1.0, value)
