"""Harmonic summary: all data that a fit needs from its logs, a few dozen numbers per lag.

For the block rows z_t = [regressors, y] of one flank, the summary keeps their triangular factor F,
the lag products Γ_l = Σ u_t u_{t−l}ᵀ of the conditioned rows u_t = F⁻ᵀ z_t of every uninterrupted
run, and the first and last rows of the run. They determine the least squares under any
autoregressive noise in O(L p²) operations, independent of the length of the logs.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from ...base.numerics.autoregression import whitening_filter
from ...pair.gear_pair import Flank
from ..model.column_layout import OFFSET, ColumnLayout
from ..model.harmonics import TermPlan
from ..settings import NoiseSettings
from .block_rows import BlockRun, LogRows
from .flank_summary import FlankSummary
from .noise_kinds import NOISE, RowNoise
from .orthogonal import ConditionedRuns, RowTable, residual_weights

FLANKS: tuple[Flank, ...] = ("A", "B")

ROUNDING = 1e-12
"""Squared residuals below this share of y² count as rounding: y is the transmission error, and the
share of y is 1e-6. No encoder resolves that. The rounding of readings of 1e4 rad with 16 digits is
a hundred times smaller."""

_SAME_SPEED = 0.05  # largest relative difference of two speeds that count as equal; chosen value

Embedding = dict[Flank, Float[np.ndarray, "_ _"]]
"""Flank → matrix that maps a row with the columns of one log to a row with those of all logs."""

Read = Callable[[BlockRun], RowTable]
"""Function that returns the rows of a run."""


@dataclass(frozen=True)
class HarmonicSummary:
    """Summary of all logs of a fit.

    **Arguments**
    - `flanks`: summary of every flank that has samples in certain contact.
    - `terms`, `columns`: harmonics of the fit, and layout of the rows.
    - `block_s`: duration of a block, s.
    - `embeddings`: matrices of each log that map its rows to the columns of all logs.
    - `plateaus`: a separate summary for every speed, if each speed has its own noise model.
    - `noise`: assumed kind of the noise model.
    - `last_digit`: rounding error of y due to the last digit of the readings, rad.
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
    def kind(self) -> RowNoise:
        """The `RowNoise` of the assumed kind of noise: how rows are summarised for it."""
        return NOISE[self.noise.kind]

    @property
    def rows(self) -> int:
        """Number of block rows of all flanks."""
        return sum(flank.rows for flank in self.flanks)

    @property
    def counted_rows(self) -> float:
        """Sum of the weights of all block rows; their number if no robust loss gives weights."""
        offsets = [self.columns.index(OFFSET, log) for log in range(len(self.columns.own))]
        return sum(flank.square(k) for flank in self.flanks for k in offsets)

    @property
    def rounding(self) -> float:
        """Sum of squared residuals, rad², below which the residuals are only rounding."""
        share = ROUNDING * sum(flank.square(-1) for flank in self.flanks)
        return share + self.rows * self.last_digit**2

    def keeping(self, own: Sequence[tuple[str, ...]]) -> "HarmonicSummary":
        """Return the summary with only the own columns `own` of every log."""
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
        """Return the summary without the own columns `names` of every log."""
        return self.keeping(
            [tuple(name for name in own if name not in names) for own in self.columns.own]
        )


@dataclass(frozen=True)
class PlateauSummary:
    """Summary of all runs at one speed of the driving shaft, rad/s, in either direction."""

    speed: float
    summary: HarmonicSummary


def summarise(
    logs: Sequence[LogRows],
    terms: TermPlan,
    layout: tuple[ColumnLayout, tuple[Embedding, ...]] | None = None,
    *,
    base: tuple[HarmonicSummary, Sequence[LogRows]] | None = None,
    read: Read = lambda run: run.rows,
) -> HarmonicSummary:
    """Return the summary of the block rows of several logs of one rig.

    All logs share the free and tied harmonics. `layout` gives the common columns and the embedding
    of every log; by default each log has its own columns. The noise decides the number of lags.
    `base` holds a known summary of the first runs of each log, in the default layout, and the rows
    of these runs; where possible, only the further runs are then added to this summary. `read`
    returns the rows of a run, with the columns of the logs; by default they are its block rows.
    """
    layout = _side_by_side(logs) if layout is None else layout
    whole = (base and _extended(*base, logs)) or _summarised(logs, terms, layout, read)
    noise = logs[0].noise
    if noise.of == "rig":
        return whole
    speeds = plateau_speeds([run.segment.speed for log in logs for run in log.runs])
    plateaus = []
    for speed in speeds:
        part = _summarised([_at_speed(log, speed, speeds) for log in logs], terms, layout, read)
        if noise.stationary_in == "angle":
            part = replace(part, block_s=part.block_s * speeds[-1] / speed)
        if part.flanks:
            plateaus.append(PlateauSummary(speed, part))
    return replace(whole, plateaus=tuple(plateaus))


