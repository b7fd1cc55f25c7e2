"""The harmonic summary: everything a fit needs to know of a log, in a few dozen numbers a lag.

With z_t the block rows [regressors, y] of one flank, the summary keeps the lag products
Γ_l = Σ z_t z_{t−l}ᵀ of every uninterrupted run and its first and last rows. From those the normal
equations under any autoregressive noise follow in O(L p²), however long the log was.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ..base.units import REV
from ..kinematics.te_curve import TECurve
from ..logs.encoder_log import EncoderLog
from ..logs.segments import Segment
from ..pair.gears import Flank
from .autoregression import whitening_filter
from .blocks import BlockPlan, block_means, block_rows, block_size
from .normal_equations import residual_weights
from .terms import TermPlan

HIGHEST_LAG = 16
"""Highest autoregressive order the summary can whiten."""

_CACHED_ROWS = 512


@dataclass(frozen=True)
class FlankSummary:
    """Lag products of the block rows of one flank, summed over its runs.

    **Arguments**
    - `lag_products`: Γ_0 … Γ_L, shape (L + 1, q, q); y is the last of the q columns. L is what
      the noise of the log asks for, 16 at most.
    - `heads`, `tails`: the first and last L rows of every run, shape (runs, L, q).
    - `rows`: number of block rows in all runs together.
    """

    flank: Flank
    lag_products: Float[np.ndarray, "lags q q"]
    heads: Float[np.ndarray, "runs lag q"]
    tails: Float[np.ndarray, "runs lag q"]
    rows: int

    def whitened(self, filter_: Float[np.ndarray, " taps"]) -> Float[np.ndarray, "q q"]:
        """Σ w_t w_tᵀ with w_t = Σ_j filter_j z_{t−j}, over all rows that have a full history.

        Filtering every run between zeros gives Σ_{jk} filter_j filter_k Γ_{k−j}; the rows that
        reach over either end of a run are then taken away again.
        """
        order = len(filter_) - 1
        products = np.correlate(filter_, filter_, "full")[order:]
        total = products[0] * self.lag_products[0]
        for product, gram in zip(products[1:], self.lag_products[1:], strict=False):
            total = total + product * (gram + gram.T)
        if order == 0:
            return total
        starting = _filtered(filter_, self.heads[:, :order])
        ended = np.concatenate([self.tails[:, -order:], np.zeros_like(starting)], axis=1)
        ending = _filtered(filter_, ended)[:, order:]
        ends = np.concatenate([starting, ending], axis=1).reshape(-1, total.shape[0])
        return total - ends.T @ ends

    def whitened_rows(self, order: int) -> int:
        """Rows that have a full history under a filter of this order."""
        return self.rows - order * len(self.heads)


@dataclass(frozen=True)
class HarmonicSummary:
    """Summary of a whole log.

    **Arguments**
    - `flanks`: one summary a flank that has certain samples.
    - `terms`, `plan`: what the columns of the rows are.
    - `block_s`: duration of a block.
    - `time_origin_s`, `time_scale_s`: drift columns are powers of (t − origin)/scale.
    - `segments`: the runs that were long enough, in the order of `curves`.
    - `curves`: the block-averaged transmission error, for pictures and checks.
    - `samples_used`: by flank.
    """

    flanks: tuple[FlankSummary, ...]
    terms: TermPlan
    plan: BlockPlan
    block_s: float
    time_origin_s: float
    time_scale_s: float
    segments: tuple[Segment, ...]
    curves: tuple[TECurve, ...]
    samples_used: dict[str, int]

    @property
    def rows(self) -> int:
        """Number of block rows of all flanks."""
        return sum(flank.rows for flank in self.flanks)


def compress(
    log: EncoderLog,
    segments: tuple[Segment, ...],
    terms: TermPlan,
    drift_order: int,
    correction: dict[str, Float[np.ndarray, " n"]],
) -> HarmonicSummary:
    """Pass once over the certain segments of a log.

    `correction` is subtracted from the transmission error, flank by flank (rad, one value a
    sample): the known effect of a logged axial position.
    """
    driving, driven = log.driving_angle, log.driven_angle
    error = log.transmission_error
    sample_s = float(np.median(np.diff(log.time)))
    highest = float(max((terms.frequency(term) for term in terms.terms), default=1))
    size = block_size(_samples_per_turn(driving, segments), highest)
    plan = BlockPlan(
        tuple(h.term for h in terms.free), tuple(h.term for h in terms.tied), drift_order, size
    )
    origin, scale = (log.time[0] + log.time[-1]) / 2, (log.time[-1] - log.time[0]) / 2
    longest = max((s.stop - s.start for s in segments), default=0) // size
    most = int(np.clip(longest // 8, 1, HIGHEST_LAG))
    runs: dict[Flank, list[np.ndarray]] = {"A": [], "B": []}
    kept = tuple(s for s in segments if (s.stop - s.start) // size > 2 * most)
    curves = []
    for segment in kept:
        part = slice(segment.start, segment.stop)
        y = error[part]
        if segment.flank in correction:
            y = y - correction[segment.flank][part]
        time = log.time[part]
        rows = block_rows(plan, driving[part], driven[part], (time - origin) / scale, y)
        runs[segment.flank].append(rows)
        means = (block_means(channel, size) for channel in (driving[part], y, time))
        curves.append(TECurve(segment.flank, *means))
    lags = max((_needed_lags(rows, most) for rows in runs.values() if rows), default=1)
    return HarmonicSummary(
        tuple(_summarise(flank, rows, lags) for flank, rows in runs.items() if rows),
        terms,
        plan,
        size * sample_s,
        float(origin),
        float(scale),
        kept,
        tuple(curves),
        {flank: size * sum(map(len, rows)) for flank, rows in runs.items()},
    )


def _needed_lags(runs: list[Float[np.ndarray, "_ q"]], most: int) -> int:
    """Lags the noise asks for: the order of the ordinary residual's autoregression and two more."""
    weights = residual_weights(np.sum([rows.T @ rows for rows in runs], axis=0))
    residuals = [rows @ weights for rows in runs]
    count = sum(map(len, residuals))
    covariance = [
        sum(float(r[lag:] @ r[: len(r) - lag]) for r in residuals) / count
        for lag in range(most + 1)
    ]
    return min(len(whitening_filter(np.array(covariance), count)) + 1, most)


