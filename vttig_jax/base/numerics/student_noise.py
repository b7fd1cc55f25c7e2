"""Likelihood of a linear model with autoregressive noise of Student's distribution."""

from dataclasses import dataclass, replace
from math import lgamma
from operator import attrgetter

import numpy as np
from jaxtyping import Float
from numpy.lib.stride_tricks import sliding_window_view

from .autoregression import whitening_filter
from .well_conditioned import orthonormal_basis

_HIGHEST_ORDER = 16
_ROWS_PER_LAG = 12
"""Highest order of the autoregression, and least number of rows per order (chosen)."""

_FREEDOMS = (2.0, 4.0, 10.0, 1e6)
"""Degrees of freedom that are tried; the last is a normal distribution (chosen)."""

_LOG_RATIO = np.array([lgamma((one + 1) / 2) - lgamma(one / 2) for one in _FREEDOMS])
"""ln Γ((ν + 1)/2) − ln Γ(ν/2) for each ν; `math.lgamma` starts quickly, unlike scipy.special."""

_ROUNDS, _SCALES = 5, 10  # iterations of the fit, and of the scale in each (chosen)


@dataclass(frozen=True)
class NoiseFit:
    """Fit with the largest ln L; residual and weights have one entry for each row.

    **Arguments**
    - `log_likelihood`: ln L of the values after scaling; it compares fits of the same values.
    - `order`: order p of the autoregression.
    - `residual`: values − columns · β, in the unit of the values.
    - `weight`: weights of the innovations; outliers have small weights.
    - `freedom`: degrees of freedom ν of the innovations.
    """

    log_likelihood: float
    order: int
    residual: Float[np.ndarray, " n"]
    weight: Float[np.ndarray, " n"]
    freedom: float = 1e6


def fit_student_noise(
    values: Float[np.ndarray, " n"],
    columns: Float[np.ndarray, "n p"],
    *starts: NoiseFit,
    order: int | None = None,
    floor: float = 0.0,
    least_freedom: float = 0.0,
) -> NoiseFit:
    """Fit values = columns · β + noise by the largest likelihood.

    The noise is an autoregression whose innovations e have Student's distribution with scale s,
    ln L = Σ ln t_ν(e / s) − n ln s. Each iteration updates the autoregression, β and the weights
    (ν + 1) / (ν + e²/s²) in turn; K. L. Lange, R. J. A. Little, J. M. G. Taylor, JASA 84 (1989)
    881. The first p rows have no complete past and give no innovations.

    **Arguments**
    - `values`, `columns`: observations and design matrix.
    - `starts`: fits of fewer columns, whose residuals are further starts of the iteration.
    - `order`: order p of the autoregression; by default BIC selects it.
    - `floor`: least standard deviation of white noise in every series, in the unit of `values`.
      Otherwise an autoregression would predict a series without noise exactly, and treat a step
      in it as one outlier.
    - `least_freedom`: least ν that the likelihood may choose.
    """
    scale = max(float(np.ptp(values)), 1e-300)
    size = np.linalg.norm(columns, axis=0)
    columns = orthonormal_basis(columns / np.where(size > 0, size, 1.0), 1e-9)
    scaled = values / scale
    first = scaled - columns @ (columns.T @ scaled)
    least = (floor / scale) ** 2
    here = [(NoiseFit(-np.inf, 0, first, np.ones(len(values))), order)]
    here += [(replace(one, residual=one.residual / scale), one.order) for one in starts]
    found = [
        _iterated(scaled, columns, start, freedom, order=used, least=least, free=least_freedom)
        for start, used in here
        for freedom in (_FREEDOMS[1], _FREEDOMS[-1])
    ]
    best = max(found, key=attrgetter("log_likelihood"))
    return replace(best, residual=best.residual * scale)


