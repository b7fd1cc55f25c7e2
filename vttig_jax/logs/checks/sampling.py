"""Sampling of a log: rate, jitter and gaps, and effects of the rate on counts and orders."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ...base.units import REV
from ..channel.channel import GAP
from ..encoder_log import EncoderLog
from ..motion.segments import Segment

COMMENSURATE = 1e-3
"""If the counts per sample are this close to a whole number, the quantisation error is constant
(chosen)."""

SAME_SPEED = 0.03
"""Segments with a smaller relative difference of speed belong to one plateau (chosen)."""


@dataclass(frozen=True)
class Sampling:
    """Properties of the time stamps of a log; see `sampling_of` for rate and jitter.

    `gaps` is the number of intervals longer than `GAP` median intervals, `duplicates` the number of
    intervals of length 0. `shortest_s` and `longest_s` are the extremes of the intervals.
    """

    duration_s: float
    rate_hz: float
    jitter_s: float
    shortest_s: float
    longest_s: float
    gaps: int
    duplicates: int


@dataclass(frozen=True)
class SpeedPlateau:
    """Samples at one speed on one flank; `speed_rpm` is the signed driving speed."""

    speed_rpm: float
    flank: str
    segments: int
    samples: int


@dataclass(frozen=True)
class Commensurate:
    """Segment in which `shaft` turns by a whole number of counts per sample.

    `speed_rpm` is the signed speed of the driving shaft.
    """

    shaft: str
    speed_rpm: float
    counts_per_sample: float


@dataclass(frozen=True)
class Aliased:
    """Orders of a shaft, from `order` to `highest`, that lie above half the sampling rate.

    `speed_rpm` is the driving speed at which they do so.
    """

    shaft: str
    order: int | float
    highest: int | float
    speed_rpm: float


def sampling_of(time: Float[np.ndarray, " n"]) -> Sampling:
    """Return the properties of the time stamps in s.

    Rate (from the mean interval) and jitter (standard deviation of the intervals) exclude gaps.
    """
    interval = np.diff(time)
    median = float(np.median(interval))
    usual = interval[interval <= GAP * median]
    return Sampling(
        duration_s=float(time[-1] - time[0]),
        rate_hz=1.0 / float(usual.mean()),
        jitter_s=float(usual.std()),
        shortest_s=float(interval.min()),
        longest_s=float(interval.max()),
        gaps=int(np.count_nonzero(interval > GAP * median)),
        duplicates=int(np.count_nonzero(interval == 0)),
    )


def plateaus_of(segments: Sequence[Segment]) -> tuple[SpeedPlateau, ...]:
    """Return plateaus: segments of one flank and nearly equal speed, in the order of the log."""
    groups: list[list[Segment]] = []
    for segment in segments:
        for group in groups:
            same = abs(segment.speed / group[0].speed - 1) < SAME_SPEED if group[0].speed else False
            if segment.flank == group[0].flank and same:
                group.append(segment)
                break
        else:
            groups.append([segment])
    return tuple(_plateau(group) for group in groups)


def _plateau(group: Sequence[Segment]) -> SpeedPlateau:
    sizes = [s.stop - s.start for s in group]
    speed = float(np.average([s.speed for s in group], weights=sizes))
    return SpeedPlateau(60 * speed / REV, group[0].flank, len(group), sum(sizes))


def commensurate(log: EncoderLog, segments: Sequence[Segment]) -> tuple[Commensurate, ...]:
    """Return shafts with readings in whole counts that turn by a whole number of counts per sample.

    Each combination of shaft and number of counts is reported once, for its first segment.
    """
    findings = {}
    for shaft, channel in (("driving", log.driving), ("driven", log.driven)):
        if channel is None or not np.issubdtype(channel.reading.dtype, np.integer):
            continue
        for segment in segments:
            last = segment.stop - 1
            moved = int(channel.reading[last] - channel.reading[segment.start])
            per_sample = abs(moved) / (last - segment.start)
            whole = round(per_sample)
            if whole >= 1 and abs(per_sample - whole) < COMMENSURATE:
                speed = 60 * segment.speed / REV
                findings.setdefault((shaft, whole), Commensurate(shaft, speed, per_sample))
    return tuple(findings.values())


def aliased(
    plateaus: Sequence[SpeedPlateau],
    rate_hz: float,
    orders: Mapping[str, tuple[float, Sequence[int | float]]],
) -> tuple[Aliased, ...]:
    """Return for each shaft the orders of the fit above half the sampling rate at the top speed.

    **Arguments**
    - `orders`: shaft → (its speed relative to the driving shaft, its orders in the fit).
    """
    findings: dict[str, Aliased] = {}
    for plateau in sorted(plateaus, key=lambda p: -abs(p.speed_rpm)):
        for shaft, (relative, used) in orders.items():
            turns = abs(plateau.speed_rpm * relative) / 60
            above = [order for order in used if order * turns >= rate_hz / 2]
            if above and shaft not in findings:
                findings[shaft] = Aliased(shaft, min(above), max(above), plateau.speed_rpm)
    return tuple(findings.values())
