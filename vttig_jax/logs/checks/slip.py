"""Slips: instants at which the transmission error changes its level and keeps the new one.

An encoder that slips on its shaft, lost counts or a jumped tooth leave both channels smooth; only
TE = φ₂ − i φ₁ shows them. From TE everything is taken that is no slip: an offset of each flank at
each speed (backlash, delay, torque of the drive), drift, orders 1 to 4 of both shafts on each
flank, delay times speed, and torque where it was logged. In medians over short windows of what is
left, steps are sought at every instant by least squares.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from ...base.errors import LogError
from ...base.units import DEG, REV
from ..channel.speed import smooth_speed
from ..encoder_log import EncoderLog
from ..motion.segments import Segment, Segments

DEVIATIONS = 8.0
"""A step is at least this many robust standard deviations of what is left."""

MOST = 3
"""Steps looked for, one after the other."""

NEAR = 6
"""Values on either side in which a step must be complete."""

EQUAL = 0.3
"""Share of the step by which levels far from it may differ from those beside it."""

SEEN = 0.02
"""A step is told from the columns when this share of its shorter side is left beside them."""


@dataclass(frozen=True, eq=False)
class Step:
    """Values from `window` on are higher by `size`, with its standard error `std`.

    `base` is the level before it once `coefficients` of the columns are taken off.
    """

    window: int
    size: float
    std: float
    base: float
    coefficients: Float[np.ndarray, " p"]


def find_steps(
    values: Float[np.ndarray, " w"], columns: Float[np.ndarray, "w p"], least: float = 0.0
) -> list[Step]:
    """Steps that are large, sharp and lasting; the columns are fitted beside them.

    **Arguments**
    - `values`: the series, shape (w,). `columns`: what else may be in it, shape (w, p).
    - `least`: smaller steps are none.
    """
    count = len(values)
    if count < 4 * NEAR:
        return []
    places: list[int] = []
    for _ in range(MOST):
        place = _best(values, np.hstack([columns, _steps(places, count)]), places)
        if place is None:
            break
        places.append(place)
    for used in range(len(places), 0, -1):
        found = _judged(values, columns, places[:used], least)
        if found:
            return found
    return []


def _steps(places: list[int], count: int) -> Float[np.ndarray, "w s"]:
    return (np.arange(count)[:, None] >= np.array(places, np.int64)[None, :]).astype(np.float64)


def _best(
    values: Float[np.ndarray, " w"], columns: Float[np.ndarray, "w p"], taken: list[int]
) -> int | None:
    """Where one more step, not beside those `taken`, takes the most of the sum of squares away."""
    count = len(values)
    basis = _basis(columns)
    rest = values - basis @ (basis.T @ values)
    # Step k is 1 from k on: sums over the tail of what the columns leave.
    tail = np.cumsum(basis[::-1], axis=0)[::-1]
    places = np.arange(count)
    left = (count - places) - np.sum(tail**2, axis=1)
    shorter = np.minimum(places, count - places)
    usable = (shorter >= NEAR // 2) & (left > SEEN * shorter)
    for place in taken:  # a step within a few values is one
        usable &= np.abs(places - place) > NEAR
    if not usable.any():
        return None
    gain = np.cumsum(rest[::-1])[::-1] ** 2 / np.where(usable, left, np.inf)
    return int(np.argmax(gain))


def _basis(columns: Float[np.ndarray, "w p"]) -> Float[np.ndarray, "w r"]:
    left, size, _ = np.linalg.svd(columns, full_matrices=False)
    return left[:, size > 1e-6 * size[0]]


def _judged(
    values: Float[np.ndarray, " w"],
    columns: Float[np.ndarray, "w p"],
    places: list[int],
    least: float,
) -> list[Step]:
    """Those of the steps at `places`, fitted together, that pass."""
    count, wide = columns.shape
    steps = _steps(places, count)
    design = np.hstack([columns, steps])
    found = np.linalg.lstsq(design, values, rcond=1e-9)[0]
    rest = values - design @ found
    sigma = 1.4826 * float(np.median(np.abs(rest - np.median(rest))))
    sigma *= np.sqrt(count / max(count - _basis(design).shape[1], 1))
    sigma = max(float(sigma), least / DEVIATIONS, 1e-12 * float(np.ptp(values)))
    correlation = np.clip(rest[1:] @ rest[:-1] / max(float(rest @ rest), 1e-300), 0.0, 0.95)
    passed = []
    for k, place in enumerate(places):
        size = float(found[wide + k])
        level = rest + size * steps[:, k]
        if abs(size) < DEVIATIONS * sigma or not _lasting(level, place, size):
            continue
        others = _basis(np.delete(design, wide + k, axis=1))
        beside = steps[:, k] - others @ (others.T @ steps[:, k])
        std = sigma * np.sqrt((1 + correlation) / (1 - correlation) / (beside @ beside))
        base = float(np.median(level[max(0, place - NEAR) : place]))
        passed.append(Step(place, size, float(std), base, found[:wide]))
    return passed


def _lasting(level: Float[np.ndarray, " w"], place: int, size: float) -> bool:
    """Whether the step is complete within a few values, and the level holds on both sides."""
    before, after = level[:place], level[place:]
    # The value beside the step may hold part of both levels.
    near = np.median(after[1 : NEAR + 1]) - np.median(before[-NEAR - 1 : -1])
    if abs(near - size) > EQUAL * abs(size):
        return False
    parts = [*np.array_split(before, 3), *np.array_split(after, 3)]
    wanted = [0.0] * 3 + [size] * 3
    levels = [float(np.median(part)) for part in parts if len(part)]
    return len(levels) == 6 and all(
        abs(seen - expected) <= EQUAL * abs(size)
        for seen, expected in zip(levels, wanted, strict=True)
    )


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
    >>> from vttig_jax.logs import EncoderLog
    >>> from vttig_jax.logs import find_segments
    >>> from vttig_jax.logs import find_slip
    >>> from vttig_jax.pair import parse_pair_spec
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
