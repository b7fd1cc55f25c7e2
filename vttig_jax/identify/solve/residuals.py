"""Residuals of block means and of samples, and the levels that were subtracted from the logs."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from ...kinematics.te_curve import TECurve
from ...pair.gear_pair import Flank
from ..compress.harmonic_summary import HarmonicSummary
from ..model.column_layout import OFFSET
from ..model.given_model import GivenModel
from ..model.mounting import offset_name
from ..noise.noise_model import WhitenedFlank
from ..preliminary.linear_fit import LinearFit, residuals_of
from .least_squares import Solution

_MOST_SAMPLES = 20_000  # samples above which a log is thinned; chosen value

Weights = Mapping[Flank, Float[np.ndarray, " q"]]
"""Flank → weights (−β, 1); the product of a row with them is its residual."""


def flank_coefficients(
    whitened: tuple[WhitenedFlank, ...], solution: Solution
) -> list[Float[np.ndarray, " columns"]]:
    """Return for every flank the coefficients of all columns but y.

    The free coefficients are the best ones for the tied coefficients of the solution.
    """
    return [
        np.concatenate([factor.free_given(tied), tied])
        for factor, tied in zip(whitened, solution.tied, strict=True)
    ]


def weights_of_logs(
    summary: HarmonicSummary, coefficients: list[Float[np.ndarray, " columns"]]
) -> list[Weights]:
    """Return for each log the weights (−β, 1) of every flank, for the columns of this log."""
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
    """Return the block means of the transmission error of every run, and their residuals, rad.

    A block is left out if a robust loss gives all its samples the weight 0. A run is left out if
    this applies to all its blocks.
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
                    run.error[counted] / share + level,
                    curve.time[counted],
                )
            )
            residuals.append(run.rows[counted] @ own[run.segment.flank] / share)
    return tuple(curves), tuple(residuals)


def sample_residual_rms(linear: LinearFit, weights: list[Weights]) -> float:
    """Return the rms residual of single samples, rad, with the weights of the robust loss.

    Of long logs only 20 000 … 40 000 evenly spaced samples are used.
    """
    segments = [run.segment for rows in linear.rows for run in rows.runs]
    stride = max(1, sum(s.stop - s.start for s in segments) // _MOST_SAMPLES)
    square, count = 0.0, 0.0
    for channels, rows, own in zip(linear.channels, linear.rows, weights, strict=True):
        used = [run.segment for run in rows.runs]
        found = residuals_of(channels, used, rows.columns, own, stride)
        for segment, residual in zip(used, found, strict=True):
            part = slice(segment.start, segment.stop, stride)
            weight = np.ones_like(residual) if channels.weight is None else channels.weight[part]
            square += float(weight @ residual**2)
            count += float(weight.sum())
    return float(np.sqrt(square / max(count, 1e-300)))


def restored(
    solution: Solution, levels: Sequence[float], given: GivenModel | None = None
) -> Solution:
    """Return the solution with the level of every log added to its offset.

    The solution contains the steps of the parameters of a `given` flank model from their values in
    this pass; these values are added. `tied` does not change, because it belongs to the rows, from
    which the level and the given model were subtracted.
    """
    values = solution.values.copy()
    for name, value in () if given is None else zip(given.names, given.values, strict=True):
        if name in solution.names:
            values[solution.names.index(name)] += value
    for log, level in enumerate(levels):
        values[solution.names.index(offset_name(log, len(levels)))] += level
    return replace(solution, values=values)


def lifted(summary: HarmonicSummary, levels: Sequence[float]) -> HarmonicSummary:
    """Return the summary of the rows with the level of every log added to y.

    Functions that use the offsets of the solution from `restored` need this summary.
    """
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