def _samples_per_turn(driving: Float[np.ndarray, " n"], segments: tuple[Segment, ...]) -> float:
    """Samples a driving turn where it is fastest, seen over a 64th of a turn at mean speed.

    The fastest place decides: no block may cover more of a cycle than planned.
    """
    travelled = sum(abs(driving[s.stop - 1] - driving[s.start]) for s in segments)
    samples = sum(s.stop - s.start for s in segments)
    window = max(1, int(samples * REV / max(travelled, 1e-9) / 64))
    steps = [np.abs(np.diff(driving[s.start : s.stop : window])) for s in segments]
    fastest = max((float(step.max(initial=0.0)) for step in steps), default=0.0)
    return window * REV / max(fastest, 1e-9)


def _summarise(flank: Flank, runs: list[Float[np.ndarray, "_ q"]], lags: int) -> FlankSummary:
    products = np.sum([_lag_products(rows, lags) for rows in runs], axis=0)
    return FlankSummary(
        flank,
        products,
        np.stack([rows[:lags] for rows in runs]),
        np.stack([rows[-lags:] for rows in runs]),
        sum(map(len, runs)),
    )


def _lag_products(rows: Float[np.ndarray, "n q"], lags: int) -> Float[np.ndarray, "lags q q"]:
    """Σ_t z_t z_{t−l}ᵀ of one run for l = 0 … lags, in pieces that stay in cache for all lags."""
    products = np.zeros((lags + 1, rows.shape[1], rows.shape[1]))
    for start in range(0, len(rows), _CACHED_ROWS):
        now = rows[start : start + _CACHED_ROWS]
        for lag in range(lags + 1):
            skip = max(lag - start, 0)
            past = rows[start - lag + skip : start - lag + len(now)]
            products[lag] += now[skip:].T @ past
    return products


def _filtered(
    filter_: Float[np.ndarray, " taps"], rows: Float[np.ndarray, "runs n q"]
) -> Float[np.ndarray, "runs n q"]:
    """w_t = Σ_j filter_j z_{t−j} with zeros before the first row."""
    result = np.zeros_like(rows)
    for lag, weight in enumerate(filter_[: rows.shape[1]]):
        result[:, lag:] += weight * rows[:, : rows.shape[1] - lag]
    return result
