"""Autoregression of the noise by restricted maximum likelihood, from lag products alone.

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
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.linalg import solve_triangular
from scipy.optimize import brentq, minimize_scalar

from ...base.numerics.autoregression import levinson_step
from ...base.numerics.partial_autocorrelation import filter_of, log_initial_determinant
from ..compress.flank_summary import FlankSummary
from ..compress.harmonic_summary import HarmonicSummary

_SEARCHES = 2
"""Number of searches of the order: from ordinary residuals, then from whitened ones."""

_MOST_STEPS = 40  # coordinate descents after the search of the order; chosen value
_SETTLED = 1e-7  # change of the partial autocorrelations at convergence; chosen value
_SWEEPS = 3  # coordinate descents per order in a search; chosen value
_SHORTER = 0.95  # factor per reduction of the partial autocorrelations; chosen value
_FREQUENCIES = 4096
"""Number of points of the noise spectrum. They resolve the narrowest peak, which belongs to a
partial autocorrelation of 0.999."""

_WIDEST_GAIN = 1e5
"""Largest ratio of the gains of a whitening filter. Its square, 1e10, is the condition number of
the factored matrix, so six of the sixteen digits of a float remain."""

_FINE = {"xatol": 1e-8}  # absolute tolerance of the correlation ρ; chosen value

LARGEST = 0.999
"""Bound of a partial autocorrelation. Noise above it is a drift, and the whitened offset would be
smaller than the rounding of the lag products."""

Partial = Float[np.ndarray, " p"]


@dataclass(frozen=True)
class _Bound:
    """Upper bound fᵀ `form` f − `runs` Σ_k k log(1 − π_k²) of F."""

    form: Float[np.ndarray, "taps taps"]
    runs: int

    def at(self, partial: Partial) -> float:
        filter_ = filter_of(partial)
        taps = len(filter_)
        misfit = filter_ @ self.form[:taps, :taps] @ filter_
        return float(misfit + self.runs * log_initial_determinant(partial))

    def lowered(self, partial: Partial) -> Partial:
        """Return the partial autocorrelations after one coordinate descent.

        The last one is first because it is still undetermined in a search of the order. With the
        filter f_k of the first k and its reverse f_k*, the whole filter is the polynomial
        A f_k + B f_k*. One step back replaces A by A − π_k B and B by z (B − π_k A) (Szegő).
        """
        partial = partial.copy()
        taps = len(partial) + 1
        form = self.form[:taps, :taps]
        prefixes = [np.ones(1)]
        for value in partial[:-1]:
            prefixes.append(levinson_step(prefixes[-1], value))
        ahead, back = np.ones(1), np.zeros(1)
        for k in reversed(range(len(partial))):
            own = np.append(prefixes[k], 0.0)
            without = np.convolve(ahead, own) + np.convolve(back, own[::-1])
            slope = -np.convolve(ahead, own[::-1]) - np.convolve(back, own)
            partial[k] = _lowest(
                float(slope @ form @ slope), float(slope @ form @ without), self.runs * (k + 1)
            )
            ahead, back = (
                np.append(ahead - partial[k] * back, 0.0),
                np.append(0.0, back - partial[k] * ahead),
            )
        return partial


def restricted_partial(summary: HarmonicSummary) -> Partial:
    """Return the partial autocorrelations of the noise; BIC selects their number.

    Noise that is no autoregression has at most one, that of rows at the median distance.
    """
    if not summary.kind.summary.QUADRATIC:
        return _correlation(summary)
    partial = np.zeros(0)
    for _ in range(_SEARCHES):
        bound = _bound(summary, _representable(partial))
        partial = _of_best_order(bound, summary.rows)
    for _ in range(_MOST_STEPS):
        before = _representable(partial)
        if before is not partial:
            return before
        partial = _bound(summary, before).lowered(before)
        if np.abs(partial - before).max(initial=0.0) < _SETTLED:
            break
    return _representable(partial)


def _representable(partial: Partial) -> Partial:
    """Return `partial`, reduced until the digits of a float suffice for the noise spectrum.

    The residual of a wrong model can be so smooth that its whitening removes all digits of slow
    columns.
    """
    while True:
        gain = np.abs(np.fft.rfft(filter_of(partial), _FREQUENCIES))
        if gain.min() * _WIDEST_GAIN >= gain.max():
            return partial
        partial = _SHORTER * partial


def _correlation(summary: HarmonicSummary) -> Partial:
    """Return the only partial autocorrelation of the noise; empty if BIC prefers white noise."""

    def height(rho: float) -> float:
        partial = np.array([rho])
        factors = [flank.factor(filter_of(partial)) for flank in summary.flanks]
        misfit = sum(float(factor[-1, -1] ** 2) for factor in factors)
        value = freedom_left(summary) * np.log(max(misfit, 1e-300))
        value += sum(flank.log_determinant(partial) for flank in summary.flanks)
        return value + sum(2 * float(np.sum(np.log(np.diag(factor)[:-1]))) for factor in factors)

    found: Any = minimize_scalar(height, bounds=(0.0, LARGEST), method="bounded", options=_FINE)
    better = height(0.0) - float(found.fun) > np.log(max(summary.rows, 2))
    return np.array([float(found.x)] if better else [])


def freedom_left(summary: HarmonicSummary) -> float:
    """Return the counted rows minus the number of coefficients, at least 1."""
    coefficients = len(summary.flanks) * (summary.columns.width - 1)
    return max(summary.counted_rows - coefficients, 1.0)


def _of_best_order(bound: _Bound, rows: int) -> Partial:
    """Return the partial autocorrelations of the order with the lowest BIC.

    Each order starts from the result of the previous order.
    """
    partial = best = np.zeros(0)
    lowest = bound.at(partial)
    for order in range(1, len(bound.form)):
        partial = np.append(partial, 0.0)
        for _ in range(_SWEEPS):
            partial = bound.lowered(partial)
        score = bound.at(partial) + order * np.log(max(rows, 2))
        if score < lowest:
            best, lowest = partial, score
    return best


def _bound(summary: HarmonicSummary, partial: Partial) -> _Bound:
    """Return the bound that touches F at `partial`."""
    filter_ = filter_of(partial)
    flanks = summary.flanks
    lags = min(len(flank.lag_products) for flank in flanks)
    misfit = 0.0
    residual, swallowed = np.zeros((2, lags, lags))
    for flank in flanks:
        inner = flank.inner(filter_)
        inverse = solve_triangular(inner, np.eye(len(inner)), check_finite=False)
        left = float(inner[-1, -1] * flank.triangle[-1, -1])
        misfit += left**2
        residual += _form(flank, lags, left * inverse[:, -1:])
        swallowed += _form(flank, lags, inverse[:, :-1])
    # The rounding of y counts as white noise, because its digits have no meaning.
    residual += summary.rounding * np.eye(lags)
    scale = freedom_left(summary) / max(misfit + summary.rounding, 1e-300)
    return _Bound(scale * residual + swallowed, sum(len(flank.heads) for flank in flanks))


def _form(
    flank: FlankSummary, lags: int, weights: Float[np.ndarray, "q d"]
) -> Float[np.ndarray, "taps taps"]:
    """Return the matrix T with fᵀTf = tr(weightsᵀ Uᵀ Σ⁻¹ U weights) for any filter f."""
    spread = weights @ weights.T
    lagged = np.tensordot(flank.lag_products[:lags], spread, 2)
    form = lagged[np.abs(np.subtract.outer(np.arange(lags), np.arange(lags)))]
    ends = flank.ends[:, : lags - 1] @ weights
    products = np.einsum("rad,rbd->ab", ends, ends)
    for shift in range(lags - 1):
        form[shift + 1 :, shift + 1 :] -= products[: lags - 1 - shift, : lags - 1 - shift]
    return form


def _lowest(curvature: float, slope: float, count: int) -> float:
    """Return the minimum π of the convex function curvature π² + 2 slope π − count log(1 − π²).

    It is limited to ± `LARGEST`.
    """
    found = brentq(lambda p: (curvature * p + slope) * (1 - p**2) + count * p, -1.0, 1.0)
    return float(np.clip(np.asarray(found), -LARGEST, LARGEST))
