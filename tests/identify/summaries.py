"""Summaries of made-up block rows, and views of a log."""

from collections.abc import Sequence
from fractions import Fraction

import numpy as np

from vttig_jax.identify.compress.block_rows import BlockRun, LogRows
from vttig_jax.identify.compress.flank_summary import FlankSummary
from vttig_jax.identify.compress.harmonic_summary import HarmonicSummary
from vttig_jax.identify.compress.irregular_flank import IrregularFlank
from vttig_jax.identify.compress.lagged_flank import LaggedFlank
from vttig_jax.identify.compress.orthogonal import ConditionedRuns
from vttig_jax.identify.compress.regressors import Drift
from vttig_jax.identify.model.column_layout import OFFSET, ColumnLayout
from vttig_jax.identify.model.harmonics import Harmonic, TermPlan
from vttig_jax.identify.model.identifiability import Identifiability, find_identifiability
from vttig_jax.identify.preliminary.linear_fit import Input, LinearFit, Model, linear_fit
from vttig_jax.kinematics.te_curve import TECurve
from vttig_jax.logs.encoder_log import EncoderLog
from vttig_jax.logs.motion.flank_assignment import find_ramps
from vttig_jax.logs.motion.segments import Segment, find_segments
from vttig_jax.pair.gear_pair import Drive, Flank, GearPair

TERMS = TermPlan(
    Fraction(9, 16),
    (Harmonic("driving", 2, (2, 0)),),
    (Harmonic("driving", 1, (1, 0)), Harmonic("driven", 1, (0, 1))),
    (),
)


def conditioned_runs(runs: Sequence[np.ndarray]) -> ConditionedRuns:
    """Conditioned rows of runs without rows that are no measurements."""
    return ConditionedRuns.of(runs, np.empty((0, runs[0].shape[1])))


def lagged_flank(runs: Sequence[np.ndarray], lags: int, flank: Flank = "A") -> FlankSummary:
    """Summary of runs at equal times."""
    return LaggedFlank.of_runs(flank, conditioned_runs(runs), (), 1.0, lags)


def irregular_flank(
    runs: Sequence[np.ndarray], times: Sequence[np.ndarray], distance_s: float
) -> FlankSummary:
    """Summary of runs at unequal times."""
    return IrregularFlank.of_runs("A", conditioned_runs(runs), times, distance_s, 0)


def normal_matrix(flank: FlankSummary, filter_: np.ndarray) -> np.ndarray:
    """Zᵀ Σ⁻¹ Z of the rows a summary stands for."""
    factor = flank.factor(filter_)
    return factor.T @ factor


def lag_products_of(flank: FlankSummary) -> np.ndarray:
    """Γ_0, Γ_1, … of the rows themselves."""
    return flank.triangle.T @ flank.lag_products @ flank.triangle


def own_of_powers(order: int) -> tuple[str, ...]:
    """Names of the own columns of one log with powers of time up to `order`."""
    return (OFFSET, *(f"drift_{power}" for power in range(1, order + 1)))


def columns(count: int, drift_order: int) -> np.ndarray:
    """Regressors of `TERMS` over `count` blocks, without y: ones and powers of time are own."""
    angle = np.linspace(0, 40 * np.pi, count)
    time = np.linspace(-1, 1, count)
    driven = angle * 9 / 16
    drift = [time**power for power in range(drift_order + 1)]
    first = [np.cos(angle), np.sin(angle), np.cos(driven), np.sin(driven)]
    return np.stack([np.cos(2 * angle), np.sin(2 * angle), *drift, *first], axis=1)


def summary_of(flanks: dict, drift_order: int = 0, lags: int = 8) -> HarmonicSummary:
    """A summary of {flank: [rows, …]}, rows in the order of `columns` with y behind."""
    return HarmonicSummary(
        flanks=tuple(lagged_flank(runs, lags, flank) for flank, runs in flanks.items()),
        terms=TERMS,
        columns=layout_of(TERMS, drift_order),
        block_s=0.01,
    )


def layout_of(terms: TermPlan, drift_order: int = 0) -> ColumnLayout:
    """Layout of one log with powers of time."""
    free, tied = (tuple(h.term for h in part) for part in (terms.free, terms.tied))
    return ColumnLayout(free, tied, (own_of_powers(drift_order),))


def looked(
    log: EncoderLog,
    pair: GearPair | Drive,
    *,
    drift: Drift = Drift(),
    regressors: tuple[str, ...] = (),
    segments: Sequence[Segment] | None = None,
) -> tuple[Identifiability, LinearFit]:
    """The certain segments of one log, or those given, and one pass over them."""
    found = find_segments(log)
    scope = find_identifiability([log], [found.segments], pair, pair.fit, None)
    used = scope.segments[0] if segments is None else tuple(segments)
    ramps = tuple(r for r in find_ramps(log, found) if r.segment.flank in scope.flanks)
    model = Model(pair, scope.terms, regressors, drift)
    return scope, linear_fit([Input(log, found, used, ramps)], model)


def made_log(runs: list[np.ndarray], own: tuple[str, ...], flanks: str) -> LogRows:
    """Made-up rows as if they came from a log; `flanks` has a letter for every run."""
    free, tied = (tuple(h.term for h in part) for part in (TERMS.free, TERMS.tied))
    made = []
    for rows, letter in zip(runs, flanks, strict=True):
        flank: Flank = "A" if letter == "A" else "B"
        place = np.arange(float(len(rows)))
        segment = Segment(0, len(rows), flank, 1.0)
        made.append(BlockRun(segment, rows, TECurve(flank, place, rows[:, -1], place)))
    return LogRows(ColumnLayout(free, tied, (own,)), tuple(made), 1, 0.01)


def random_log(seed: int, own: tuple[str, ...], flanks: str, count: int = 300) -> LogRows:
    """Rows without any structure but the ones of the offset, each run longer than the last."""
    generator = np.random.default_rng(seed)
    width = 2 * len(TERMS.free + TERMS.tied) + len(own) + 1
    runs = [generator.standard_normal((count + 40 * k, width)) for k in range(len(flanks))]
    for rows in runs:
        rows[:, 2 * len(TERMS.free)] = 1.0
    return made_log(runs, own, flanks)
