"""The autoregression of the noise by restricted maximum likelihood, from lag products alone.

With the coefficients of every column integrated out, −2 log-likelihood is, up to a constant,

    F(π) = (N − Q) log S + Σ_f log|X_fᵀ Σ⁻¹ X_f| − R Σ_k k log(1 − π_k²),

S the whitened misfit, N rows in R runs, Q coefficients. Maximum likelihood without the second term
takes what the fitted columns swallow for whiteness, and intervals come out too short.

Both logarithms are concave in the quadratic forms of the whitening filter f. Their tangents turn F
into fᵀ T f − R Σ_k k log(1 − π_k²), which lies above F and touches it: every step down that bound
is a step down F. The filter is linear in each single π_k, so that its best value is the root of a
cubic (S. M. Kay, IEEE Trans. ASSP 31 (1983) 56, for the plain likelihood).
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.linalg import solve_triangular
from scipy.optimize import brentq, minimize_scalar

from ...base.numerics.autoregression import levinson_step
from ...base.numerics.partial_autocorrelation import filter_of, log_initial_determinant
from ..compress.harmonic_summary import FlankSummary, HarmonicSummary

_SEARCHES = 2
"""Times the order is chosen: from ordinary residuals, then from whitened ones."""

_MOST_STEPS = 40
_SETTLED = 1e-7
_SWEEPS = 3
_SHORTER = 0.95
_FREQUENCIES = 4096
"""Points of the noise spectrum: a partial autocorrelation of 0.999 makes no narrower peak."""

_WIDEST_GAIN = 1e5
"""Largest ratio of the gains of a whitening filter. Its square, 1e10, is the condition of what is
factored, which leaves six of the sixteen digits of a float."""

_FINE = {"xatol": 1e-8}

LARGEST = 0.999
"""Bound of a partial autocorrelation: beyond it noise is drift, and the whitened offset drowns in
the rounding of the lag products."""

Partial = Float[np.ndarray, " p"]


@dataclass(frozen=True)
class _Bound:
    """fᵀ `form` f − `runs` Σ_k k log(1 − π_k²), an upper bound of F."""

    form: Float[np.ndarray, "taps taps"]
    runs: int

    def at(self, partial: Partial) -> float:
        filter_ = filter_of(partial)
        taps = len(filter_)
        misfit = filter_ @ self.form[:taps, :taps] @ filter_
        return float(misfit + self.runs * log_initial_determinant(partial))

    def lowered(self, partial: Partial) -> Partial:
        """Every π_k in turn at its best, the last one first: it knows least yet.

        With f_k the filter of the first k and f_k* its reverse, the whole filter is the polynomial
        A f_k + B f_k*; one step back makes A − π_k B of A and z (B − π_k A) of B (Szegő).
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
    """Partial autocorrelations of the noise; their number by BIC.

    One for Ornstein–Uhlenbeck noise, that of rows at the median distance.
    """
    if summary.noise.kind == "ou":
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
    """`partial`, or as near to it as the digits of a float can follow the noise spectrum.

    What a wrong model leaves may be so smooth that its whitening takes all digits of slow columns.
    """
    while True:
        gain = np.abs(np.fft.rfft(filter_of(partial), _FREQUENCIES))
        if gain.min() * _WIDEST_GAIN >= gain.max():
            return partial
        partial = _SHORTER * partial


def _correlation(summary: HarmonicSummary) -> Partial:
    """The one correlation of Ornstein–Uhlenbeck noise; none where white noise does as well."""

    def height(rho: float) -> float:
        partial = np.array([rho])
        factors = [flank.factor(filter_of(partial)) for flank in summary.flanks]
        misfit = sum(float(factor[-1, -1] ** 2) for factor in factors)
        value = _freedom(summary) * np.log(max(misfit, 1e-300))
        value += sum(flank.log_determinant(partial) for flank in summary.flanks)
        return value + sum(2 * float(np.sum(np.log(np.diag(factor)[:-1]))) for factor in factors)

    found: Any = minimize_scalar(height, bounds=(0.0, LARGEST), method="bounded", options=_FINE)
    better = height(0.0) - float(found.fun) > np.log(max(summary.rows, 2))
    return np.array([float(found.x)] if better else [])


def _freedom(summary: HarmonicSummary) -> float:
    """Counted rows less coefficients."""
    coefficients = len(summary.flanks) * (summary.columns.width - 1)
    return max(summary.counted_rows - coefficients, 1.0)


def _of_best_order(bound: _Bound, rows: int) -> Partial:
    """The order with the lowest BIC, each begun from the one before."""
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
    """The bound that touches F at `partial`."""
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
    # What rounding leaves of y counts as white: its digits mean nothing.
    residual += summary.rounding * np.eye(lags)
    scale = _freedom(summary) / max(misfit + summary.rounding, 1e-300)
    return _Bound(scale * residual + swallowed, sum(len(flank.heads) for flank in flanks))


def _form(
    flank: FlankSummary, lags: int, weights: Float[np.ndarray, "q d"]
) -> Float[np.ndarray, "taps taps"]:
    """Matrix T with fᵀTf = tr(weightsᵀ Uᵀ Σ⁻¹ U weights), one for any filter f."""
    spread = weights @ weights.T
    lagged = np.tensordot(flank.lag_products[:lags], spread, 2)
    form = lagged[np.abs(np.subtract.outer(np.arange(lags), np.arange(lags)))]
    ends = flank.ends[:, : lags - 1] @ weights
    products = np.einsum("rad,rbd->ab", ends, ends)
    for shift in range(lags - 1):
        form[shift + 1 :, shift + 1 :] -= products[: lags - 1 - shift, : lags - 1 - shift]
    return form


def _lowest(curvature: float, slope: float, count: int) -> float:
    """π with the lowest curvature π² + 2 slope π − count log(1 − π²), convex, within the bound."""
    found = brentq(lambda p: (curvature * p + slope) * (1 - p**2) + count * p, -1.0, 1.0)
    return float(np.clip(np.asarray(found), -LARGEST, LARGEST))
