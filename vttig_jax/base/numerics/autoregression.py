"""Whitening filter of an autoregression from its autocovariance; imports no jax."""

import numpy as np
from jaxtyping import Float


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
        filter_ = np.append(filter_, 0.0)
        filter_ = filter_ - partial * filter_[::-1]
        variance *= 1 - partial**2
        if variance <= 0:
            break
        score = rows * np.log(variance) + np.log(rows) * order
        if score < lowest_score:
            best, lowest_score = filter_, score
    return best
