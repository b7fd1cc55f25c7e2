"""Cosine and sine of many orders of one angle, from few evaluations of both functions."""

from fractions import Fraction

import numpy as np
from jaxtyping import Complex, Float

from ...base.units import REV
from .harmonics import AnyTerm


class Waves:
    """Values exp(i k φ) of any orders k at the angles φ, rad.

    Whole orders are products of lower ones, which cost a fraction of a cosine and a sine.

    **Example**
    ```python
    >>> import numpy as np
    >>> from vttig_jax.identify.model.waves import Waves
    >>> waves = Waves(np.array([0.0, np.pi / 6]))
    >>> np.round(waves.of(3).imag, 12).tolist()
    [0.0, 1.0]

    ```
    """

    def __init__(self, angle: Float[np.ndarray, " n"]) -> None:
        self.angle = angle
        self.known: dict[int, Complex[np.ndarray, " n"]] = {}

    def of(self, order: int | Fraction) -> Complex[np.ndarray, " n"]:
        """Return exp(i k φ) for the order k."""
        if order != int(order):
            return _wave(float(order) * self.angle)
        whole = abs(int(order))
        if whole not in self.known:
            if whole < 2:
                self.known[whole] = _wave(whole * self.angle)
            else:
                half = whole // 2
                self.known[whole] = self.of(half) * self.of(whole - half)
        wave = self.known[whole]
        return wave.conj() if order < 0 else wave


def product(driving: Waves, driven: Waves, term: AnyTerm) -> Complex[np.ndarray, " n"]:
    """Return exp(i (n₁φ₁ + n₂φ₂)) of the harmonic `term`, (n₁, n₂)."""
    first, second = term
    if not first:
        return driven.of(second)
    return driving.of(first) * driven.of(second) if second else driving.of(first)


def _wave(angle: Float[np.ndarray, " n"]) -> Complex[np.ndarray, " n"]:
    turns = angle / REV
    turns -= np.rint(turns)  # NumPy is faster for small angles
    turns *= REV
    wave = np.empty(len(angle), np.complex128)
    wave[:] = np.cos(turns)
    wave += 1j * np.sin(turns)
    return wave
