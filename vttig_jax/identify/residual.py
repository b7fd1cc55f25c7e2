"""What the model leaves: residuals of block means, and the rms of single samples."""

import numpy as np
from jaxtyping import Float

from ..kinematics.orders import OrderModel
from ..logs.encoder_log import EncoderLog
from ..logs.segments import Segment
from .blocks import block_rows
from .summary import HarmonicSummary

_MOST_SAMPLES = 20_000


def coefficients_of(
    model: OrderModel, drift: list[float], flank: str, free: int
) -> Float[np.ndarray, " columns"]:
    """Coefficients of one flank in the order of the block columns, y left out."""
    side = "AB".index(flank)
    harmonics = np.stack([model.cosine[side], model.sine[side]], axis=1)
    constant = [float(model.offset[side]), *drift]
    return np.concatenate([harmonics[:free].ravel(), constant, harmonics[free:].ravel()])


def curve_residuals(
    summary: HarmonicSummary,
    log: EncoderLog,
    segments: tuple[Segment, ...],
    model: OrderModel,
    drift: list[float],
) -> tuple[Float[np.ndarray, " _"], ...]:
    """Block means of TE less the model, rad, one array for every curve of the summary."""
    residuals = []
    for curve, segment in zip(summary.curves, segments, strict=True):
        part = slice(segment.start, segment.stop)
        time = (log.time[part] - summary.time_origin_s) / summary.time_scale_s
        driving, driven = log.driving_angle[part], log.driven_angle[part]
        rows = block_rows(summary.plan, driving, driven, time, np.zeros_like(time))
        weights = coefficients_of(model, drift, segment.flank, len(summary.plan.free))
        residuals.append(curve.transmission_error - rows[:, :-1] @ weights)
    return tuple(residuals)


def sample_residual_rms(
    summary: HarmonicSummary,
    log: EncoderLog,
    segments: tuple[Segment, ...],
    error: dict[str, Float[np.ndarray, " n"]],
    model: OrderModel,
    drift: list[float],
) -> float:
    """Rms of single samples less the model, rad, over at most 20 000 evenly spaced samples.

    `error` is the (corrected) transmission error of each flank.
    """
    total = sum(s.stop - s.start for s in segments)
    stride = max(1, total // _MOST_SAMPLES)
    orders = np.asarray(model.terms, float).reshape(-1, 2)
    powers = np.arange(1, len(drift) + 1)
    squares = []
    for segment in segments:
        part = slice(segment.start, segment.stop, stride)
        side = "AB".index(segment.flank)
        angles = np.stack([log.driving_angle[part], log.driven_angle[part]], axis=1)
        phase = angles @ orders.T
        time = (log.time[part] - summary.time_origin_s) / summary.time_scale_s
        predicted = (
            float(model.offset[side])
            + np.cos(phase) @ np.asarray(model.cosine[side])
            + np.sin(phase) @ np.asarray(model.sine[side])
            + time[:, None] ** powers @ np.asarray(drift, float)
        )
        squares.append((error[segment.flank][part] - predicted) ** 2)
    return float(np.sqrt(np.mean(np.concatenate(squares))))
