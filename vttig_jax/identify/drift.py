"""How slow a drift the log shows: the power of time that the information criterion asks for."""

from dataclasses import replace

import numpy as np

from .noise import misfit, whiten
from .summary import FlankSummary, HarmonicSummary

HIGHEST_DRIFT = 6
AUTOMATIC_DRIFT = 2
"""Highest power of time that is chosen without being asked for."""


def with_drift(summary: HarmonicSummary, order: int) -> HarmonicSummary:
    """The same summary with the powers of time above `order` left out."""
    first = 2 * len(summary.plan.free) + 1
    keep = np.delete(
        np.arange(summary.plan.width), slice(first + order, first + summary.plan.drift_order)
    )
    return replace(
        summary,
        plan=replace(summary.plan, drift_order=order),
        flanks=tuple(_reduced(flank, keep) for flank in summary.flanks),
    )


def choose_drift(summary: HarmonicSummary) -> int:
    """Power of time, 0 to 2, by BIC.

    All powers are judged under one noise, that of the highest: each with its own would trade drift
    for correlation.
    """
    noise, _ = whiten(summary)
    if noise.innovation_std == 0:
        return 0
    scores = []
    for order in range(AUTOMATIC_DRIFT + 1):
        left = misfit(with_drift(summary, order), noise.filter)
        parameters = order * len(summary.flanks)
        scores.append(summary.rows * np.log(left) + parameters * np.log(summary.rows))
    return int(np.argmin(scores))


def _reduced(flank: FlankSummary, keep: np.ndarray) -> FlankSummary:
    return replace(
        flank,
        lag_products=flank.lag_products[:, keep][:, :, keep],
        heads=flank.heads[:, :, keep],
        tails=flank.tails[:, :, keep],
    )
