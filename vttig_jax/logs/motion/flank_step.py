"""Step of the transmission error between the flanks, from a linear fit to up to 1000 samples."""

import numpy as np
from jaxtyping import Float, Int

from ...base.numerics.well_conditioned import least_squares
from ...base.units import REV
from ..encoder_log import EncoderLog
from .segments import Segments

EVIDENCE = 50.0
"""Least likelihood ratio 2 Δ ln L by which one model of the flanks must beat another (chosen)."""

LEAST = 100
"""Least number of samples of a comparison (chosen)."""

_MOST = 1000  # largest number of samples that are compared (chosen)


def seen_gap(log: EncoderLog, by_motion: Segments, *, delayed: bool = True) -> float:
    """Return the step of the transmission error from flank A to B in rad, or 0 without evidence.

    **Arguments**
    - `by_motion`: segments with flanks by the direction of motion.
    - `delayed`: whether the channels may have a delay. At one speed a delay explains any step.
    """
    sense, rows = flank_rows(log, by_motion)
    if len(rows) < LEAST or len(np.unique(sense[rows])) < 2:
        return 0.0
    speed = log.driving_speed.value[rows] if delayed else np.zeros(len(rows))
    columns, error = columns_of(log, rows, speed), log.transmission_error[rows]
    without = error - columns @ least_squares(columns, error, 1e-9)
    least, gap = squares_with_step(error, columns, sense[rows])
    evidence = len(rows) * np.log(max(float(without @ without), 1e-300) / max(least, 1e-300))
    return max(gap, 0.0) if evidence >= EVIDENCE else 0.0


def flank_rows(
    log: EncoderLog, segments: Segments
) -> tuple[Int[np.ndarray, " n"], Int[np.ndarray, " m"]]:
    """Return the flank of every sample, and the indices of samples for a comparison.

    The flank is +1 on A, −1 on B and 0 elsewhere. The indices are evenly spaced among the samples
    on a flank that are no spikes.
    """
    sense = np.zeros(len(log), np.int8)
    for segment in segments.segments:
        sense[segment.start : segment.stop] = 1 if segment.flank == "A" else -1
    rows = np.flatnonzero((sense != 0) & ~log.spikes)
    return sense, rows[:: max(1, -(-len(rows) // _MOST))].copy()


def columns_of(
    log: EncoderLog, rows: Int[np.ndarray, " m"], speed: Float[np.ndarray, " m"]
) -> Float[np.ndarray, "m p"]:
    """Return a design matrix at the samples `rows`, one row per sample.

    Its columns are an offset, the scaled speed, and cosine and sine of the angle of each shaft that
    covers at least one turn.
    """
    columns = [np.ones(len(rows)), speed / max(float(np.abs(speed).max()), 1e-300)]
    for angle in (log.driving_angle[rows], log.driven_angle[rows]):
        columns += [np.cos(angle), np.sin(angle)] if np.ptp(angle) >= REV else []
    return np.stack(columns, axis=1)


def squares_with_step(
    error: Float[np.ndarray, " m"], columns: Float[np.ndarray, "m p"], flank: Int[np.ndarray, " m"]
) -> tuple[float, float]:
    """Fit the transmission error `error` (rad) by `columns` and a step from flank A to flank B.

    Return the residual sum of squares in rad² and the step in rad.
    """
    design = np.column_stack([columns, (flank < 0).astype(np.float64)])
    solution = least_squares(design, error, 1e-9)
    return float(np.sum((error - design @ solution) ** 2)), float(solution[-1])
