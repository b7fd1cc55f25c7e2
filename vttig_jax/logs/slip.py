"""A slip: the transmission error changes its level at one instant and keeps the new one.

An encoder that slips on its shaft, lost counts or a jumped tooth leave both channels smooth; only
TE = φ₂ − i φ₁ shows them. From TE everything is taken that is no slip: an offset of each flank at
each speed (backlash, delay, torque of the drive), drift, orders 1 to 4 of both shafts on each
flank, delay times speed, and torque where it was logged. In medians over short windows of what is
left, steps are sought at every instant by least squares.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from ..base.errors import LogError
from ..base.units import DEG, REV
from .encoder_log import EncoderLog
from .segments import Segment, Segments
from .speed import smooth_speed
from .steps import Step, find_steps

MOST_ROWS = 40_000
"""Rows the columns are computed on; longer logs are thinned."""

WINDOWS = 600
LEAST = 4
"""Windows over the whole log, and rows of the shortest."""

ORDERS = 4
"""Orders of each shaft taken out."""

LEAST_TURNS = 2.0
"""Driving turns below which a harmonic, seen in part, passes for a step."""

SAME_SPEED = 0.1
"""Segments of one flank within this share of speed share an offset."""


@dataclass(frozen=True)
class Slip:
    """TE steps by `size_deg` (of the driven shaft) at `time_s`; `row` is the first row after it."""

    time_s: float
    row: int
    size_deg: float
    std_deg: float

    @property
    def sentence(self) -> str:
        """What was seen, and the cure."""
        return (
            f"the transmission error steps by {self.size_deg:.3g}° at {self.time_s:.6g} s and"
            " stays: an encoder slipped on its shaft or a tooth jumped; cut the log at"
            f" {self.time_s:.6g} s and fit both parts as two logs."
        )


def find_slip(log: EncoderLog, segments: Segments) -> Slip | None:
    """The largest lasting step of the transmission error, or None.

    **Arguments**
    - `segments`: of `log`, as from `find_segments`; only samples on a certain flank are looked at.

    A step is told only where it is sharp, holds on both sides, and is at least 8 robust standard
    deviations of what else is left in the windows. Where the flank or the speed changes for good at
    the same instant, none can be told.

    **Example**
    ```python
    >>> import numpy as np
    >>> from vttig_jax.logs.encoder_log import EncoderLog
    >>> from vttig_jax.logs.segments import find_segments
    >>> from vttig_jax.logs.slip import find_slip
    >>> from vttig_jax.pair.spec import parse_pair_spec
    >>> drive = parse_pair_spec({"drive": {"ratio": "9/16"}})
    >>> time = np.arange(4000) / 200.0
    >>> wave = 0.02 * np.sin(2 * np.pi * time)
    >>> driven = 202.5 * time + wave + 0.1 * (time > 12.0)
    >>> log = EncoderLog.from_arrays(time, 360.0 * time, driven, pair=drive, unit="deg")
    >>> slip = find_slip(log, find_segments(log))
    >>> slip.row, round(slip.size_deg, 2)
    (2401, 0.1)

    ```
    """
    rows, piece, group, forward = _rows(log, segments)
    if len(rows) < 4 * LEAST or np.ptp(log.driving_angle[rows]) < LEAST_TURNS * REV:
        return None
    columns = _columns(log, rows, group, forward)
    error = log.transmission_error[rows]
    rest = _without(columns, error)
    edges = _edges(piece)
    if len(edges) < 4:
        return None
    medians = np.array(
        [np.median(rest[a:b]) for a, b in zip(edges, [*edges[1:], len(rows)], strict=True)]
    )
    size = np.diff([*edges, len(rows)])
    means = np.add.reduceat(columns, edges, axis=0) / size[:, None]
    steps = find_steps(medians, means, _least(log, rest))
    if not steps:
        return None
    largest = max(steps, key=lambda step: abs(step.size))
    row = _row(log, rows, rest, edges, largest, columns @ largest.coefficients)
    return Slip(float(log.time[row]), row, largest.size / DEG, largest.std / DEG)


def refuse_slip(log: EncoderLog, segments: Segments) -> None:
    """Raise `LogError` where `find_slip` finds one: no fit can trust a log with a slip in it."""
    slip = find_slip(log, segments)
    if slip is not None:
        raise LogError(slip.sentence, where=log.place.at(row=slip.row))


_DIGITS = 100.0
"""Units of the last digit of the readings up to which a step is rounding."""


def _rows(
    log: EncoderLog, segments: Segments
) -> tuple[
    Int[np.ndarray, " m"], Int[np.ndarray, " m"], Int[np.ndarray, " m"], Bool[np.ndarray, " m"]
]:
    """Rows on a certain flank that are no spikes; segment, group and "flank A" of each."""
    apart = log.spikes
    thin = max(1, (segments.forward + segments.backward) // MOST_ROWS)
    ordered = sorted(segments.segments, key=lambda segment: segment.start)
    kept = []
    for segment in ordered:
        own = np.arange(segment.start, segment.stop, thin)
        kept.append(own[~apart[own]])
    lengths = [len(own) for own in kept]
    group = _groups(ordered)
    forward = [segment.flank == "A" for segment in ordered]
    rows = np.concatenate([np.zeros(0, np.int64), *kept])
    piece, group, forward = (
        np.repeat(np.array(each, kind), lengths)
        for each, kind in ((range(len(ordered)), np.int64), (group, np.int64), (forward, bool))
    )
    return rows, piece, group, forward


def _groups(segments: list[Segment]) -> list[int]:
    """A number for each segment, equal for those of one flank and one speed."""
    seen: list[Segment] = []
    numbers = []
    for segment in segments:
        alike = [
            number
            for number, first in enumerate(seen)
            if first.flank == segment.flank
            and abs(segment.speed - first.speed) <= SAME_SPEED * abs(first.speed)
        ]
        numbers.append(alike[0] if alike else len(seen))
        if not alike:
            seen.append(segment)
    return numbers


def _least(log: EncoderLog, rest: Float[np.ndarray, " m"]) -> float:
    """Smallest step told, rad: half the scatter of the readings, and one count of either encoder.

    The step of readings in degrees is no measure: steady motion makes it as large as itself. Steps
    of the last digit of a log without noise are none.
    """
    found = [0.5 * float(np.median(np.abs(rest))) / 0.6745, _DIGITS * log.rounding]
    for channel, size in ((log.driving, abs(float(log.ratio))), (log.driven, 1.0)):
        if channel is not None and channel.unit == "counts":
            found.append(size * channel.resolution)
    return max(found)


def _columns(
    log: EncoderLog,
    rows: Int[np.ndarray, " m"],
    group: Int[np.ndarray, " m"],
    forward: Bool[np.ndarray, " m"],
) -> Float[np.ndarray, "m p"]:
    """What changes TE without a slip, at some rows; every column of size about 1."""
    time = log.time[rows]
    span = max(float(np.ptp(time)), 1e-300)
    flanks = [on for on in (forward, ~forward) if on.any()]
    columns = [(group == k).astype(np.float64) for k in range(int(group.max()) + 1)]
    columns.append((time - time.mean()) / span)
    speed = smooth_speed(log.time, log.driving_angle, log.driving.resolution).value[rows]
    columns.append(_scaled(speed))
    for angle in (log.driving_angle[rows], log.driven_angle[rows]):
        for order in range(1, ORDERS + 1):
            for wave in (np.cos(order * angle), np.sin(order * angle)):
                columns += [wave * own for own in flanks]
    if log.torque is not None:
        columns.append(_scaled(log.torque[rows]))
    return np.stack(columns, axis=1)


def _scaled(values: Float[np.ndarray, " m"]) -> Float[np.ndarray, " m"]:
    return values / max(float(np.abs(values).max()), 1e-300)


def _without(
    columns: Float[np.ndarray, "m p"], error: Float[np.ndarray, " m"]
) -> Float[np.ndarray, " m"]:
    """Residual of a Huber fit: late readings must not bend it."""
    weight, rest = np.ones(len(error)), error
    for _ in range(5):
        root = np.sqrt(weight)
        found = np.linalg.lstsq(root[:, None] * columns, root * error, rcond=1e-9)[0]
        rest = error - columns @ found
        scale = 1.5 * float(np.median(np.abs(rest))) / 0.6745
        weight = scale / np.maximum(np.abs(rest), max(scale, 1e-300))
    return rest


def _edges(piece: Int[np.ndarray, " m"]) -> Int[np.ndarray, " w"]:
    """First rows of windows of about equal length, none across two segments."""
    length = max(LEAST, len(piece) // WINDOWS)
    starts = np.flatnonzero(np.diff(piece, prepend=-1))
    edges = []
    for start, stop in zip(starts, [*starts[1:], len(piece)], strict=True):
        parts = max(1, (stop - start) // length)
        edges += [start + (stop - start) * k // parts for k in range(parts)]
    return np.array(edges, np.int64)


def _row(
    log: EncoderLog,
    rows: Int[np.ndarray, " m"],
    rest: Float[np.ndarray, " m"],
    edges: Int[np.ndarray, " w"],
    step: Step,
    change: Float[np.ndarray, " m"],
) -> int:
    """First row after the step: where one level turns into the other, near its window."""
    low = int(edges[max(step.window - 2, 0)])
    high = int(edges[min(step.window + 2, len(edges) - 1)])
    level = (rest - change)[low:high] - step.base
    side = np.clip(level / step.size - 0.5, -0.5, 0.5)
    # The split with the most of what is beyond half the step after it.
    after = side.sum() - np.concatenate([[0.0], np.cumsum(side)])[:-1]
    return int(rows[low + int(np.argmax(after))])
