"""The protocol every flank model keeps: two transmission errors and their difference."""

from abc import abstractmethod

import equinox as eqx
from jax.typing import ArrayLike
from jaxtyping import Array, Float, Real

from ..pair.gears import Flank


class FlankModel(eqx.Module):
    """Contact of a gear pair, flank by flank, as a function of the driving angle.

    On flank A the driven gear stands at φ₂ = i φ₁ + TE_A(φ₁), on flank B at i φ₁ + TE_B(φ₁);
    between the two lies the backlash j = TE_B − TE_A. All angles are in rad and absolute.
    """

    ratio: eqx.AbstractVar[Float[Array, ""]]

    @property
    @abstractmethod
    def highest_order(self) -> float:
        """Fastest harmonic that matters, in cycles per driving turn: what a grid must resolve."""

    @abstractmethod
    def transmission_error(
        self, driving_angle: Real[ArrayLike, "*shape"], flank: Flank
    ) -> Float[Array, "*shape"]:
        """TE = φ₂ − i φ₁ while `flank` carries, rad of the driven gear (23)."""

    def backlash(self, driving_angle: Real[ArrayLike, "*shape"]) -> Float[Array, "*shape"]:
        """Backlash j = TE_B − TE_A, rad of the driven gear (22)."""
        return self.transmission_error(driving_angle, "B") - self.transmission_error(
            driving_angle, "A"
        )


def flank_index(flank: Flank) -> int:
    """Position of a flank on every flank axis: A is 0, B is 1."""
    if flank not in ("A", "B"):
        raise ValueError(f'Argument `flank` must be "A" or "B", but is {flank!r}.')
    return 0 if flank == "A" else 1
