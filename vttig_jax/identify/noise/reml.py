"""Noise of one log by restricted maximum likelihood, with NumPy and from lag products alone.

The likelihood, its bound and the constants are those of `restricted_likelihood`.
"""

from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.linalg import solve_triangular
from scipy.optimize import minimize_scalar

from ...base.numerics.autoregression import levinson_step
from ...base.numerics.partial_autocorrelation import filter_of
from ..compress.harmonic_summary import HarmonicSummary
from .restricted_likelihood import (
    LARGEST,
    MOST_STEPS,
    SEARCHES,
    SETTLED,
    SWEEPS,
    Bound,
    best_partial,
    flank_form,
    misfit_weight,
    rounding_form,
)

_SHORTER = 0.95  # factor per reduction of the partial autocorrelations; chosen value
_FREQUENCIES = 4096
"""Number of points of the noise spectrum. They resolve the narrowest peak, which belongs to a
partial autocorrelation of 0.999."""

_WIDEST_GAIN = 1e5
"""Largest ratio of the gains of a whitening filter. Its square, 1e10, is the condition number of
the factored matrix, so six of the sixteen digits of a float remain."""

_FINE = {"xatol": 1e-8}  # absolute tolerance of the correlation ρ; chosen value

Partial = Float[np.ndarray, " p"]


def restricted_partial(summary: HarmonicSummary) -> Partial:
    """Return the partial autocorrelations of the noise; BIC selects their number.

    Ornstein–Uhlenbeck noise has at most one: the correlation of rows at the median distance in
    time.
    """
    if not summary.kind.summary.QUADRATIC:
        return _correlation(summary)
    partial = np.zeros(0)
    for _ in range(SEARCHES):
        bound = touching_bound(summary, _representable(partial))
        partial = _of_best_order(bound, summary.rows)
    for _ in range(MOST_STEPS):
        before = _representable(partial)
        if before is not partial:
            return before
        partial = lowered(touching_bound(summary, before), before)
        if np.abs(partial - before).max(initial=0.0) < SETTLED:
            break
    return _representable(partial)


def _representable(partial: Partial) -> Partial:
    """Return `partial`, reduced until the range of the noise spectrum suits the digits of a float.

    The residual of a wrong model can be so smooth that whitening with its noise model removes all
    digits of slowly varying columns.
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


def _of_best_order(bound: Bound, rows: int) -> Partial:
    """Return the partial autocorrelations of the order with the lowest BIC.

    Each order starts from the result of the previous order.
    """
    partial = best = np.zeros(0)
    lowest = bound.at(partial, filter_of(partial))
    for order in range(1, len(bound.form)):
        partial = np.append(partial, 0.0)
        for _ in range(SWEEPS):
            partial = lowered(bound, partial)
        score = bound.at(partial, filter_of(partial)) + order * np.log(max(rows, 2))
        if score < lowest:
            best, lowest = partial, score
    return best


def touching_bound(summary: HarmonicSummary, partial: Partial) -> Bound:
    """Return the bound that touches the restricted likelihood at `partial`."""
    filter_ = filter_of(partial)
    taps = min(len(flank.lag_products) for flank in summary.flanks)
    triangles = [flank.inner(filter_) for flank in summary.flanks]
    left = [
        float(triangle[-1, -1] * flank.triangle[-1, -1])
        for flank, triangle in zip(summary.flanks, triangles, strict=True)
    ]
    misfit = np.float64(np.dot(left, left))
    weight = misfit_weight(misfit, freedom_left(summary), summary.rounding, filter_)
    form = rounding_form(summary.rounding, weight, taps)
    for flank, triangle, own in zip(summary.flanks, triangles, left, strict=True):
        inverse = solve_triangular(triangle, np.eye(len(triangle)), check_finite=False)
        lagged, ends = flank.lag_products[:taps], flank.ends[:, : taps - 1]
        form = form + flank_form(lagged, ends, inverse, own, weight)
    return Bound(form, sum(len(flank.heads) for flank in summary.flanks))


def lowered(bound: Bound, partial: Partial) -> Partial:
    """Return the partial autocorrelations after one coordinate descent of the bound.

    The bound is minimised over one π_k at a time, from the last π_k to the first, because the last
    one has no estimate yet in a search of the order. With the filter f_k of the first k partial
    autocorrelations and its reverse f_k*, the whole filter is the polynomial A f_k + B f_k*. One
    step to a lower k replaces A by A − π_k B and B by z (B − π_k A) (Szegő).
    """
    partial = partial.copy()
    taps = len(partial) + 1
    form = bound.form[:taps, :taps]
    prefixes = [np.ones(1)]
    for value in partial[:-1]:
        prefixes.append(levinson_step(prefixes[-1], value))
    ahead, back = np.ones(1), np.zeros(1)
    for k in reversed(range(len(partial))):
        own = np.append(prefixes[k], 0.0)
        without = np.convolve(ahead, own) + np.convolve(back, own[::-1])
        slope = -np.convolve(ahead, own[::-1]) - np.convolve(back, own)
        along = slope @ form
        curvature, first = float(along @ slope), float(along @ without)
        partial[k] = best_partial(curvature, first, bound.runs * (k + 1))
        ahead, back = (
            np.append(ahead - partial[k] * back, 0.0),
            np.append(0.0, back - partial[k] * ahead),
        )
    return partial
