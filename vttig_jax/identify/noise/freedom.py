"""Degrees of freedom of a variance that follows from an estimated noise model.

The variance v of a linear function of the coefficients depends on the parameters θ of the noise. If
its logarithm varies little, v has a χ² distribution with

    ν = 2 v² / (∇vᵀ A ∇v),    A = 2 H⁻¹,

degrees of freedom, where H is the Hessian of −2 ln of the restricted likelihood (F. E.
Satterthwaite, Biometrics Bull. 2 (1946) 110). The parameters are the logarithm of the innovation
variance and the inverse hyperbolic tangents of the partial autocorrelations.
"""

from collections.abc import Sequence
from itertools import combinations

import numpy as np
from jaxtyping import Float

from ...base.numerics.partial_autocorrelation import filter_of
from ..compress.harmonic_summary import HarmonicSummary
from .reml import freedom_left
from .restricted_likelihood import LARGEST

_STEP = 5e-3
"""Step of θ for numerical derivatives. It is small compared with the standard errors of θ, which
are at least 0.03 (chosen)."""

_LEAST = 1.0
"""Lower limit of the eigenvalues of H. A smaller one belongs to a parameter that the log does not
determine; its standard error is then limited to √2 (chosen)."""

FEWEST = 3.0  # least degrees of freedom that are returned; chosen value


def freedom(
    summary: HarmonicSummary,
    partial: Float[np.ndarray, " order"],
    responses: Sequence[Float[np.ndarray, "_ k"]],
) -> Float[np.ndarray, " k"]:
    """Return the degrees of freedom of the variances of k functions of the coefficients.

    **Arguments**
    - `partial`: partial autocorrelations of the noise.
    - `responses`: for every flank, the covariance of its coefficients (rows of the array) with the
      k functions (columns).
    """
    filters = filter_of(partial)
    misfit = sum(float(flank.factor(filters)[-1, -1] ** 2) for flank in summary.flanks)
    left = freedom_left(summary)
    centre = np.append(
        np.log(max(misfit, summary.rounding, 1e-300) / left),
        np.arctanh(np.clip(partial, -LARGEST, LARGEST)),
    )

    def at(*moved: tuple[int, float]) -> tuple[float, Float[np.ndarray, " k"]]:
        """Return −2 ln likelihood, and 1/v up to a factor, at a shifted θ.

        A pair in `moved` is the index of a parameter in θ and its shift in steps.
        """
        theta = centre.copy()
        for place, steps in moved:
            theta[place] += steps * _STEP
        shifted = np.tanh(theta[1:])
        height, inverse = left * theta[0], np.zeros(responses[0].shape[1])
        for flank, response in zip(summary.flanks, responses, strict=True):
            factor = flank.factor(filter_of(shifted))
            height += factor[-1, -1] ** 2 * np.exp(-theta[0]) + flank.log_determinant(shifted)
            height += 2 * np.sum(np.log(np.abs(np.diag(factor)[:-1])))
            inverse += np.sum((factor[:-1, :-1] @ response) ** 2, axis=0) * np.exp(-theta[0])
        return float(height), inverse

    count = len(centre)
    middle, information = at()
    ends = [(at((place, 1.0)), at((place, -1.0))) for place in range(count)]
    hessian = np.diag([up[0] - 2 * middle + down[0] for up, down in ends])
    for first, second in combinations(range(count), 2):
        both = at((first, 1.0), (second, 1.0))[0] + at((first, -1.0), (second, -1.0))[0]
        sides = sum(end[0] for place in (first, second) for end in ends[place])
        hessian[first, second] = hessian[second, first] = (both - sides + 2 * middle) / 2
    slope = np.array([up[1] - down[1] for up, down in ends]) / (2 * _STEP)
    return satterthwaite(information, slope, hessian / _STEP**2)


def satterthwaite(
    variance: Float[np.ndarray, " k"],
    slope: Float[np.ndarray, "p k"],
    hessian: Float[np.ndarray, "p p"],
) -> Float[np.ndarray, " k"]:
    """Return the degrees of freedom ν = 2 v² / (∇vᵀ 2 H⁻¹ ∇v) of k variances, at least `FEWEST`.

    Eigenvalues of H below `_LEAST` are replaced by `_LEAST`.

    **Arguments**
    - `variance`: variances v, or 1/v, which gives the same ν if `slope` is also that of 1/v.
    - `slope`: ∇v, the derivatives of v (or 1/v) with respect to the p noise parameters θ.
    - `hessian`: H, the Hessian of −2 ln(restricted likelihood) with respect to θ.
    """
    size, directions = np.linalg.eigh(hessian)
    spread = 2 * np.sum((directions.T @ slope) ** 2 / np.maximum(size, _LEAST)[:, None], axis=0)
    return np.maximum(2 * variance**2 / np.maximum(spread, 1e-300), FEWEST)
