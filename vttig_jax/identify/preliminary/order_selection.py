"""Selection of the higher orders on few turns, where noise resembles them.

A higher order enters the model if the joint test that its coefficients are zero on every flank,

    F = Σ_f b_fᵀ C_f⁻¹ b_f / r,

with r coefficients b_f of covariance C_f, is significant. The noise of the test is estimated by
restricted likelihood with the order in the model, because it would otherwise contain the order. The
degrees of freedom are those of A. Fai and P. Cornelius (J. Stat. Comput. Simul. 54 (1996) 363).
First orders are parameters and always stay.

One order after the other cannot enter where each is small beside the others that are still outside.
All candidates therefore stay if the likelihood with the noise that they leave demands them.
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
"""Probability with which any order enters that the rig does not have; chosen value."""

_GAIN = 4.5
"""Gain of twice the log-likelihood per coefficient with which all candidates stay (chosen). It is 1
on average without any order. Coloured noise, which an autoregression describes only nearly,
exceeded 3.5 in one of 72 rigs; rigs with small orders begin at 5.5 (measured)."""

_TRIED = 3  # orders per step whose noise is estimated, the largest F first; chosen value


def entering_orders(
    summary: HarmonicSummary,
    candidates: Sequence[Harmonic],
    wanted: HarmonicOrders,
    *,
    any_noise: bool,
) -> HarmonicOrders | None:
    """Return the orders of those wanted that the log shows: first orders, and what enters.

    Mesh orders enter with all below them. All orders stay in a log without noise, and the result is
    then that of all candidates.

    **Arguments**
    - `summary`: rows with the columns of all candidates.
    - `candidates`: higher orders that may enter.
    - `any_noise`: whether noise of any memory counts. Otherwise the result is None for noise that
      does not remember a part of the log. So many orders may hide the memory of the noise, and
      orders that are left out may look like one; both are asked.
    """
    free = {h.term for h in candidates}
    none = _with_only(summary, set())
    if not (any_noise or remembers(summary) or remembers(none)):
        return None
    left = sum(f.factor(np.ones(1))[-1, -1] ** 2 for f in summary.flanks)
    entered = free if left <= summary.rounding else _entered(summary, free)
    if entered != free and _are_needed(summary, entered):
        # With all columns, because those that are too close on few turns look like memory as well.
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
    """Return the candidates that enter, one after the other, the most significant first."""
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
    """Return whether the likelihood demands all candidates instead of those that entered."""
    fewer = _with_only(summary, entered)
    gain = _log_likelihood(summary) - _log_likelihood(fewer)
    more = len(summary.flanks) * (summary.columns.free_width - fewer.columns.free_width)
    return 2 * gain > _GAIN * more


def _log_likelihood(summary: HarmonicSummary) -> float:
    """Return the largest log-likelihood of the rows with the noise that they leave."""
    partial = restricted_partial(summary)
    misfit = sum(float(f.factor(filter_of(partial))[-1, -1] ** 2) for f in summary.flanks)
    height = summary.counted_rows * np.log(max(misfit, summary.rounding, 1e-300))
    height += sum(flank.log_determinant(partial) for flank in summary.flanks)
    return -0.5 * float(height)


def _with_only(summary: HarmonicSummary, free: set[AnyTerm]) -> HarmonicSummary:
    """Return the summary with only these free harmonics."""
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
    """Return F, and for every flank the covariance of all coefficients with those of the term."""
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
    """Return the probability of a larger F if the term is zero on every flank."""
    statistic, responses = _test(summary, term, partial)
    each, count = freedom(summary, partial, responses), 2 * len(responses)
    mean = float(np.sum(each / (each - 2.0)))
    return float(fdtrc(count, 2 * mean / (mean - count), statistic))
