"""The harmonic summary: everything a fit needs to know of its logs, in a few dozen numbers a lag.

With z_t the block rows [regressors, y] of one flank, the summary keeps their triangular factor F,
the lag products Γ_l = Σ u_t u_{t−l}ᵀ of the conditioned rows u_t = F⁻ᵀ z_t of every uninterrupted
run, and its first and last rows. From those the least squares under any autoregressive noise follow
in O(L p²), however long the logs were.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from ...base.numerics.autoregression import whitening_filter
from ...pair.gear_pair import Flank
from ..model.column_layout import OFFSET, ColumnLayout
from ..model.harmonics import TermPlan
from ..settings import HIGHEST_LAG, NoiseSettings
from .block_rows import LogRows
from .flank_summary import (
    FlankSummary,
    Runs,
    conditioned_runs,
    irregular_flank,
    summarise_conditioned,
)
from .orthogonal import residual_weights

FLANKS: tuple[Flank, ...] = ("A", "B")

ROUNDING = 1e-12
"""Share of y² below which residuals are rounding: a millionth of the transmission error, which no
encoder resolves. Readings of 1e4 rad at 16 digits round by a hundredth of that."""

_SAME_SPEED = 0.05

Embedding = dict[Flank, Float[np.ndarray, "_ _"]]
"""Flank → matrix from a row of one log alone to a row of all logs."""


@dataclass(frozen=True)
class HarmonicSummary:
    """Summary of all logs of a fit.

    **Arguments**
    - `flanks`: one summary a flank that has certain samples.
    - `terms`, `columns`: what the columns of the rows are.
    - `block_s`: duration of a block.
    - `embeddings`: log by log, how the rows of that log alone become rows of all.
    - `plateaus`: the summary of every speed by itself, where each has noise of its own.
    - `noise`: what is assumed of the noise.
    - `last_digit`: what the last digit of the readings makes of y, rad.
    """

    flanks: tuple[FlankSummary, ...]
    terms: TermPlan
    columns: ColumnLayout
    block_s: float
    embeddings: tuple[Embedding, ...] = ()
    plateaus: tuple["PlateauSummary", ...] = ()
    noise: NoiseSettings = NoiseSettings()
    last_digit: float = 0.0

    @property
    def rows(self) -> int:
        """Number of block rows of all flanks."""
        return sum(flank.rows for flank in self.flanks)

    @property
    def counted_rows(self) -> float:
        """The same, rows that a robust loss weighs down counted by their weight."""
        offsets = [self.columns.index(OFFSET, log) for log in range(len(self.columns.own))]
        return sum(flank.square(k) for flank in self.flanks for k in offsets)

    @property
    def rounding(self) -> float:
        """Sum of squared residuals below which there is no noise, in rad²."""
        share = ROUNDING * sum(flank.square(-1) for flank in self.flanks)
        return share + self.rows * self.last_digit**2

    def keeping(self, own: Sequence[tuple[str, ...]]) -> "HarmonicSummary":
        """The same summary with only these own columns of every log."""
        columns = ColumnLayout(self.columns.free, self.columns.tied, tuple(own))
        dropped = [
            self.columns.index(name, log)
            for name, log in self.columns.names
            if name not in own[log]
        ]
        keep = np.delete(np.arange(self.columns.width), dropped)
        flanks = tuple(flank.selected(keep) for flank in self.flanks)
        embeddings = tuple(
            {flank: matrix[keep] for flank, matrix in one.items()} for one in self.embeddings
        )
        plateaus = tuple(replace(p, summary=p.summary.keeping(own)) for p in self.plateaus)
        return replace(
            self, columns=columns, flanks=flanks, embeddings=embeddings, plateaus=plateaus
        )

    def without(self, names: Sequence[str]) -> "HarmonicSummary":
        """The same summary with own columns of these names left out of every log."""
        return self.keeping(
            [tuple(name for name in own if name not in names) for own in self.columns.own]
        )


@dataclass(frozen=True)
class PlateauSummary:
    """The summary of all runs of one speed, rad/s of the driving shaft, in either direction."""

    speed: float
    summary: HarmonicSummary


def summarise(
    logs: Sequence[LogRows],
    terms: TermPlan,
    layout: tuple[ColumnLayout, tuple[Embedding, ...]] | None = None,
) -> HarmonicSummary:
    """Add up the rows of several logs of one rig.

    Free and tied harmonics are shared; every log keeps its own columns. The lags are those the
    noise asks for. `layout` says where the columns of every log go; by default side by side.
    """
    layout = _side_by_side(logs) if layout is None else layout
    whole = _summarised(logs, terms, layout)
    noise = logs[0].noise
    if noise.of == "rig":
        return whole
    speeds = plateau_speeds([run.segment.speed for log in logs for run in log.runs])
    plateaus = []
    for speed in speeds:
        part = _summarised([_at_speed(log, speed, speeds) for log in logs], terms, layout)
        if noise.stationary_in == "angle":
            part = replace(part, block_s=part.block_s * speeds[-1] / speed)
        if part.flanks:
            plateaus.append(PlateauSummary(speed, part))
    return replace(whole, plateaus=tuple(plateaus))


def _summarised(
    logs: Sequence[LogRows], terms: TermPlan, layout: tuple[ColumnLayout, tuple[Embedding, ...]]
) -> HarmonicSummary:
    columns, embeddings = layout
    noise = logs[0].noise
    conditioned = [_conditioned(log) for log in logs]
    lags = max((_needed(*found) for found in conditioned), default=1)
    flanks: dict[Flank, FlankSummary] = {}
    for log, embedding, (known, _) in zip(logs, embeddings, conditioned, strict=True):
        for flank, runs in log.runs_by_flank(longer_than=2 * lags).items():
            rows = [run.rows for run in runs]
            if noise.kind == "ou":
                times = [run.curve.time for run in runs]
                part = irregular_flank(flank, rows, times, logs[0].block_s)
            else:
                seen = known.get(flank)
                if seen is None or len(seen[0]) != len(rows):
                    seen = conditioned_runs(rows)
                part = summarise_conditioned(flank, seen, lags)
            if len(logs) > 1:
                part = part.transformed(embedding[flank])
            flanks[flank] = flanks[flank] + part if flank in flanks else part
    ordered = tuple(flanks[flank] for flank in FLANKS if flank in flanks)
    last_digit = max(log.rounding for log in logs)
    return HarmonicSummary(
        ordered, terms, columns, logs[0].block_s, embeddings, (), noise, last_digit
    )


def plateau_speeds(speeds: Sequence[float]) -> tuple[float, ...]:
    """Distinct speeds, slowest first: those within a twentieth of each other are one."""
    found: list[list[float]] = []
    for speed in sorted(abs(speed) for speed in speeds):
        if found and speed <= found[-1][0] * (1 + _SAME_SPEED):
            found[-1].append(speed)
        else:
            found.append([speed])
    return tuple(float(np.mean(group)) for group in found)


def _at_speed(log: LogRows, speed: float, speeds: Sequence[float]) -> LogRows:
    runs = [
        run
        for run in log.runs
        if min(speeds, key=lambda other: abs(other - abs(run.segment.speed))) == speed
    ]
    return replace(log, runs=tuple(runs))


def _side_by_side(logs: Sequence[LogRows]) -> tuple[ColumnLayout, tuple[Embedding, ...]]:
    """Logs whose angles have one zero: each has its own columns, and shares the harmonics."""
    columns = ColumnLayout(
        logs[0].columns.free, logs[0].columns.tied, tuple(log.columns.own[0] for log in logs)
    )
    return columns, tuple(dict.fromkeys(FLANKS, columns.embedding(log)) for log in range(len(logs)))


def needed_lags(log: LogRows) -> int:
    """Lags the noise asks for: the order of the ordinary residual's autoregression and two more."""
    return _needed(*_conditioned(log))


def _conditioned(log: LogRows) -> tuple[dict[Flank, Runs], int]:
    """Conditioned rows of the runs that tell how many lags the noise asks for, and the most."""
    if log.noise.kind != "ar":
        return {}, 0
    longest = max((len(run.rows) for run in log.runs), default=0)
    most = int(np.clip(longest // 8, 1, HIGHEST_LAG))
    by_flank = log.by_flank(longer_than=2 * most)
    return {flank: conditioned_runs(runs) for flank, runs in by_flank.items()}, most


def _needed(conditioned: dict[Flank, Runs], most: int) -> int:
    needed = 1
    for pieces, pseudo, _ in conditioned.values():
        gram = sum((rows.T @ rows for rows in pieces), pseudo.T @ pseudo)
        weights = residual_weights(np.linalg.cholesky(gram).T)
        residuals = [rows @ weights for rows in pieces]
        count = sum(map(len, residuals))
        covariance = [
            sum(float(r[lag:] @ r[: len(r) - lag]) for r in residuals) / count
            for lag in range(most + 1)
        ]
        needed = max(needed, len(whitening_filter(np.array(covariance), count)) + 1)
    return min(needed, most)
