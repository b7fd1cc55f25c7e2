"""Whitening filter of an autoregression from its autocovariance; imports no jax."""

from types import ModuleType
from typing import Any

import numpy as np
from jaxtyping import Float, Int


def whitening_filter(
    autocovariance: Float[np.ndarray, " lags"], rows: int
) -> Float[np.ndarray, " taps"]:
    """Return the filter (1, −a₁, …, −a_p) of the autoregression with this autocovariance.

    `autocovariance` starts at lag 0. Levinson's recursion computes the filters of all orders; BIC
    for `rows` samples selects the order p < lags. AIC selects too high orders in a short
    log: the filter follows the gap that the fitted harmonics leave in the spectrum of the residual,
    and standard errors become two to three times too small.
    A positive autocovariance (divided by all rows at every lag) gives a stationary autoregression.
    """
    filter_, variance = np.ones(1), autocovariance[0]
    if variance <= 0:
        return filter_
    best, lowest_score = filter_, rows * np.log(variance)
    for order in range(1, len(autocovariance)):
        partial = filter_ @ autocovariance[order:0:-1] / variance
        filter_ = levinson_step(filter_, partial)
        variance *= 1 - partial**2
        if variance <= 0:
            break
        score = rows * np.log(variance) + np.log(rows) * order
        if score < lowest_score:
            best, lowest_score = filter_, score
    return best


def levinson_step(filter_: Any, partial: Any, xp: ModuleType = np) -> Any:
    """Return the whitening filter of order p + 1 from `filter_` of order p by Levinson's step.

    `partial` is the partial autocorrelation at lag p + 1.

    `xp` is the array namespace of both arguments, numpy or jax.numpy.
    """
    extended = xp.concatenate([filter_, xp.zeros(1)])
    return extended - partial * extended[::-1]


def mirror_places(lags: int) -> Int[np.ndarray, "lags taps"]:
    """Return for every order k = 1 … `lags` the places that turn a filter around for its next step.

    The filter has the full length `lags` + 1: (f_0 … f_{k−1}, 0 …). Its values at row k − 1 are
    (0, f_{k−1} … f_0, 0 …). The last value is 0 at every order below `lags`, so all zeros are taken
    from there.
    """
    places = np.arange(1, lags + 1)[:, None] - np.arange(lags + 1)
    return np.where(places >= 0, places, lags)
