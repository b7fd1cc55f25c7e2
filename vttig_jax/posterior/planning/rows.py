"""Whitened block rows of a run that is not yet recorded, computed as in a fit of its log."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ...base.errors import LogError, NoAnswerError
from ...identify.compress.block_rows import LogRows, log_rows
from ...identify.compress.orthogonal import triangle_of
from ...identify.compress.regressors import Drift
from ...identify.model.column_layout import ColumnLayout
from ...identify.model.identifiability import Identifiability, find_identifiability
from ...identify.noise.noise_model import WhitenedFlank
from ...identify.preliminary.delay import TOLD, one_speed
from ...identify.preliminary.linear_fit import Input, Model, linear_fit
from ...logs.encoder_log import EncoderLog
from ...logs.motion.flank_assignment import find_ramps
from ...logs.motion.segments import find_segments
from ...pair.gear_pair import Drive, GearPair
from ...pair.schema import HarmonicOrders
from .noise import BlockNoise, PlannedNoise, counting_std
from .run import PlannedRun

DELAY = "delay"

_ROWS_A_RAMP = 40
"""Number of rows per ramp, as in a fit."""

Triangles = dict[str, Float[np.ndarray, "c c"]]
"""Flank → upper triangular factor R of the whitened regressors X, with RᵀR = XᵀX."""


@dataclass(frozen=True, eq=False)
class PlannedRows:
    """Regression rows that a fit would compute from the log of a planned run.

    A row contains the means over a block of neighbouring samples. The planned log is computed from
    the prescribed motion without noise, and its rows are whitened with the assumed noise.

    **Arguments**
    - `identifiable`: flanks, segments and harmonics that the run would determine.
    - `columns`: names of the columns (regressors) of the rows, including the delay.
    - `steady`, `ramps`: flank → upper triangular factor R of the whitened regressors X, with
      RᵀR = XᵀX, in units of the innovation std; from the parts at steady speed and from the ramps.
    - `rows`: flank → number of rows at steady speed.
    - `delay_source`: rows that determine the delay: "speeds" (several steady speeds), "ramps", or
      "" if no rows determine it.
    - `noise`: autoregressive noise of the block means.
    - `used`: number of samples at steady speed, on all flanks together.
    - `missed`: number of passes that have no part at steady speed.
    - `interval_s`: sampling interval, s.
    """

    identifiable: Identifiability
    columns: ColumnLayout
    steady: Triangles
    ramps: Triangles
    rows: dict[str, int]
    delay_source: str
    noise: BlockNoise
    used: int
    missed: int
    interval_s: float


def planned_rows(
    run: PlannedRun, pair: GearPair | Drive, options: HarmonicOrders, noise: PlannedNoise
) -> PlannedRows:
    """Compute the rows of the noise-free motion as a fit does, and whiten them with `noise`.

    **Raises** `NoAnswerError` if no shaft turns once, or if the rows are too few to fit.
    """
    counting = counting_std(pair)
    _require_noise(noise, counting)
    log = _noise_free_log(run, pair)
    motion = find_segments(log)
    identifiable = find_identifiability([log], [motion.segments], pair, options, None)
    ramps = tuple(
        ramp for ramp in find_ramps(log, motion) if ramp.segment.flank in identifiable.flanks
    )
    segments = identifiable.segments[0]
    steady = one_speed(segments)
    finest_s = run.ramp_s / _ROWS_A_RAMP if steady and ramps else np.inf
    model = Model(pair, identifiable.terms, (DELAY,), Drift())
    linear = linear_fit([Input(log, motion, segments, ramps)], model, finest_s=finest_s)
    rows = linear.rows[0]
    shortest = min((len(block_run.rows) for block_run in rows.runs), default=1)
    blocks = noise.of_blocks(rows.size, run.rate_hz, counting, most=shortest - 1)
    ramp_rows = log_rows(
        linear.channels[0], [ramp.segment for ramp in ramps], identifiable.terms, linear.block_s
    )
    counts = {flank: sum(map(len, runs)) for flank, runs in rows.by_flank().items()}
    _require_rows(counts, rows.columns.width - 2)
    on_runs, on_ramps = _triangles(rows, blocks), _triangles(ramp_rows, blocks)
    return PlannedRows(
        identifiable=identifiable,
        columns=rows.columns,
        steady=on_runs,
        ramps=on_ramps,
        rows=counts,
        delay_source=_delay_source(rows.columns, on_runs, on_ramps, one_speed=steady),
        noise=blocks,
        used=sum(counts.values()) * rows.size,
        missed=run.pass_count * len(run.speeds_rpm) - len(segments),
        interval_s=1 / run.rate_hz,
    )


def columns_of(planned: PlannedRows, *, with_delay: bool) -> ColumnLayout:
    """Return the column layout of the rows, with or without the column of the delay."""
    nuisance = [name for name in planned.columns.own[0] if with_delay or name != DELAY]
    return ColumnLayout(planned.columns.free, planned.columns.tied, (tuple(nuisance),))


def whitened_flanks(
    planned: PlannedRows,
    columns: ColumnLayout,
    tied: Float[np.ndarray, "flanks tied"],
    *,
    with_ramps: bool,
) -> tuple[WhitenedFlank, ...]:
    """Return the triangular factor of the whitened rows of each flank, which the solver needs.

    The last column y is computed from the assumed tied coefficients `tied`. The last row contains
    the expected length of the residual: √(number of rows), in units of the innovation standard
    deviation. `with_ramps` adds the rows of the ramps.
    """
    full = planned.columns
    kept = [k for k in range(full.width - 1) if DELAY in columns.own[0] or k != full.index(DELAY)]
    flanks = []
    for flank, coefficients in zip(planned.identifiable.flanks, tied, strict=True):
        parts = [planned.steady[flank][:, kept]]
        if with_ramps and flank in planned.ramps:
            parts.append(planned.ramps[flank][:, kept])
        triangle = triangle_of(np.concatenate(parts))
        y = triangle[:, columns.free_width :] @ coefficients
        # y is exactly the sum of the columns, plus noise that no regressor explains.
        noise = np.zeros((1, len(kept) + 1))
        noise[0, -1] = np.sqrt(planned.rows[flank])
        factor = np.vstack([np.column_stack([triangle, y]), noise])
        flanks.append(WhitenedFlank(factor, columns.free_width))
    return tuple(flanks)


def _delay_source(
    columns: ColumnLayout, steady: Triangles, ramps: Triangles, *, one_speed: bool
) -> str:
    """Return which rows determine the delay: "speeds" or "ramps", or "" if none do.

    The delay is determined under the same condition as in a fit. `steady` and `ramps` are the
    factors of the rows at steady speed and in ramps. If the run has only one speed (`one_speed`),
    the rows in ramps count as well.
    """
    left, raw = 0.0, 0.0
    place = columns.index(DELAY)
    for flank, triangle in steady.items():
        parts = [triangle, ramps[flank]] if one_speed and flank in ramps else [triangle]
        rows = np.concatenate(parts)[:, : columns.width - 1]
        delay_last = triangle_of(np.column_stack([np.delete(rows, place, axis=1), rows[:, place]]))
        left += float(delay_last[-1, -1] ** 2)
        raw += float(delay_last[:, -1] @ delay_last[:, -1])
    if left < TOLD * raw:
        return ""
    return "ramps" if one_speed else "speeds"


def _triangles(rows: LogRows, noise: BlockNoise) -> Triangles:
    """Return the factors of the whitened regressors by flank; every run is whitened on its own."""
    return {
        flank: triangle_of(np.concatenate([noise.whitened(run[:, :-1]) for run in runs]))
        for flank, runs in rows.by_flank().items()
    }


def _noise_free_log(run: PlannedRun, pair: GearPair | Drive) -> EncoderLog:
    try:
        return run.log(pair)
    except LogError:
        raise NoAnswerError(
            f"passes of {run.turns:g} turns at {run.rate_hz:g} Hz make no log that can be fitted;"
            " plan more turns or a higher rate.",
            where="planned run",
        ) from None


def _require_noise(noise: PlannedNoise, counting: float) -> None:
    if not (noise.std_deg or noise.white_std_deg or counting):
        raise ValueError(
            "Argument `noise` must not be zero if the pair file gives no counts of the encoders,"
            " but it is: every standard error would be zero."
        )


def _require_rows(rows: dict[str, int], columns: int) -> None:
    for flank, count in rows.items():
        if count <= columns:
            raise NoAnswerError(
                f"{count} averaged samples on flank {flank} are too few for {columns} coefficients;"
                " plan more turns or a higher rate, or list fewer orders in [fit].",
                where="planned run",
            )
