"""The harmonic summary: everything a fit needs to know of its logs, in a few dozen numbers a lag.

With z_t the block rows [regressors, y] of one flank, the summary keeps the lag products
Γ_l = Σ z_t z_{t−l}ᵀ of every uninterrupted run and its first and last rows. From those the normal
equations under any autoregressive noise follow in O(L p²), however long the logs were.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from ..base.autoregression import whitening_filter
from ..pair.gears import Flank
from .columns import Columns
from .normal_equations import residual_weights
from .rows import LogRows
from .terms import TermPlan

FLANKS: tuple[Flank, ...] = ("A", "B")

HIGHEST_LAG = 16
"""Highest autoregressive order the summary can whiten."""

_CACHED_ROWS = 512


@dataclass(frozen=True)
class FlankSummary:
    """Lag products of the block rows of one flank, summed over its runs.

    **Arguments**
    - `lag_products`: Γ_0 … Γ_L, shape (L + 1, q, q); y is the last of the q columns. L is what
      the noise of the logs asks for, 16 at most.
    - `heads`, `tails`: the first and last L rows of every run, shape (runs, L, q).
    - `rows`: number of block rows in all runs together.
    """

    flank: Flank
    lag_products: Float[np.ndarray, "lags q q"]
    heads: Float[np.ndarray, "runs lag q"]
    tails: Float[np.ndarray, "runs lag q"]
    rows: int

    def __add__(self, other: "FlankSummary") -> "FlankSummary":
        """Both together: nothing reaches from a run of one into a run of the other."""
        return FlankSummary(
            self.flank,
            self.lag_products + other.lag_products,
            np.concatenate([self.heads, other.heads]),
            np.concatenate([self.tails, other.tails]),
            self.rows + other.rows,
        )

    def transformed(self, matrix: Float[np.ndarray, "new q"]) -> "FlankSummary":
        """The summary of rows z ↦ `matrix` z."""
        return replace(
            self,
            lag_products=matrix @ self.lag_products @ matrix.T,
            heads=self.heads @ matrix.T,
            tails=self.tails @ matrix.T,
        )

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
    """Summary of all logs of a fit.

    **Arguments**
    - `flanks`: one summary a flank that has certain samples.
    - `terms`, `columns`: what the columns of the rows are.
    - `block_s`: duration of a block.
    - `embeddings`: log by log, how the rows of that log alone become rows of all.
    """

    flanks: tuple[FlankSummary, ...]
    terms: TermPlan
    columns: Columns
    block_s: float
    embeddings: tuple["Embedding", ...] = ()

    @property
    def rows(self) -> int:
        """Number of block rows of all flanks."""
        return sum(flank.rows for flank in self.flanks)

    def keeping(self, own: Sequence[tuple[str, ...]]) -> "HarmonicSummary":
        """The same summary with only these own columns of every log."""
        columns = Columns(self.columns.free, self.columns.tied, tuple(own))
        dropped = [
            self.columns.index(name, log)
            for name, log in self.columns.names
            if name not in own[log]
        ]
        keep = np.delete(np.arange(self.columns.width), dropped)
        flanks = tuple(
            replace(
                flank,
                lag_products=flank.lag_products[:, keep][:, :, keep],
                heads=flank.heads[:, :, keep],
                tails=flank.tails[:, :, keep],
            )
            for flank in self.flanks
        )
        embeddings = tuple(
            {flank: matrix[keep] for flank, matrix in one.items()} for one in self.embeddings
        )
        return replace(self, columns=columns, flanks=flanks, embeddings=embeddings)

    def without(self, names: Sequence[str]) -> "HarmonicSummary":
        """The same summary with own columns of these names left out of every log."""
        return self.keeping(
            [tuple(name for name in own if name not in names) for own in self.columns.own]
        )


Embedding = dict[Flank, Float[np.ndarray, "wide narrow"]]
"""Flank → matrix from a row of one log alone to a row of all logs."""


def summarise(
    logs: Sequence[LogRows],
    terms: TermPlan,
    layout: tuple[Columns, tuple[Embedding, ...]] | None = None,
) -> HarmonicSummary:
    """Add up the rows of several logs of one rig.

    Free and tied harmonics are shared; every log keeps its own columns. The lags are those the
    noise asks for. `layout` says where the columns of every log go; by default side by side.
    """
    columns, embeddings = _side_by_side(logs) if layout is None else layout
    lags = max((needed_lags(log) for log in logs), default=1)
    flanks: dict[Flank, FlankSummary] = {}
    for log, embedding in zip(logs, embeddings, strict=True):
        for flank, runs in log.by_flank(longer_than=2 * lags).items():
            part = summarise_flank(flank, runs, lags)
            if len(logs) > 1:
                part = part.transformed(embedding[flank])
            flanks[flank] = flanks[flank] + part if flank in flanks else part
    ordered = tuple(flanks[flank] for flank in FLANKS if flank in flanks)
    return HarmonicSummary(ordered, terms, columns, logs[0].block_s, embeddings)


def _side_by_side(logs: Sequence[LogRows]) -> tuple[Columns, tuple[Embedding, ...]]:
    """Logs whose angles have one zero: each has its own columns, and shares the harmonics."""
    columns = Columns(
        logs[0].columns.free, logs[0].columns.tied, tuple(log.columns.own[0] for log in logs)
    )
    return columns, tuple(dict.fromkeys(FLANKS, columns.embedding(log)) for log in range(len(logs)))


def needed_lags(log: LogRows) -> int:
    """Lags the noise asks for: the order of the ordinary residual's autoregression and two more."""
    longest = max((len(run.rows) for run in log.runs), default=0)
    most = int(np.clip(longest // 8, 1, HIGHEST_LAG))
    needed = 1
    for runs in log.by_flank(longer_than=2 * most).values():
        weights = residual_weights(np.sum([rows.T @ rows for rows in runs], axis=0))
        residuals = [rows @ weights for rows in runs]
        count = sum(map(len, residuals))
        covariance = [
            sum(float(r[lag:] @ r[: len(r) - lag]) for r in residuals) / count
            for lag in range(most + 1)
        ]
        needed = max(needed, len(whitening_filter(np.array(covariance), count)) + 1)
    return min(needed, most)


def summarise_flank(
    flank: Flank, runs: Sequence[Float[np.ndarray, "_ q"]], lags: int
) -> FlankSummary:
    """Lag products and ends of runs that are all longer than `lags`."""
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
