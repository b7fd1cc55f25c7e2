"""Partial autocorrelations as parameters of stationary autoregressions.

ε_t = Σ_j a_j ε_{t−j} + innovation is stationary if and only if its partial autocorrelations
π_1 … π_p all lie within ±1 (O. Barndorff-Nielsen, G. Schou, J. Multivariate Anal. 3 (1973) 408).
Levinson's recursion computes the whitening filter (1, −a₁, …, −a_p) from π_1 … π_p.
"""

from typing import Any, overload

import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float

from ..arrays import Number, Numbers, namespace
from .autoregression import levinson_step, mirror_places

_WRITTEN_OUT = 3
"""Orders up to which a compiled program contains every step of the recursion and not a loop: it is
faster for few orders, and takes longer to compile for many (chosen)."""


@overload
def filter_of(partial: Float[np.ndarray, " p"]) -> Float[np.ndarray, " taps"]: ...
@overload
def filter_of(partial: Float[Array, " p"]) -> Float[Array, " taps"]: ...
def filter_of(partial: Float[Numbers, " p"]) -> Float[Numbers, " taps"]:
    """Return the whitening filter of an autoregression with these partial autocorrelations.

    **Example**
    ```python
    >>> import numpy as np
    >>> from vttig_jax.base.numerics.partial_autocorrelation import filter_of
    >>> filter_of(np.array([0.5, -0.2])).tolist()
    [1.0, -0.6, 0.2]

    ```
    """
    xp = namespace(partial)
    if isinstance(partial, Array) and partial.shape[0] > _WRITTEN_OUT:
        return _looped(partial)
    filter_ = xp.ones(1)
    for order in range(partial.shape[0]):
        filter_ = levinson_step(filter_, partial[order], xp)
    return filter_


def _looped(partial: Float[Array, " p"]) -> Float[Array, " taps"]:
    """Return the filter of `filter_of` by one loop over filters of the full length."""

    def longer(filter_: Any, step: tuple[Any, Any]) -> tuple[Any, None]:
        places, value = step
        return filter_ - value * filter_[places], None

    lags = partial.shape[0]
    steps = jnp.asarray(mirror_places(lags)), partial
    return lax.scan(longer, jnp.zeros(lags + 1).at[0].set(1.0), steps)[0]


def partial_of(filter_: Float[np.ndarray, " taps"]) -> Float[np.ndarray, " p"]:
    """Return the partial autocorrelations of a whitening filter, the inverse of `filter_of`."""
    partial = np.empty(len(filter_) - 1)
    for order in range(len(partial), 0, -1):
        last = partial[order - 1] = -filter_[-1]
        filter_ = ((filter_ + last * filter_[::-1]) / (1 - last**2))[:-1]
    return partial


def log_initial_determinant(partial: Float[Numbers, " p"]) -> Float[Number, ""]:
    """Return the log-determinant of the covariance of p successive samples.

    For innovations of variance one it is −Σ_k k log(1 − π_k²). Each sample after the first p adds
    only the log-variance of its innovation to the log-determinant.
    """
    xp = namespace(partial)
    return -xp.sum(xp.arange(1, partial.shape[0] + 1) * xp.log1p(-(partial**2)))
