"""What a controller does with the harmonics of a `Compensation` and two single-turn readings.

It is the reference for the C header, in NumPy and with formulas of its own. The slope is dj/dφ₁
while ξ moves with i φ₁. Where the readings belong to no possible place, every value is 0.
"""

from typing import NamedTuple

import numpy as np

from vttig_jax.base.units import REV
from vttig_jax.control.compensation.compensation import Compensation


class Gap(NamedTuple):
    """Backlash, rad of the driven gear, its derivative by φ₁, and whether it is known."""

    backlash_rad: np.ndarray
    slope: np.ndarray
    known: np.ndarray


class Shift(NamedTuple):
    """Axial displacement that closes the gap less a margin, mm, and its derivative by φ₁."""

    shift_mm: np.ndarray
    slope_mm_per_rad: np.ndarray
    known: np.ndarray


def gap_at(compensation: Compensation, driving_rad, driven_rad) -> Gap:
    """The backlash at readings of both shafts, rad from the zeros of the fit."""
    first, second = np.broadcast_arrays(
        np.asarray(driving_rad, np.float64), np.asarray(driven_rad, np.float64)
    )
    finite = np.isfinite(first) & np.isfinite(second)
    first, second = (np.where(finite, angle, 0.0) for angle in (first, second))
    first, second = (angle - REV * np.rint(angle / REV) for angle in (first, second))
    ratio, spacing = float(compensation.ratio), REV / compensation.ratio.denominator
    distance = second - ratio * first - compensation.offset_rad
    turn = np.rint(distance / spacing)
    known = finite & (np.abs(distance - turn * spacing) <= compensation.tolerance_rad)
    value, slope = np.full(first.shape, compensation.constant_rad), np.zeros(first.shape)
    for (driving_order, driven_order), cosine, sine in zip(
        compensation.terms, compensation.cosine_rad, compensation.sine_rad, strict=True
    ):
        phase = driving_order * first + driven_order * (ratio * first + turn * spacing)
        value += cosine * np.cos(phase) + sine * np.sin(phase)
        order = driving_order + driven_order * ratio
        slope += order * (sine * np.cos(phase) - cosine * np.sin(phase))
    return Gap(np.where(known, value, 0.0), np.where(known, slope, 0.0), known)


def shift_at(compensation: Compensation, driving_rad, driven_rad, margin_mm: float = 0.0) -> Shift:
    """The displacement that closes the gap less the margin, at least 0."""
    gap, closing = gap_at(compensation, driving_rad, driven_rad), compensation.closing_rad_per_mm
    shift = gap.backlash_rad / closing - margin_mm
    closes = gap.known & (shift > 0)
    slope = np.where(closes, gap.slope / closing, 0.0)
    return Shift(np.where(closes, shift, 0.0), slope, gap.known)
