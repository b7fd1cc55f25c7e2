"""Pareto smoothing of importance weights, with the shape k̂ that says whether to trust them.

A. Vehtari, D. Simpson, A. Gelman, Y. Yao, J. Gabry, J. Mach. Learn. Res. 25 (2024) 72. A
generalised Pareto distribution is fitted to the largest weights (J. Zhang, M. A. Stephens,
Technometrics 51 (2009) 316). Quantiles of this distribution then replace these weights.
"""

import numpy as np
from jaxtyping import Float

LARGEST_K = 0.7
"""Shape k̂ above which the error of a weighted mean falls too slowly with the number of draws
(Vehtari et al.)."""

_TAIL_SHARE, _TAIL_ROOTS = 0.2, 3.0  # the tail has min(0.2 n, 3 √n) weights (Vehtari et al.)
_FEWEST = 5  # weights of a tail that can be fitted (Vehtari et al.)
_PRIOR_WEIGHTS, _PRIOR_K = 10.0, 0.5  # weak prior of the shape (Vehtari et al.)
_GRID, _GRID_SPREAD = 30, 3.0  # points and spread of the grid (Zhang and Stephens)

Values = Float[np.ndarray, " n"]


def smoothed_log_weights(log_weights: Values) -> tuple[Values, float]:
    """Return normalised, Pareto-smoothed log-weights and the shape k̂ of their tail.

    The tail is the min(0.2 n, 3 √n) largest weights. The weights of the tail that are larger than
    all weights below it are smoothed if they are at least five. If there are fewer of them or the
    tail has fewer than five weights, nothing is smoothed and k̂ is infinite; if a tail of five or
    more has none of them, k̂ is −∞. Weights of zero (log-weight −∞) stay zero. If all weights are
    zero or the largest is not finite, the weights are equal and k̂ is infinite.

    **Example**
    ```python
    >>> import numpy as np
    >>> from vttig_jax.posterior.sampling.pareto import smoothed_log_weights
    >>> tail = np.random.default_rng(0).exponential(size=100_000)  # weights with a Pareto tail
    >>> smooth, shape = smoothed_log_weights(0.5 * tail)
    >>> round(float(np.exp(smooth).sum()), 6), 0.3 < shape < 0.7
    (1.0, True)

    ```
    """
    largest = np.max(log_weights, initial=-np.inf)
    count = int(min(_TAIL_SHARE * len(log_weights), _TAIL_ROOTS * np.sqrt(len(log_weights))))
    if not np.isfinite(largest):
        return np.full(len(log_weights), -np.log(max(len(log_weights), 1))), np.inf
    shifted = log_weights - largest
    if count < _FEWEST:
        return shifted - np.log(np.sum(np.exp(shifted))), np.inf
    order = np.argsort(shifted, kind="stable")
    tail, cut = order[-count:], shifted[order[-count - 1]]
    excess = np.exp(shifted[tail]) - np.exp(cut)
    positive = excess[excess > 0]
    shape = -np.inf
    if len(positive) >= _FEWEST:
        shape, scale = fitted_pareto(positive)
        places = (np.arange(len(positive)) + 0.5) / len(positive)
        quantiles = np.exp(cut) + _quantiles(places, shape, scale)
        smooth = shifted.copy()
        smooth[tail[excess > 0]] = np.minimum(np.log(quantiles), 0.0)
        shifted = smooth
    elif len(positive):
        shape = np.inf
    return shifted - np.log(np.sum(np.exp(shifted))), shape


def fitted_pareto(excess: Values) -> tuple[float, float]:
    """Return shape k̂ and scale of a generalised Pareto distribution of positive, ascending values.

    Zhang and Stephens estimate θ = −k/σ as its mean on a grid, weighted with the likelihood. A weak
    prior then moves the shape towards 0.5, which matters for short tails only.
    """
    count = len(excess)
    grid = np.arange(1, _GRID + int(np.sqrt(count)) + 1)
    quarter = excess[int(count / 4 + 0.5) - 1]
    theta = 1 / excess[-1] + (1 - np.sqrt(len(grid) / (grid - 0.5))) / (_GRID_SPREAD * quarter)
    shapes = np.mean(np.log1p(-theta[:, None] * excess), axis=1)
    likelihood = count * (np.log(-theta / shapes) - shapes - 1)
    weights = np.exp(likelihood - likelihood.max())
    best = np.sum(theta * weights) / np.sum(weights)
    shape = float(np.mean(np.log1p(-best * excess)))
    scale = -shape / best
    shape = (count * shape + _PRIOR_WEIGHTS * _PRIOR_K) / (count + _PRIOR_WEIGHTS)
    return shape, float(scale)


def _quantiles(places: Values, shape: float, scale: float) -> Values:
    if abs(shape) < 1e-12:  # the limit of the formula, an exponential distribution
        return -scale * np.log1p(-places)
    return scale * np.expm1(-shape * np.log1p(-places)) / shape
