"""Residuals of block means, the rms of single samples, and the level of every log."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from ...kinematics.te_curve import TECurve
from ...pair.gear_pair import Flank
from ..compress.harmonic_summary import HarmonicSummary
from ..model.column_layout import OFFSET
from ..model.mounting import offset_name
from ..noise.noise_model import WhitenedFlank
from ..preliminary.linear_fit import LinearFit, residual_of
from .least_squares import Solution

_MOST_SAMPLES = 20_000

Weights = Mapping[Flank, Float[np.ndarray, " q"]]
"""Flank → row (−β, 1) that makes residuals of rows."""


def flank_coefficients(
    whitened: tuple[WhitenedFlank, ...], solution: Solution
) -> list[Float[np.ndarray, " columns"]]:
    """Coefficients of every column but y, flank by flank: the free ones at their best."""
    return [
        np.concatenate([factor.free_given(tied), tied])
        for factor, tied in zip(whitened, solution.tied, strict=True)
    ]


def weights_of_logs(
    summary: HarmonicSummary, coefficients: list[Float[np.ndarray, " columns"]]
) -> list[Weights]:
    """Log by log: flank → row that makes residuals of the rows of that log alone."""
    rows: dict[Flank, np.ndarray] = {
        flank.flank: np.append(-values, 1.0)
        for flank, values in zip(summary.flanks, coefficients, strict=True)
    }
    return [
        {flank: embedding[flank].T @ row for flank, row in rows.items()}
        for embedding in summary.embeddings
    ]


def curves_and_residuals(
    linear: LinearFit, weights: list[Weights]
) -> tuple[tuple[TECurve, ...], tuple[Float[np.ndarray, " _"], ...]]:
    """Block means of the transmission error of every run, and what the model leaves of them, rad.

    A mean, or a run, of which a robust loss left no sample is left out.
    """
    curves, residuals = [], []
    for rows, level, own in zip(linear.rows, linear.levels, weights, strict=True):
        place = rows.columns.index(OFFSET)
        for run in rows.runs:
            share = run.rows[:, place]
            counted = share > 0
            if not counted.any():
                continue
            share, curve = share[counted], run.curve
            curves.append(
                TECurve(
                    curve.flank,
                    curve.driving_angle[counted],
                    run.rows[counted, -1] / share + level,
                    curve.time[counted],
                )
            )
            residuals.append(run.rows[counted] @ own[run.segment.flank] / share)
    return tuple(curves), tuple(residuals)


def sample_residual_rms(linear: LinearFit, weights: list[Weights]) -> float:
    """Rms of single samples less the model, rad, over at most 20 000 evenly spaced samples.

    Samples count by their weight where a robust loss gave them one.
    """
    segments = [run.segment for rows in linear.rows for run in rows.runs]
    stride = max(1, sum(s.stop - s.start for s in segments) // _MOST_SAMPLES)
    square, count = 0.0, 0.0
    for channels, rows, own in zip(linear.channels, linear.rows, weights, strict=True):
        for run in rows.runs:
            segment = run.segment
            residual = residual_of(channels, segment, rows.columns, own[segment.flank], stride)
            part = slice(segment.start, segment.stop, stride)
            weight = np.ones_like(residual) if channels.weight is None else channels.weight[part]
            square += float(weight @ residual**2)
            count += float(weight.sum())
    return float(np.sqrt(square / max(count, 1e-300)))


def restored(solution: Solution, levels: Sequence[float]) -> Solution:
    """The solution with the level of every log added to its offset.

    `tied` still belongs to the rows, which have no level.
    """
    values = solution.values.copy()
    for log, level in enumerate(levels):
        values[solution.names.index(offset_name(log, len(levels)))] += level
    return replace(solution, values=values)


def lifted(summary: HarmonicSummary, levels: Sequence[float]) -> HarmonicSummary:
    """The summary of the rows with the level of every log in them: for whoever reads offsets."""
    if not any(levels):
        return summary
    matrix = np.eye(summary.columns.width)
    for log, level in enumerate(levels):
        matrix[-1, summary.columns.index(OFFSET, log)] = level
    return replace(
        summary,
        flanks=tuple(flank.transformed(matrix) for flank in summary.flanks),
        plateaus=tuple(replace(p, summary=lifted(p.summary, levels)) for p in summary.plateaus),
    )