def _summarised(
    logs: Sequence[LogRows],
    terms: TermPlan,
    layout: tuple[ColumnLayout, tuple[Embedding, ...]],
    read: Read,
) -> HarmonicSummary:
    columns, embeddings = layout
    noise = logs[0].noise
    kind = NOISE[noise.kind]
    conditioned = [_conditioned(log, read) for log in logs]
    lags = max((_needed(*found) for found in conditioned), default=1)
    flanks: dict[Flank, FlankSummary] = {}
    for log, embedding, (known, _) in zip(logs, embeddings, conditioned, strict=True):
        for flank, runs in log.runs_by_flank(longer_than=2 * lags).items():
            seen = known.get(flank)
            if seen is None or len(seen.runs) != len(runs):
                seen = ConditionedRuns.of([read(run) for run in runs], log.held(flank))
            times = [run.curve.time for run in runs]
            part = kind.summary.of_runs(flank, seen, times, logs[0].block_s, lags)
            if len(logs) > 1:
                part = part.transformed(embedding[flank])
            flanks[flank] = flanks[flank] + part if flank in flanks else part
    ordered = tuple(flanks[flank] for flank in FLANKS if flank in flanks)
    last_digit = max(log.rounding for log in logs)
    return HarmonicSummary(
        flanks=ordered,
        terms=terms,
        columns=columns,
        block_s=logs[0].block_s,
        embeddings=embeddings,
        plateaus=(),
        noise=noise,
        last_digit=last_digit,
    )


def _extended(
    base: HarmonicSummary, first: Sequence[LogRows], logs: Sequence[LogRows]
) -> HarmonicSummary | None:
    """Add the further runs of one log to the summary `base` of its runs `first`.

    The result is None if this is not possible: if the runs together need another number of lags
    or have another flank, for noise without lags, for several logs, if every speed has its own
    noise model, and if the steps of the drift are penalised.
    """
    if len(logs) > 1 or base.plateaus or not base.flanks or logs[0].drift.stiffness:
        return None
    lags = len(base.flanks[0].lag_products) - 1
    log = replace(logs[0], runs=logs[0].runs[len(first[0].runs) :])
    if not lags or {flank.flank for flank in base.flanks} != set(logs[0].runs_by_flank(2 * lags)):
        return None
    flanks, width = [], log.columns.width
    for flank in base.flanks:
        runs = log.runs_by_flank(longer_than=2 * lags).get(flank.flank, [])
        if runs:
            seen = ConditionedRuns.of([run.rows for run in runs], np.empty((0, width)))
            times = [run.curve.time for run in runs]
            flank += base.kind.summary.of_runs(flank.flank, seen, times, logs[0].block_s, lags)
        flanks.append(flank)
    most = _most_lags(logs[0])
    found = {
        flank.flank: [
            run.rows @ _plain_weights(flank)
            for run in logs[0].runs_by_flank(longer_than=2 * most).get(flank.flank, [])
        ]
        for flank in flanks
    }
    needed = max((_order_of(left, most) + 2 for left in found.values() if left), default=1)
    return replace(base, flanks=tuple(flanks)) if min(needed, most) == lags else None


def _plain_weights(flank: FlankSummary) -> Float[np.ndarray, " q"]:
    """Return the weights (−β, 1), where β are the coefficients of ordinary least squares."""
    return residual_weights(np.linalg.cholesky(flank.lag_products[0]).T @ flank.triangle)


def plateau_speeds(speeds: Sequence[float]) -> tuple[float, ...]:
    """Return the mean of every group of speeds, ascending; the sign of a speed is ignored.

    Neighbouring speeds in a group differ by at most 5 %.
    """
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
    """Return the layout and the embeddings of logs with a common zero.

    The logs share the harmonics, and each log has its own offset, drift and other own columns.
    """
    columns = ColumnLayout(
        logs[0].columns.free, logs[0].columns.tied, tuple(log.columns.own[0] for log in logs)
    )
    return columns, tuple(dict.fromkeys(FLANKS, columns.embedding(log)) for log in range(len(logs)))


def needed_lags(log: LogRows) -> int:
    """Return the number of lags that a log needs for autoregressive noise.

    It is the order of the autoregression of the residual of ordinary least squares, plus 2.
    """
    return _needed(*_conditioned(log, lambda run: run.rows))


def _conditioned(log: LogRows, read: Read) -> tuple[dict[Flank, ConditionedRuns], int]:
    """Return flank → conditioned rows, which decide the number of lags, and its upper limit."""
    most = _most_lags(log)
    if most == 0:
        return {}, 0
    by_flank = log.runs_by_flank(longer_than=2 * most)
    return {
        flank: ConditionedRuns.of([read(run) for run in runs], log.held(flank))
        for flank, runs in by_flank.items()
    }, most


def _most_lags(log: LogRows) -> int:
    """Return the largest number of lags that the noise and the longest run allow."""
    highest = NOISE[log.noise.kind].highest_lag
    longest = max((len(run.rows) for run in log.runs), default=0)
    return int(np.clip(longest // 8, 1, highest)) if highest else 0


def _needed(conditioned: dict[Flank, ConditionedRuns], most: int) -> int:
    needed = 1
    for seen in conditioned.values():
        residuals = [seen.last_column(run) for run in range(len(seen.runs))]
        needed = max(needed, _order_of(residuals, most) + 2)
    return min(needed, most)


def _order_of(residuals: Sequence[Float[np.ndarray, " _"]], most: int) -> int:
    """Return the order of the autoregression of residuals that BIC selects, at most `most`."""
    count = sum(map(len, residuals))
    covariance = [
        sum(float(r[lag:] @ r[: len(r) - lag]) for r in residuals) / count
        for lag in range(most + 1)
    ]
    return len(whitening_filter(np.array(covariance), count)) - 1
