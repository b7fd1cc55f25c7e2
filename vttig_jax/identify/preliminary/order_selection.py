"""Selection of the higher orders in a log of few turns, where slow noise resembles an order.

A higher order enters the model if the joint F test that its coefficients are zero on all flanks f,

    F = Σ_f b_fᵀ C_f⁻¹ b_f / r,

is significant. b_f are the cosine and sine coefficients of the order on flank f, C_f is their
covariance, and r is the number of coefficients on all flanks. The noise is estimated by restricted
likelihood with the order in the model, because otherwise the noise would contain the order. The
degrees of freedom are those of A. Fai and P. Cornelius (J. Stat. Comput. Simul. 54 (1996) 363).
First orders are parameters and always stay.

The orders enter one after the other. This fails if each order alone is small compared with the
orders that are still missing. Therefore all candidates stay if the likelihood of the model with all
of them is much larger.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float
from scipy.special import fdtrc

from ...base.numerics.partial_autocorrelation import filter_of
from ...pair.schema import HarmonicOrders
from ..compress.harmonic_summary import HarmonicSummary
from ..model.column_layout import ColumnLayout
from ..model.harmonics import AnyTerm, Harmonic
from ..noise.freedom import freedom
from ..noise.noise_model import remembers
from ..noise.reml import freedom_left, restricted_partial

_UNLIKELY = 1e-3
"""Probability that at least one order enters that the rig does not have; chosen value."""

_GAIN = 4.5
"""All candidates stay if twice the log-likelihood grows by more than this per coefficient (chosen).
The average growth is 1 if the rig has no such order. With coloured noise, which an autoregression
describes only nearly, one of 72 rigs exceeded 3.5; rigs with small orders reach at least 5.5
(measured)."""

_TRIED = 3  # orders with the largest F of a step, for which the noise is estimated; chosen value


def entering_orders(
    summary: HarmonicSummary,
    candidates: Sequence[Harmonic],
    wanted: HarmonicOrders,
    *,
    any_noise: bool,
) -> HarmonicOrders | None:
    """Return the orders of `wanted` that stay in the model: first orders, and orders that enter.

    If a mesh order enters, all lower mesh orders stay too. In a log without noise all candidates
    stay.

    **Arguments**
    - `summary`: rows with the columns of all candidates.
    - `candidates`: higher orders that may enter.
    - `any_noise`: make the selection for any noise. If it is False, the result is None unless the
      noise is correlated over a part of the log. This is tested with all candidates, which may hide
      the correlation, and without them, because missing orders may look like correlation.
    """
    free = {h.term for h in candidates}
    none = _with_only(summary, set())
    if not (any_noise or remembers(summary) or remembers(none)):
        return None
    left = sum(f.factor(np.ones(1))[-1, -1] ** 2 for f in summary.flanks)
    entered = free if left <= summary.rounding else _entered(summary, free)
    if entered != free and _are_needed(summary, entered):
        # Tested with all columns, because missing orders also look like correlated noise.
        if not (any_noise or remembers(summary)):
            return None
        entered = free
    if not (any_noise or remembers(_with_only(summary, entered))):
        return None
    kept = [h for h in candidates if h.term in entered]
    stays = {(h.shaft, h.order) for h in kept} | {("driving", 1), ("driven", 1)}
    return HarmonicOrders(
        driving_orders=tuple(k for k in wanted.driving_orders if ("driving", k) in stays),
        driven_orders=tuple(k for k in wanted.driven_orders if ("driven", k) in stays),
        mesh_orders=int(max((h.order for h in kept if h.shaft == "mesh"), default=0)),
    )


def _entered(summary: HarmonicSummary, candidates: set[AnyTerm]) -> set[AnyTerm]:
    """Return the candidates that enter the model, one after the other, most significant first."""
    entered: set[AnyTerm] = set()
    while candidates - entered:
        partial = restricted_partial(_with_only(summary, entered))
        more = {term: _with_only(summary, entered | {term}) for term in candidates - entered}
        ranked = sorted(more, key=lambda term: -_test(more[term], term, partial)[0])
        found = {
            term: _probability(more[term], term, restricted_partial(more[term]))
            for term in ranked[:_TRIED]
        }
        best = min(found, key=lambda term: found[term])
        if found[best] >= _UNLIKELY / len(candidates):
            break
        entered.add(best)
    return entered


def _are_needed(summary: HarmonicSummary, entered: set[AnyTerm]) -> bool:
    """Return whether the model with all candidates is much more likely than that with `entered`."""
    fewer = _with_only(summary, entered)
    gain = _log_likelihood(summary) - _log_likelihood(fewer)
    more = len(summary.flanks) * (summary.columns.free_width - fewer.columns.free_width)
    return 2 * gain > _GAIN * more


def _log_likelihood(summary: HarmonicSummary) -> float:
    """Return the log-likelihood of the rows, with the noise estimated from their own residual."""
    partial = restricted_partial(summary)
    misfit = sum(float(f.factor(filter_of(partial))[-1, -1] ** 2) for f in summary.flanks)
    height = summary.counted_rows * np.log(max(misfit, summary.rounding, 1e-300))
    height += sum(flank.log_determinant(partial) for flank in summary.flanks)
    return -0.5 * float(height)


def _with_only(summary: HarmonicSummary, free: set[AnyTerm]) -> HarmonicSummary:
    """Return the summary without the free harmonics that are not in `free`."""
    columns = summary.columns
    kept = [place for place, term in enumerate(columns.free) if term in free]
    cells = [2 * place + part for place in kept for part in (0, 1)]
    keep = np.array([*cells, *range(columns.free_width, columns.width)])
    return replace(
        summary,
        columns=ColumnLayout(tuple(columns.free[k] for k in kept), columns.tied, columns.own),
        flanks=tuple(flank.selected(keep) for flank in summary.flanks),
        plateaus=(),
    )


def _test(
    summary: HarmonicSummary, term: AnyTerm, partial: Float[np.ndarray, " order"]
) -> tuple[float, list[Float[np.ndarray, "columns r"]]]:
    """Return the statistic F of a term, and its responses on every flank, for the given noise.

    The responses of a flank are the covariances of all its coefficients with those of the term, in
    the principal directions of the latter. `partial` are the partial autocorrelations of the noise.
    """
    place = 2 * summary.columns.free.index(term)
    cells, filter_ = [place, place + 1], filter_of(partial)
    total = misfit = 0.0
    responses = []
    for side, flank in enumerate(summary.flanks):
        factor = flank.factor(filter_)
        inverse = np.linalg.inv(factor[:-1, :-1])
        value, own = inverse[cells] @ factor[:-1, -1], inverse[cells] @ inverse[cells].T
        total += float(value @ np.linalg.solve(own, value))
        misfit += float(factor[-1, -1] ** 2)
        response = np.zeros((len(inverse), 2 * len(summary.flanks)))
        directions = np.linalg.eigh(own)[1]
        response[:, 2 * side : 2 * side + 2] = inverse @ inverse[cells].T @ directions
        responses.append(response)
    variance = max(misfit, summary.rounding) / freedom_left(summary)
    return total / variance / (2 * len(responses)), responses


def _probability(
    summary: HarmonicSummary, term: AnyTerm, partial: Float[np.ndarray, " order"]
) -> float:
    """Return the p-value of the F test: the probability of a larger F if the term is absent."""
    statistic, responses = _test(summary, term, partial)
    each, count = freedom(summary, partial, responses), 2 * len(responses)
    mean = float(np.sum(each / (each - 2.0)))
    return float(fdtrc(count, 2 * mean / (mean - count), statistic))
