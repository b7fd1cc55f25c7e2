"""Which samples certainly lie on one flank.

At steady speed the loaded flank follows the sense of motion: A while φ₁ increases, B while it
decreases. Ramps, dwell and the crossing of the gap after a reversal are masked. A torque or
direction column of the log says it better and wins.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float, Int8

from ..base.units import DEG
from .channel import GAP
from .encoder_log import EncoderLog
from .plateau import TOLERANCE, levels, steady
from .speed import Speed, runs, smooth_speed

Flank = Literal["A", "B"]
Kind = Literal["forward", "dwell", "backward"]

AFTER_REVERSAL = (1 - 1e-6) * DEG
"""Driving angle masked after a reversal, and after a start from standstill: a degree, less so much
that no whole count and no printed decimal lies on the edge, where rounding would decide."""

SHORTEST_RUN = 15.5
"""A run that travels fewer quanta than this is noise around standstill."""

RAGGED = 0.100_01
"""Without a plateau, samples faster than this share of their run's top speed count as certain."""

TORQUE = 0.049_99
"""Share of its 95th percentile above which the torque decides the flank."""

SHORTEST = 8
"""Samples of the shortest segment."""


@dataclass(frozen=True)
class Segment:
    """Samples [start, stop) certainly on `flank`; `speed` is their mean, rad/s of driving shaft."""

    start: int
    stop: int
    flank: Flank
    speed: float


@dataclass(frozen=True)
class Motion:
    """Samples [start, stop) that move one way or not at all; `speed` is their mean in rad/s."""

    start: int
    stop: int
    kind: Kind
    speed: float


@dataclass(frozen=True)
class Segments:
    """What became of the samples of a log. `forward` counts those on flank A, `backward` on B."""

    segments: tuple[Segment, ...]
    motion: tuple[Motion, ...]
    read: int
    notes: tuple[str, ...] = ()

    @property
    def forward(self) -> int:
        """Samples certainly on flank A."""
        return self._count("A")

    @property
    def backward(self) -> int:
        """Samples certainly on flank B."""
        return self._count("B")

    @property
    def masked(self) -> int:
        """Samples on no certain flank."""
        return self.read - self.forward - self.backward

    def _count(self, flank: Flank) -> int:
        return sum(s.stop - s.start for s in self.segments if s.flank == flank)


def find_segments(log: EncoderLog) -> Segments:
    """Split a log into segments on a certain flank and runs of one motion.

    - Steady speed: the sense of motion, without ramps, dwell and the first degree of a run.
    - No steady speed in a run (sine motion, hand-driven): all of it above 10 % of its top speed; a
      note says so.
    - `log.direction`: replaces the sense; 0 is masked. `log.torque`: its sign replaces it wherever
      |torque| is at least 5 % of its 95th percentile, ramps included. With both, they must agree.
    - Gaps in time (more than 5 median intervals) and changes of plateau separate segments.
    """
    time = log.time
    angle = log.driving.steady_angle(time)
    interval = np.diff(time)
    cut = np.concatenate([[True], interval > GAP * np.median(interval)])
    speed = smooth_speed(time, angle, log.driving.resolution)
    sense = _sense(speed, angle, cut)
    spans = runs(sense, cut)
    motion = tuple(_motion(a, b, int(sense[a]), time, angle) for a, b in spans)
    moving = [(m.start, m.stop) for m in motion if m.kind != "dwell"]
    certain, ragged = _certain(log, angle, speed, moving)
    flank = _flank(log, sense)
    certain &= (flank != 0) & (sense != 0)
    certain &= ~_crossing(flank, sense, angle, cut, moving)
    state = np.where(certain, flank, 0)
    edges = cut.copy()
    edges[[start for start, _ in spans]] = True
    segments = tuple(
        Segment(a, b, "A" if state[a] > 0 else "B", _mean_speed(a, b, time, angle))
        for a, b in runs(state, edges)
        if state[a] != 0 and b - a >= SHORTEST
    )
    notes = []
    if ragged and log.torque is None:
        notes.append(
            f"no steady speed in {ragged} of {len(moving)} runs: everything faster than"
            f" {RAGGED:.0%} of the top speed of a run counts as on its flank"
        )
    used = [name for name in ("direction", "torque") if getattr(log, name) is not None]
    if used:
        notes.append(f"flanks assigned by the {' and the '.join(used)} column")
    return Segments(segments, motion, len(log), tuple(notes))


