"""Summaries of made-up block rows, lag products summed row by row."""

from fractions import Fraction

import numpy as np

from vttig_jax.identify.blocks import BlockPlan
from vttig_jax.identify.summary import FlankSummary, HarmonicSummary
from vttig_jax.identify.terms import Harmonic, TermPlan

TERMS = TermPlan(
    Fraction(9, 16),
    (Harmonic("driving", 2, (2, 0)),),
    (Harmonic("driving", 1, (1, 0)), Harmonic("driven", 1, (0, 1))),
    (),
)


def flank_summary(flank, runs: list[np.ndarray], lags: int) -> FlankSummary:
    width = runs[0].shape[1]
    products = np.zeros((lags + 1, width, width))
    for rows in runs:
        for t in range(len(rows)):
            for lag in range(min(lags, t) + 1):
                products[lag] += np.outer(rows[t], rows[t - lag])
    heads, tails = (
        np.stack([rows[part] for rows in runs]) for part in (slice(lags), slice(-lags, None))
    )
    return FlankSummary(flank, products, heads, tails, sum(map(len, runs)))


def columns(count: int, drift_order: int) -> np.ndarray:
    """Regressors of `TERMS` over `count` blocks, without y."""
    angle = np.linspace(0, 40 * np.pi, count)
    time = np.linspace(-1, 1, count)
    driven = angle * 9 / 16
    drift = [time**power for power in range(drift_order + 1)]
    first = [np.cos(angle), np.sin(angle), np.cos(driven), np.sin(driven)]
    return np.stack([np.cos(2 * angle), np.sin(2 * angle), *drift, *first], axis=1)


def summary_of(flanks: dict, drift_order: int = 0, lags: int = 8) -> HarmonicSummary:
    """A summary of {flank: [rows, …]}, rows in the order of `columns` with y behind."""
    free, tied = (tuple(h.term for h in part) for part in (TERMS.free, TERMS.tied))
    return HarmonicSummary(
        flanks=tuple(flank_summary(flank, runs, lags) for flank, runs in flanks.items()),
        terms=TERMS,
        plan=BlockPlan(free, tied, drift_order, 1),
        block_s=0.01,
        time_origin_s=0.0,
        time_scale_s=1.0,
        segments=(),
        curves=(),
        samples_used={},
    )
