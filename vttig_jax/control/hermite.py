"""A quantity inside one step, from values and rates at both ends, and where it vanishes."""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

_HALLEY = 3


class Cubic(NamedTuple):
    """c₀ + c₁ τ + c₂ τ² + c₃ τ³ for τ in [0, 1]."""

    c0: Float[Array, "*shape"]
    c1: Float[Array, "*shape"]
    c2: Float[Array, "*shape"]
    c3: Float[Array, "*shape"]

    def at(self, share: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
        """Value at a share of the step."""
        return self.c0 + share * (self.c1 + share * (self.c2 + share * self.c3))

    def slope(self, share: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
        """Derivative with respect to the share."""
        return self.c1 + share * (2 * self.c2 + 3 * share * self.c3)

    def bend(self, share: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
        """Second derivative with respect to the share."""
        return 2 * self.c2 + 6 * share * self.c3


def cubic(start, end, start_rate, end_rate, step) -> Cubic:
    """The cubic with these values and these rates, per s, at both ends of a step of s (Hermite)."""
    first, last, change = start_rate * step, end_rate * step, end - start
    return Cubic(start, first, 3 * change - 2 * first - last, first + last - 2 * change)


def first_root(curve: Cubic) -> Float[Array, "*shape"]:
    """Where a curve that starts at or above zero and ends below it crosses zero, by Halley.

    Curves of one short step are nearly straight: from the chord three iterations reach the last
    bit. For any other curve the result is some share of the step in [0, 1].
    """
    end = curve.at(jnp.ones_like(curve.c0))
    share = _within(curve.c0 / _away_from_zero(curve.c0 - end))
    for _ in range(_HALLEY):
        value, slope, bend = curve.at(share), curve.slope(share), curve.bend(share)
        below = slope * slope - 0.5 * value * bend
        share = _within(share - value * slope / _away_from_zero(below))
    return share


def _within(share):
    return jnp.clip(share, 0.0, 1.0)


def _away_from_zero(value):
    return jnp.where(value == 0, 1.0, value)
