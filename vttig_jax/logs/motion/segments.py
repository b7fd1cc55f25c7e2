"""Segments of a log that certainly lie on one flank, and the steady stretches of a run.

At steady speed the loaded flank follows the sense of motion: A while φ₁ increases, B while it
decreases. Ramps, dwell and the crossing of the gap after a reversal are masked. A torque or
direction column of the log says it better and wins.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float, Int8

from ...base.units import DEG
from ..channel.channel import GAP
from ..channel.speed import Speed, runs, smooth_speed
from ..encoder_log import EncoderLog

SHARE = 0.4
"""A run has a plateau when one speed, within the tolerance, makes this share of its travel."""

FURTHER = 0.15
"""Further plateaus of the same run need this share."""

TOLERANCE = 0.03
"""Relative width of a plateau. A sine spends 0.24 of its travel within 3 % of its top speed."""

RAMP = 0.1
"""A speed that differs from the plateau's by more than this share of it is on a ramp."""

_BIN = 0.01


def levels(speed: Float[np.ndarray, " n"], travel: Float[np.ndarray, " n"]) -> list[float]:
    """Plateau speeds of a run, the longest first; empty where the speed never settles.

    **Arguments**
    - `speed`: magnitudes, > 0. `travel`: distance covered around each sample.
    """
    index = np.floor(np.log(speed) / _BIN).astype(np.int64)
    index -= index.min()
    weight = np.bincount(index, travel) / travel.sum()
    width = round(2 * TOLERANCE / _BIN)
    found = []
    needed = SHARE
    while True:
        window = np.convolve(weight, np.ones(width), "valid") if len(weight) > width else None
        start = 0 if window is None else int(np.argmax(window))
        inside = (index >= start) & (index < start + width)
        if weight[start : start + width].sum() < needed:
            return found
        found.append(float(np.average(speed[inside], weights=travel[inside])))
        weight[start : start + width] = 0.0
        needed = FURTHER


def steady(
    speed: Float[np.ndarray, " n"], level: float, tolerance: float, window: int
) -> list[tuple[int, int]]:
    """Stretches [start, stop) of a run at `level`, without the last of their ramps.

    A stretch loses at each end that meets a ramp as much as the ramp took from 10 % off the level
    to the tolerance, and half the smoothing window.
    """
    inside = np.abs(speed / level - 1.0) <= tolerance
    stretches = []
    for start, stop in _closed(inside, window):
        first = start + _margin(speed[:start][::-1], level, window)
        last = stop - _margin(speed[stop:], level, window)
        if last - first >= 2:
            stretches.append((first, last))
    return stretches


def _margin(outside: Float[np.ndarray, " m"], level: float, window: int) -> int:
    """Samples to leave out at an end, from the speeds beyond it, nearest first."""
    if len(outside) == 0:
        return 0
    ramp = np.abs(outside / level - 1.0) > RAMP
    return window // 2 + (int(np.argmax(ramp)) if ramp.any() else min(len(outside), window))


def _closed(inside: Bool[np.ndarray, " n"], window: int) -> list[tuple[int, int]]:
    """True stretches, with interruptions up to a window bridged and flickers dropped."""
    padded = np.concatenate([[False], inside, [False]])
    edges = np.flatnonzero(padded[1:] != padded[:-1])
    joined: list[list[int]] = []
    for start, stop in zip(edges[::2], edges[1::2], strict=True):
        if joined and start - joined[-1][1] <= window:
            joined[-1][1] = int(stop)
        else:
            joined.append([int(start), int(stop)])
    least = max(window, 0.01 * len(inside))
    return [(start, stop) for start, stop in joined if stop - start >= least]


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
class MotionPhase:
    """Samples [start, stop) that move one way or not at all; `speed` is their mean in rad/s."""

    start: int
    stop: int
    kind: Kind
    speed: float


@dataclass(frozen=True)
class Segments:
    """What became of the samples of a log. `forward` counts those on flank A, `backward` on B."""

    segments: tuple[Segment, ...]
    motion: tuple[MotionPhase, ...]
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
) -> MotionPhase:
    kinds: dict[int, Kind] = {1: "forward", 0: "dwell", -1: "backward"}
    return MotionPhase(start, stop, kinds[sense], _mean_speed(start, stop, time, angle))


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