def _iterated(
    values: Float[np.ndarray, " n"],
    columns: Float[np.ndarray, "n p"],
    start: NoiseFit,
    freedom: float,
    *,
    order: int | None,
    least: float,
    free: float,
) -> NoiseFit:
    """Return the best fit of several iterations with weights for `freedom` degrees of freedom.

    `least` is the least variance of white noise in the series, `free` the least ν of the result.
    """
    residual, weight = start.residual, start.weight.copy()
    highest = min(_HIGHEST_ORDER, len(values) // _ROWS_PER_LAG)
    best = NoiseFit(-np.inf, 0, residual, weight)
    for _ in range(_ROUNDS):
        used = _order(residual, weight, highest, least) if order is None else order
        past = sliding_window_view(residual, used + 1)[:, ::-1]
        shares = weight[used:, None]
        taps = _solution(past[:, 1:], shares, past[:, 0], ridge=least * len(past))
        filter_ = np.concatenate([[1.0], -taps])[::-1]
        whitened = sliding_window_view(columns, used + 1, axis=0) @ filter_
        target = sliding_window_view(values, used + 1) @ filter_
        solution = _solution(whitened, shares, target)
        residual = values - columns @ solution
        innovation = target - whitened @ solution
        # The variance of that white noise when filtered is the least of the innovations.
        found, scales = _likelihoods(innovation, least * float(filter_ @ filter_))
        seen = int(np.argmax(np.where(np.array(_FREEDOMS) >= free, found, -np.inf)))
        likelihood = float(found[seen]) * len(values) / len(innovation)
        if likelihood > best.log_likelihood:
            best = NoiseFit(likelihood, used, residual, weight.copy(), _FREEDOMS[seen])
        weight[used:] = (freedom + 1) / (freedom + innovation**2 / scales[_FREEDOMS.index(freedom)])
        weight[:used] = 1.0
    return best


def _solution(
    columns: Float[np.ndarray, "n p"],
    weight: Float[np.ndarray, "n 1"],
    values: Float[np.ndarray, " n"],
    ridge: float = 0.0,
) -> Float[np.ndarray, " p"]:
    """Return the solution of weighted least squares from its normal equations.

    `ridge` is added to their diagonal, at least what rounding changes there.
    """
    weighted = columns * weight
    products = weighted.T @ columns
    ridge = max(ridge, np.finfo(float).eps * np.trace(products), np.finfo(float).tiny)
    return np.linalg.solve(products + ridge * np.eye(len(products)), weighted.T @ values)


def _order(
    residual: Float[np.ndarray, " n"],
    weight: Float[np.ndarray, " n"],
    highest: int,
    least: float,
) -> int:
    """Return the order of the autoregression that BIC selects from weighted lag products.

    The weights, at most one, reduce outliers. `highest` is the largest order that is tried.
    """
    values = residual * np.minimum(weight, 1.0)
    products = np.array([values[lag:] @ values[: len(values) - lag] for lag in range(highest + 1)])
    products[0] += least * len(values)
    return len(whitening_filter(products / len(values), len(values))) - 1


def _likelihoods(
    innovation: Float[np.ndarray, " n"], least: float
) -> tuple[Float[np.ndarray, " freedoms"], Float[np.ndarray, " freedoms"]]:
    """Return for each of `_FREEDOMS` the largest ln L of the innovations over s² ≥ `least`, and s².

    Here s is the scale of Student's distribution.
    """
    squares, freedoms = innovation**2, np.array(_FREEDOMS)[:, None]
    scales = np.full_like(freedoms, max(squares.mean(), least, 1e-300))
    for _ in range(_SCALES):
        shares = (freedoms + 1) / (freedoms + squares / scales)
        scales = np.maximum((shares @ squares / len(squares))[:, None], max(least, 1e-300))
    width = freedoms * scales
    logs = _LOG_RATIO - 0.5 * np.log(np.pi * width[:, 0])
    tails = 0.5 * (freedoms + 1) * np.log1p(squares / width)
    return len(squares) * logs - tails.sum(axis=1), scales[:, 0]
