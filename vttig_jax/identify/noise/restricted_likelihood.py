"""Restricted likelihood of autoregressive noise: its formulas for one log and for many.

With the coefficients of every column integrated out, −2 log-likelihood is, up to a constant,

    F(π) = (N − Q) log S + Σ_f log|X_fᵀ Σ⁻¹ X_f| − R Σ_k k log(1 − π_k²),

with the whitened misfit S, N rows in R runs, and Q coefficients. Maximum likelihood lacks the
second term and ignores the noise that the fitted columns absorb. The noise then seems too white,
and the intervals are too short.

Both logarithms are concave functions of quadratic forms of the whitening filter f. If their
tangents replace them, F becomes fᵀ T f − R Σ_k k log(1 − π_k²). This is an upper bound that touches
F, so every step that lowers the bound lowers F too. The filter is linear in each single π_k. The
best value of one π_k is therefore the root of a cubic (S. M. Kay, IEEE Trans. ASSP 31 (1983) 56,
for the plain likelihood).

`reml` lowers the bound for one log with NumPy, so that nothing is compiled, and `batched_reml` does
it for many logs inside a compiled program. Their shapes differ, so each has a search of its own.
"""

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from ...base.arrays import Number, Numbers, Scalars, namespace
from ...base.numerics.partial_autocorrelation import log_initial_determinant
from ..compress.lagged_forms import filter_form

LARGEST = 0.999
"""Largest absolute value of a partial autocorrelation. Noise above it is a drift, and the whitened
offset would be smaller than the rounding of the lag products."""

SEARCHES = 2
"""Number of searches of the order: first from the residual of ordinary least squares, then from
that of generalised least squares."""

SWEEPS = 3  # coordinate descents per order in a search; chosen value
MOST_STEPS = 40  # coordinate descents after the search of the order; chosen value
SETTLED = 1e-7  # change of the partial autocorrelations at convergence; chosen value

_FLAT = 1e-9  # curvature, in multiples of the count, that the first approximation neglects
_POLISH = 6  # Newton steps on the root of the cubic; chosen value
_LEAST_MISFIT = 1e-300  # least misfit, so that the misfit of a log without noise has a logarithm


class Bound(NamedTuple):
    """Upper bound fᵀ T f − R Σ_k k log(1 − π_k²) of F; T is `form`, and R is `runs`."""

    form: Float[Numbers, "taps taps"]
    runs: Float[Number, ""] | int

    def at(
        self, partial: Float[Numbers, " p"], filter_: Float[Numbers, " p+1"]
    ) -> Float[Number, ""]:
        """Return the bound at partial autocorrelations and their whitening filter."""
        taps = filter_.shape[0]
        misfit = filter_ @ self.form[:taps, :taps] @ filter_
        return misfit + self.runs * log_initial_determinant(partial)


def misfit_weight(
    misfit: Float[Number, ""],
    freedom: Float[Number, ""] | float,
    rounding: Float[Number, ""] | float,
    filter_: Float[Numbers, " taps"],
) -> Float[Number, ""]:
    """Return (N − Q)/S, the derivative of (N − Q) log S with respect to S.

    S is the whitened `misfit` of all flanks plus the whitened rounding of y. `rounding` is the sum
    of squares of the rounding errors, which count as white noise, and `freedom` is N − Q.
    """
    total = misfit + rounding * (filter_ @ filter_)
    return freedom / namespace(total).maximum(total, _LEAST_MISFIT)


def flank_form(
    lag_products: Float[Numbers, "taps q q"],
    ends: Float[Numbers, "ends lag q"],
    inverse: Float[Numbers, "q q"],
    left: Float[Number, ""] | float,
    weight: Float[Number, ""] | float,
) -> Float[Numbers, "taps taps"]:
    """Return the contribution of one flank to the matrix T of the bound.

    **Arguments**
    - `lag_products`, `ends`: products of the rows U, as in `lagged_forms`.
    - `inverse`: inverse of the upper triangle C with CᵀC = Uᵀ Σ⁻¹ U at the point where the bound
      touches F. Its columns, except the last, combine the regressors to columns that are
      orthonormal after whitening; the sum of their squares gives the slope of log|Xᵀ Σ⁻¹ X|.
    - `left`: length of the whitened residual; `left` times the last column gives the residual.
    - `weight`: the slope (N − Q)/S, by which the square of the residual is multiplied.
    """
    xp = namespace(inverse)
    scale = xp.where(np.arange(inverse.shape[0]) < inverse.shape[0] - 1, 1.0, left * weight**0.5)
    return filter_form(lag_products, ends, inverse * scale[None])


def rounding_form(
    rounding: Float[Number, ""] | float, weight: Float[Number, ""] | float, taps: int
) -> Float[Numbers, "taps taps"]:
    """Return the contribution of the rounding of y to the matrix T of the bound."""
    return weight * rounding * np.eye(taps)


def best_partial(curvature: Any, slope: Any, count: Any) -> Any:
    """Return π within ± `LARGEST` that minimises curvature π² + 2 slope π − count log(1 − π²).

    The derivative times (1 − π²) is a cubic with three real roots; the middle one is within ±1.
    The curvature is a sum of squares, and it counts as zero where rounding makes it negative. The
    arguments are three Python floats or three arrays.
    """
    xp: Any = Scalars if type(curvature) is float else namespace(curvature)
    curvature = xp.maximum(curvature, 0.0)
    curved = curvature > _FLAT * count
    divisor = xp.where(curved, curvature, 1.0)
    a, b, d = slope / divisor, -(curvature + count) / divisor, -slope / divisor
    q = (a**2 - 3 * b) / 9
    r = (2 * a**3 - 9 * a * b + 27 * d) / 54
    angle = xp.arccos(xp.minimum(xp.maximum(r / q**1.5, -1.0), 1.0))
    root = -2 * q**0.5 * xp.cos((angle - 2 * np.pi) / 3) - a / 3
    # Without curvature the equation is a quadratic one.
    root = xp.where(curved, root, -2 * slope / (count + xp.sqrt(count**2 + 4 * slope**2)))
    # If the minimum is beyond ±1/2, 1 − |π| is at least 1 − `inside`.
    inside = 1 - xp.minimum(0.5, count / (4 * (curvature + abs(slope))))
    for _ in range(_POLISH):
        root = xp.minimum(xp.maximum(root, -inside), inside)
        rest = 1 - root**2
        value = curvature * root + slope + count * root / rest
        root = root - value / (curvature + count * (1 + root**2) / rest**2)
    inside = xp.minimum(inside, LARGEST)
    return xp.minimum(xp.maximum(root, -inside), inside)
