"""Detection of slips: lasting steps of the transmission error.

An encoder that slips on its shaft, lost counts or a jumped tooth leave both channels smooth; only
TE = φ₂ − i φ₁ shows them. A robust fit removes all other effects from TE: an offset of each flank
at each speed (backlash, delay, torque of the drive), drift, orders 1 to 4 of both shafts on each
flank, delay times speed, and logged torque. Then steps are searched by least squares in the medians
of the residual over short windows. All limits below are chosen values unless they say otherwise.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from ...base.errors import LogError
from ...base.numerics.well_conditioned import pseudo_inverse
from ...base.units import DEG, REV
from ..encoder_log import EncoderLog
from ..motion.segments import Segment, Segments
from .slip_effects import Effects
from .steps import MOST, Step, find_steps

MOST_ROWS = 40_000
"""Largest number of rows of the fit; longer logs are thinned."""

WINDOWS = 600
LEAST = 4
"""Largest number of windows over the whole log (about), and least number of rows per window."""

LEAST_TURNS = 2.0
"""Least number of driving turns for a search; over fewer turns a part of a harmonic looks like a
step."""

SAME_SPEED = 0.1
"""Segments of one flank within this relative difference of speed share an offset."""


@dataclass(frozen=True)
class Slip:
    """Step of the transmission error by `size_deg` (degrees of the driven shaft) at `time_s`.

    `row` is the index of the first sample after the step; `std_deg` is the standard error of the
    size.
    """

    time_s: float
    row: int
    size_deg: float
    std_deg: float


def slips_text(slips: Sequence[Slip]) -> str:
    """Return a sentence that reports every slip and says what the user can do."""
    where = [f"by {one.size_deg:.3g}° at {one.time_s:.6g} s" for one in slips]
    if len(slips) == 1:
        return (
            f"the transmission error steps {where[0]} and stays: an encoder slipped on its shaft or"
            f" a tooth jumped; cut the log at {slips[0].time_s:.6g} s and fit both parts as two"
            " logs."
        )
    many = "at least " if len(slips) == MOST else ""
    return (
        f"the transmission error steps {many}{len(slips)} times and stays: {', '.join(where)}: an"
        " encoder loses counts or slips on its shaft, or teeth jump; mend this and log again, or"
        " cut the log there and fit the parts as logs of their own."
    )


def find_slips(log: EncoderLog, segments: Segments) -> tuple[Slip, ...]:
    """Return the lasting steps of the transmission error in the order of time.

    **Arguments**
    - `segments`: result of `find_segments` for `log`; samples outside the segments are not used,
      because the flank in contact is not known there.

    Steps are reported if they raise the likelihood enough, unless steps of the delay explain the
    log clearly better; see `find_steps`. One cannot be detected if the flank or the speed changes
    permanently at the same instant.

    **Example**
    ```python
    >>> import numpy as np
    >>> from vttig_jax.logs import EncoderLog
    >>> from vttig_jax.logs import find_segments
    >>> from vttig_jax.logs import find_slips
    >>> from vttig_jax.pair import parse_pair_spec
    >>> drive = parse_pair_spec({"drive": {"ratio": "9/16"}})
    >>> time = np.arange(4000) / 200.0
    >>> wave = 0.02 * np.sin(2 * np.pi * time)
    >>> driven = 202.5 * time + wave + 0.1 * (time > 12.0)
    >>> log = EncoderLog.from_arrays(time, 360.0 * time, driven, pair=drive, unit="deg")
    >>> (slip,) = find_slips(log, find_segments(log))
    >>> slip.row, round(slip.size_deg, 2)
    (2401, 0.1)

    ```
    """
    rows, segment_of, group, forward = _rows(log, segments)
    if len(rows) < 4 * LEAST or np.ptp(log.driving_angle[rows]) < LEAST_TURNS * REV:
        return ()
    edges = _window_starts(segment_of)
    if len(edges) < 4:
        return ()
    effects = Effects.of(log, rows, group, forward)
    residual = _huber_residual(effects, log.transmission_error[rows])
    size = np.diff([*edges, len(rows)])
    medians, means = _medians(residual, edges, size), effects.means(edges, size)
    least, speed = _least_step(log, residual), means[:, effects.speed_place]
    found = []
    for step in find_steps(medians, means, least, rival=speed):
        row = _first_row_after(rows, residual, edges, step, effects.times(step.coefficients))
        found.append(Slip(float(log.time[row]), row, step.size / DEG, step.std / DEG))
    return tuple(found)


def refuse_slip(log: EncoderLog, segments: Segments) -> None:
    """Raise `LogError` if `find_slips` finds slips, because a fit of the log would be wrong."""
    if slips := find_slips(log, segments):
        raise LogError(slips_text(slips), where=log.place.at(row=slips[0].row))


_HUBER_STEPS = 5  # number of reweightings; the weights hardly change after four; chosen value
_FITTED = 200  # rows of the Huber fit per column of its design matrix; chosen value
_DEPENDENT = 1e-12
"""Columns count as dependent if an eigenvalue of the normal matrix is below this share of the
largest one (chosen)."""

_DIGITS = 100.0
"""Largest step that rounding can cause, as a multiple of the rounding error of the TE."""


def _rows(
    log: EncoderLog, segments: Segments
) -> tuple[
    Int[np.ndarray, " m"], Int[np.ndarray, " m"], Int[np.ndarray, " m"], Bool[np.ndarray, " m"]
]:
    """Select the samples of the fit, and return four arrays with one entry per selected sample.

    A sample is selected if it belongs to a segment, where the contacting flank is known, and is not
    a spike. A long log is thinned to about `MOST_ROWS` samples.

    **Returns** the index of the sample in the log, the number of its segment in the order of time,
    the number of its group (segments of one flank and one speed, see `_groups`), and True if flank
    A is in contact.
    """
    spikes = log.spikes
    thin = max(1, (segments.forward + segments.backward) // MOST_ROWS)
    ordered = sorted(segments.segments, key=lambda segment: segment.start)
    kept = []
    for segment in ordered:
        index = np.arange(segment.start, segment.stop, thin)
        kept.append(index[~spikes[index]])
    lengths = [len(index) for index in kept]
    forward = [segment.flank == "A" for segment in ordered]
    rows = np.concatenate([np.zeros(0, np.int64), *kept])
    segment_of = np.repeat(np.arange(len(ordered), dtype=np.int64), lengths)
    group = np.repeat(np.array(_groups(ordered), np.int64), lengths)
    return rows, segment_of, group, np.repeat(np.array(forward, bool), lengths)


def _groups(segments: list[Segment]) -> list[int]:
    """Return a number for each segment, equal for segments of one flank and one speed."""
    representatives: list[Segment] = []
    numbers = []
    for segment in segments:
        alike = [
            number
            for number, first in enumerate(representatives)
            if first.flank == segment.flank
            and abs(segment.speed - first.speed) <= SAME_SPEED * abs(first.speed)
        ]
        numbers.append(alike[0] if alike else len(representatives))
        if not alike:
            representatives.append(segment)
    return numbers


def _least_step(log: EncoderLog, residual: Float[np.ndarray, " m"]) -> float:
    """Return the least size of a slip in rad of the driven shaft.

    It is the largest of half the scatter of the residual, one encoder count, and a multiple of the
    rounding error, which matters in a log without noise. The step of readings in degrees is not
    used, because for steady motion it is the travel per sample.
    """
    limits = [0.5 * float(np.median(np.abs(residual))) / 0.6745, _DIGITS * log.rounding]
    for channel, ratio in ((log.driving, abs(float(log.ratio))), (log.driven, 1.0)):
        if channel is not None and channel.unit == "counts":
            limits.append(ratio * channel.resolution)
    return max(limits)


def _huber_residual(effects: Effects, error: Float[np.ndarray, " m"]) -> Float[np.ndarray, " m"]:
    """Return the residual of a Huber fit of `error` by `effects`; outliers have little influence.

    The fit uses one random row of every few neighbouring rows. `find_steps` fits the coefficients
    again together with the steps. Every iteration solves the weighted normal equations for a
    correction of the coefficients, which removes rounding errors of earlier iterations.
    """
    few = effects.few(_drawn(len(error), effects.width))
    left, weight = error[few.rows], np.ones(len(few.rows))
    changes = []
    for _ in range(_HUBER_STEPS):
        matrix, right = few.normal(weight, left)
        changes.append(pseudo_inverse(matrix, _DEPENDENT) @ right)
        left = left - few.times(changes[-1])
        size = np.abs(left)
        scale = 1.5 * float(np.median(size)) / 0.6745
        weight = scale / np.maximum(size, max(scale, 1e-300))
    first, others = effects.times(np.stack([changes[0], np.sum(changes[1:], axis=0)]))
    return error - first - others


def _drawn(count: int, columns: int) -> Int[np.ndarray, " few"]:
    """Return the indices of one random row from each block of neighbouring rows.

    `count` and `columns` are the numbers of rows and columns. About `_FITTED` rows per column are
    drawn if there are so many. The choice within a block is random, so that outliers at equal
    distances are not drawn every time.
    """
    step = max(1, count // (_FITTED * columns))
    first = np.arange(0, count - step + 1, step)
    return first + np.random.default_rng(0).integers(step, size=len(first))


def _medians(
    values: Float[np.ndarray, " m"], starts: Int[np.ndarray, " w"], size: Int[np.ndarray, " w"]
) -> Float[np.ndarray, " w"]:
    """Return the median of every window; a window has `size` values from index `starts` on."""
    found = np.empty(len(size))
    for length in np.unique(size):
        windows = size == length
        rows = starts[windows, None] + np.arange(length)
        found[windows] = np.median(values[rows], axis=1)
    return found


def _window_starts(segment_of: Int[np.ndarray, " m"]) -> Int[np.ndarray, " w"]:
    """Return the first index of every window; windows have similar length, each in one segment."""
    length = max(LEAST, len(segment_of) // WINDOWS)
    starts = np.flatnonzero(np.diff(segment_of, prepend=-1))
    edges = []
    for start, stop in zip(starts, [*starts[1:], len(segment_of)], strict=True):
        parts = max(1, (stop - start) // length)
        edges += [start + (stop - start) * k // parts for k in range(parts)]
    return np.array(edges, np.int64)


def _first_row_after(
    rows: Int[np.ndarray, " m"],
    residual: Float[np.ndarray, " m"],
    edges: Int[np.ndarray, " w"],
    step: Step,
    correction: Float[np.ndarray, " m"],
) -> int:
    """Return the index in the log of the first sample after the step.

    It is searched within two windows of `step`. `correction` is the change of the fitted TE by the
    coefficients that were fitted together with the step.
    """
    low = int(edges[max(step.window - 2, 0)])
    high = int(edges[min(step.window + 2, len(edges) - 1)])
    level = (residual - correction)[low:high] - step.base
    side = np.clip(level / step.size - 0.5, -0.5, 0.5)
    # The best split has the largest sum of `side` after it.
    after = side.sum() - np.concatenate([[0.0], np.cumsum(side)])[:-1]
    return int(rows[low + int(np.argmax(after))])