def _sense(
    speed: Speed, angle: Float[np.ndarray, " n"], cut: Bool[np.ndarray, " n"]
) -> Int8[np.ndarray, " n"]:
    """+1, 0, −1 per sample; a run that goes no further than its noise is dwell."""
    sense = np.where(np.abs(speed.value) > speed.dwell, np.sign(speed.value), 0).astype(np.int8)
    for start, stop in runs(sense, cut):
        if sense[start] and abs(angle[stop - 1] - angle[start]) < SHORTEST_RUN * speed.quantum:
            sense[start:stop] = 0
    return sense


def _motion(
    start: int, stop: int, sense: int, time: Float[np.ndarray, " n"], angle: Float[np.ndarray, " n"]
) -> Motion:
    kinds: dict[int, Kind] = {1: "forward", 0: "dwell", -1: "backward"}
    return Motion(start, stop, kinds[sense], _mean_speed(start, stop, time, angle))


def _mean_speed(
    start: int, stop: int, time: Float[np.ndarray, " n"], angle: Float[np.ndarray, " n"]
) -> float:
    elapsed = time[stop - 1] - time[start]
    return float((angle[stop - 1] - angle[start]) / elapsed) if elapsed > 0 else 0.0


def _certain(
    log: EncoderLog, angle: Float[np.ndarray, " n"], speed: Speed, moving: list[tuple[int, int]]
) -> tuple[Bool[np.ndarray, " n"], int]:
    """Samples whose motion leaves no doubt about the flank, and the number of ragged runs."""
    certain = np.zeros(len(log), bool)
    if log.torque is not None:
        for start, stop in moving:
            certain[start:stop] = True
        return certain, 0
    travel = np.abs(np.gradient(angle))
    fast = np.abs(speed.value)
    median = np.median(np.diff(log.time))
    ragged = 0
    for start, stop in moving:
        own = fast[start:stop]
        found = levels(own, np.maximum(travel[start:stop], 1e-3 * travel[start:stop].mean()))
        for level in found:
            unsteady = 3.0 * speed.quantum / (speed.window * median * level)
            for a, b in steady(own, level, max(TOLERANCE, unsteady), speed.window):
                certain[start + a : start + b] = True
        if not found:
            ragged += 1
            certain[start:stop] = own > RAGGED * own.max()
    return certain, ragged


def _flank(log: EncoderLog, sense: Int8[np.ndarray, " n"]) -> Int8[np.ndarray, " n"]:
    """+1 flank A, −1 flank B, 0 neither, by the best evidence in the log."""
    flank = sense if log.direction is None else log.direction
    if log.torque is not None:
        loaded = np.abs(log.torque) >= TORQUE * np.quantile(np.abs(log.torque), 0.95)
        by_torque = np.where(loaded, np.sign(log.torque), 0).astype(np.int8)
        flank = by_torque if log.direction is None else np.where(flank == by_torque, flank, 0)
    return flank.astype(np.int8)


def _crossing(
    flank: Int8[np.ndarray, " n"],
    sense: Int8[np.ndarray, " n"],
    angle: Float[np.ndarray, " n"],
    cut: Bool[np.ndarray, " n"],
    moving: list[tuple[int, int]],
) -> Bool[np.ndarray, " n"]:
    """Samples within `AFTER_REVERSAL` of a change of flank, a reversal or a start."""
    starts: set[int] = {start for start, _ in moving if not cut[start]}
    decided = np.flatnonzero(flank)
    flips = np.flatnonzero(np.diff(flank[decided]))
    starts.update(decided[flips + 1].tolist())
    masked = np.zeros(len(angle), bool)
    ordered = sorted(starts)
    for start, stop in zip(ordered, [*ordered[1:], len(angle)], strict=False):
        beyond = np.abs(angle[start:stop] - angle[start]) >= AFTER_REVERSAL
        masked[start : start + int(np.argmax(beyond)) if beyond.any() else stop] = True
    return masked
