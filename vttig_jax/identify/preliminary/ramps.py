"""Ramps: parts of a log in which the speed changes, and which tell the delay of a log of one speed.

A ramp counts only if the teeth stay on the flank of the direction of motion.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from ...logs.encoder_log import EncoderLog
from ...logs.motion.flank_assignment import Ramp
from ...logs.motion.segments import Segment
from ...pair.gear_pair import Flank
from ..compress.block_rows import LogRows
from ..noise.noise_model import residual_std
from .delay import one_speed
from .linear_fit import Input, LinearFit

_BRANCH = 0.25
"""Largest residual of a ramp that lies on its flank, as a share of the gap; chosen value."""

_MIDDLE = 0.5
"""Residual of a ramp, as a share of the gap, that lies as near to the other flank; no noise allows
for more."""

_BEYOND = 0.1
"""Largest part of a ramp beyond the angles of the steady motion on its flank, as a share of their
range; chosen value."""

_ROWS_A_RAMP = 40
"""Number of rows per ramp: more than twice the highest order of the autoregressive noise."""


def finest_row_s(inputs: Sequence[Input]) -> float:
    """Return the longest row, s, that gives a ramp enough rows; infinite if no ramp is needed."""
    if not one_speed([s for one in inputs for s in one.segments]):
        return np.inf
    ramps = [
        float(one.log.time[ramp.segment.stop - 1] - one.log.time[ramp.segment.start])
        for one in inputs
        for ramp in one.ramps
    ]
    return float(np.median(ramps)) / _ROWS_A_RAMP if ramps else np.inf


def is_among_steady(log: EncoderLog, ramp: Ramp, segments: Sequence[Segment]) -> bool:
    """Return whether a ramp lies at driving angles that the steady motion on its flank covered.

    It may lie beyond them by `_BEYOND` of their range. Farther out, the orders of a shaft that
    makes only a part of a turn are unknown, and their error resembles a delay.
    """
    angles = [
        log.driving_angle[[one.start, one.stop - 1]]
        for one in segments
        if one.flank == ramp.segment.flank
    ]
    if not angles:
        return False
    beyond = _BEYOND * float(np.ptp(angles))
    ends = log.driving_angle[[ramp.segment.start, ramp.segment.stop - 1]]
    return bool(ends.min() >= np.min(angles) - beyond and ends.max() <= np.max(angles) + beyond)


def with_ramps(linear: LinearFit) -> tuple[LinearFit, list[str]]:
    """Return the linear fit with the ramps that stay on their flank, and a note on their number.

    A fit with only the accelerating ramps decides which ramps stay on their flank: when the drive
    slows down, the driven side may leave its flank.
    """
    total = sum(len(one.ramps) for one in linear.inputs)
    ramps = [
        [linear.rows_of(log, [ramp.segment]) for ramp in one.ramps]
        for log, one in enumerate(linear.inputs)
    ]
    speeding_up = [[ramp.speeding_up for ramp in one.ramps] for one in linear.inputs]
    up = _joined(linear, ramps, speeding_up)
    std = residual_std(up.summary, up.filter)
    keep = [
        [
            on_its_branch(ramp, _rows_of(found), up.residual_rows[log], std)
            for ramp, found in zip(one.ramps, ramps[log], strict=True)
        ]
        for log, one in enumerate(linear.inputs)
    ]
    used = sum(map(sum, keep))
    note = f"{used} of {total} ramps keep to the flank of their motion and count for the delay"
    joined = up if keep == speeding_up else _joined(linear, ramps, keep)
    return joined, [note] if total else []


def _rows_of(ramp: LogRows) -> Float[np.ndarray, "n q"]:
    """Return the rows of a ramp as an array; it has no rows if the ramp is shorter than a row."""
    return ramp.runs[0].rows if ramp.runs else np.zeros((0, ramp.columns.width))


def _joined(
    linear: LinearFit, ramps: Sequence[Sequence[LogRows]], keep: Sequence[Sequence[bool]]
) -> LinearFit:
    """Return the linear fit with those `ramps` added that are marked True in `keep`."""
    rows, used = [], []
    for log, chosen in enumerate(keep):
        segments = [one.segment for one in linear.inputs[log].ramps]
        kept = [k for k, good in enumerate(chosen) if good]
        runs = [run for k in kept for run in ramps[log][k].runs]
        rows.append(replace(linear.rows[log], runs=(*linear.rows[log].runs, *runs)))
        used.append((*linear.segments[log], *(segments[k] for k in kept)))
    return replace(linear, rows=tuple(rows), segments=tuple(used), base=linear)


def on_its_branch(
    ramp: Ramp,
    rows: Float[np.ndarray, "n q"],
    residual_rows: Mapping[Flank, Float[np.ndarray, " q"]],
    noise_std: float,
) -> bool:
    """Return whether the teeth stay on the flank of their direction of motion during a ramp.

    A ramp is the part of a log in which the speed changes. At least 95 % of its `rows` must have a
    residual of at most a quarter of the gap plus three times `noise_std`, rad, and must lie nearer
    to their own flank than to the other one, if two `noise_std` tell both apart. `residual_rows`
    contains the weights (−β, 1) of each flank, so that a row times these weights is its residual.
    """
    own = ramp.segment.flank
    if own not in residual_rows or len(rows) == 0:
        return False
    residual = rows @ residual_rows[own]
    other = residual_rows.get("B" if own == "A" else "A")
    gap = np.abs(rows @ (other - residual_rows[own])) if other is not None else np.inf
    allowed = np.minimum(_BRANCH * gap + 3 * noise_std, np.maximum(_MIDDLE * gap, 2 * noise_std))
    return bool(np.mean(np.abs(residual) <= allowed) >= 0.95)
