"""Block rows of a run that was never made, as a fit of its log would see them, made white."""

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
from ...identify.preliminary.delay import one_speed
from ...identify.preliminary.linear_fit import Input, Model, linear_fit
from ...identify.solve.least_squares import Solution
from ...logs.encoder_log import EncoderLog
from ...logs.motion.flank_assignment import find_ramps
from ...logs.motion.segments import find_segments
from ...pair.gear_pair import Drive, GearPair
from ...pair.schema import HarmonicOrders
from .noise import BlockNoise, PlannedNoise, counting_std
from .run import PlannedRun

DELAY = "delay"

_ROWS_A_RAMP = 40
"""Rows of a ramp, as in a fit."""

Triangles = dict[str, Float[np.ndarray, "c c"]]
"""Flank → triangular factor of the whitened regressors in units of the innovation."""


@dataclass(frozen=True, eq=False)
class PlannedRows:
    """What a fit would make of the run.

    **Arguments**
    - `identifiable`: flanks, shafts and harmonics.
    - `columns`: of the rows, the delay among them.
    - `steady`, `ramps`: triangular factors of the steady runs, and of the ramps that speed up.
    - `rows`: flank → rows of the steady runs.
    - `told`: what tells a delay: "speeds", "ramps" or "" for nothing.
    - `noise`: of the blocks; `used`: samples of the steady runs.
    - `missed`: passes without a steady run.
    """

    identifiable: Identifiability
    columns: ColumnLayout
    steady: Triangles
    ramps: Triangles
    rows: dict[str, int]
    told: str
    noise: BlockNoise
    used: int
    missed: int


def planned_rows(
    run: PlannedRun, pair: GearPair | Drive, options: HarmonicOrders, noise: PlannedNoise
) -> PlannedRows:
    """Look at the noise-free motion as a fit would, and whiten its rows with the known noise.

    **Raises** `NoAnswerError` where no shaft turns once, or the rows are too few to fit.
    """
    counting = counting_std(pair)
    _require_noise(noise, counting)
    log = _motion(run, pair)
    found = find_segments(log)
    identifiable = find_identifiability([log], [found.segments], pair, options, None)
    ramps = tuple(
        ramp
        for ramp in find_ramps(log, found)
        if ramp.segment.flank in identifiable.flanks and ramp.speeding_up
    )
    segments = identifiable.segments[0]
    steady = one_speed(segments)
    finest_s = run.ramp_s / _ROWS_A_RAMP if steady and ramps else np.inf
    model = Model(pair, identifiable.terms, (DELAY,), Drift())
    linear = linear_fit([Input(log, found, segments, ramps)], model, finest_s=finest_s)
    rows = linear.rows[0]
    shortest = min((len(one.rows) for one in rows.runs), default=1)
    blocks = noise.of_blocks(rows.size, run.rate_hz, counting, most=shortest - 1)
    more = log_rows(
        linear.channels[0], [ramp.segment for ramp in ramps], identifiable.terms, linear.block_s
    )
    counted = {flank: sum(map(len, runs)) for flank, runs in rows.by_flank().items()}
    _require_rows(counted, rows.columns.width - 2)
    return PlannedRows(
        identifiable,
        rows.columns,
        _triangles(rows, blocks),
        _triangles(more, blocks),
        counted,
        "speeds" if not steady else "ramps" if ramps and more.runs else "",
        blocks,
        sum(counted.values()) * rows.size,
        run.each * len(run.speeds_rpm) - len(segments),
    )


def columns_of(planned: PlannedRows, *, with_delay: bool) -> ColumnLayout:
    """Columns of the rows with the delay or without it."""
    own = [name for name in planned.columns.own[0] if with_delay or name != DELAY]
    return ColumnLayout(planned.columns.free, planned.columns.tied, (tuple(own),))


def whitened_flanks(
    planned: PlannedRows,
    columns: ColumnLayout,
    tied: Float[np.ndarray, "flanks tied"],
    *,
    with_ramps: bool,
) -> tuple[WhitenedFlank, ...]:
    """What the solver gets: the triangular factors, and y as the tied coefficients make it.

    **Arguments**
    - `columns`: see `columns_of`.
    """
    wide = planned.columns
    kept = [p for p in range(wide.width - 1) if DELAY in columns.own[0] or p != wide.index(DELAY)]
    flanks = []
    for flank, coefficients in zip(planned.identifiable.flanks, tied, strict=True):
        parts = [planned.steady[flank][:, kept]]
        if with_ramps and flank in planned.ramps:
            parts.append(planned.ramps[flank][:, kept])
        triangle = triangle_of(np.concatenate(parts))
        made = triangle[:, columns.free_width :] @ coefficients
        # y is exactly what the coefficients make, plus noise that no regressor explains.
        noise = np.zeros((1, len(kept) + 1))
        noise[0, -1] = np.sqrt(planned.rows[flank])
        factor = np.vstack([np.column_stack([triangle, made]), noise])
        flanks.append(WhitenedFlank(factor, columns.free_width))
    return tuple(flanks)


def delay_std(planned: PlannedRows, without: Solution) -> float:
    """Standard error in s of a delay fitted beside the parameters of a solution without it.

    What the Jacobian of those leaves of the delay's own column, ramps included, is its information.
    """
    columns = columns_of(planned, with_delay=True)
    place = columns.index(DELAY) - columns.free_width
    beside = np.insert(without.jacobian, place, 0.0, axis=1)
    flanks = whitened_flanks(planned, columns, 0.0 * beside[:, :, 0], with_ramps=True)
    matrices = np.stack([flank.tied[0] for flank in flanks])
    known = np.einsum("fij,fjp->fip", matrices, beside).reshape(-1, beside.shape[-1])
    column = matrices[:, :, place].ravel()
    size = np.linalg.norm(known, axis=0)
    known = known / np.where(size > 0, size, 1.0)
    left = column - known @ np.linalg.lstsq(known, column, rcond=1e-9)[0]
    return float(1 / np.linalg.norm(left))


def _triangles(rows: LogRows, noise: BlockNoise) -> Triangles:
    """Factors of the whitened regressors, flank by flank; nothing reaches from run to run."""
    return {
        flank: triangle_of(np.concatenate([noise.whitened(one[:, :-1]) for one in runs]))
        for flank, runs in rows.by_flank().items()
    }


def _motion(run: PlannedRun, pair: GearPair | Drive) -> EncoderLog:
    try:
        return run.log(pair)
    except LogError:
        raise NoAnswerError(
            f"passes of {run.turns:g} turns at {run.rate_hz:g} Hz make no log that a fit takes;"
            " plan more turns or a higher rate.",
            where="planned run",
        ) from None


def _require_noise(noise: PlannedNoise, counting: float) -> None:
    if not (noise.std_deg or noise.white_std_deg or counting):
        raise ValueError(
            "Argument `noise` must not be zero where the pair file gives no counts of the encoders,"
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
