"""Autoregressive noise from its autocovariance. Imports no jax: `inspect` needs it too."""

from types import ModuleType
from typing import Any

import numpy as np
from jaxtyping import Float


def whitening_filter(
    autocovariance: Float[np.ndarray, " lags"], rows: int
) -> Float[np.ndarray, " taps"]:
    """Filter (1, −a₁, …, −a_p) of the autoregression with this autocovariance.

    Levinson's recursion, its order p < lags by BIC for `rows` samples: in a short log AIC asks for
    orders that follow the hole which the fitted harmonics leave in the spectrum of the residual,
    and standard errors come out two to three times too small. A positive autocovariance
    (divided by all rows at every lag) gives a stationary autoregression.
    """
    filter_, variance = np.ones(1), autocovariance[0]
    if variance <= 0:
        return filter_
    best, lowest = filter_, rows * np.log(variance)
    for order in range(1, len(autocovariance)):
        partial = filter_ @ autocovariance[order:0:-1] / variance
        filter_ = longer(filter_, partial)
        variance *= 1 - partial**2
        if variance <= 0:
            break
        score = rows * np.log(variance) + np.log(rows) * order
        if score < lowest:
            best, lowest = filter_, score
    return best


def longer(filter_: Any, partial: Any, xp: ModuleType = np) -> Any:
    """The filter of one order more, with this last partial autocorrelation (Levinson).

    `xp` is the namespace of both, numpy or jax.numpy.
    """
    extended = xp.concatenate([filter_, xp.zeros(1)])
    return extended - partial * extended[::-1]
