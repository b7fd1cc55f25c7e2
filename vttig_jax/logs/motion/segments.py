"""Segments of a log in which the contacting flank is certain, and the turns that they cover.

At steady speed the direction of motion defines the loaded flank: A while φ₁ increases, B while it
decreases. Ramps, dwell and the crossing of the gap after a reversal are masked. A torque or
direction column of the log is better evidence and overrides the motion.

A calibration table, a table after ISO 230-2 or readings of a dial gauge have no motion: no speed,
ramps or crossing of the gap, and their time says only the order of the readings. Each row is a
place at which the shafts stood, and the flank follows from the direction of approach.

The turns of each shaft and the directions decide what a fit can determine.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float, Int, Int8

from ...base.units import DEG, REV
from ...pair.schema import Flank
from ..channel.channel import gaps_of
from ..channel.speed import SAME, Speed, runs, usual_step
from ..encoder_log import EncoderLog

SHARE = 0.4
"""The first plateau of a run must hold at least this fraction of the travel of the run (chosen)."""

FURTHER = 0.15
"""Each further plateau must hold at least this fraction of the travel of the run (chosen)."""

TOLERANCE = 0.03
"""Relative tolerance of the speed at a plateau (chosen). A sine motion has 0.24 of its travel
within 3 % of one speed, which is less than `SHARE`."""

RAMP = 0.1
"""A speed that differs from that of the plateau by more than this fraction is a ramp (chosen)."""

FLUCTUATION = 0.3
"""Least deviation from the plateau speed, relative to it, that ends a steady stretch (chosen).
Smaller deviations between two parts at the plateau speed are fluctuations of the drive or errors of
the time stamps; they do not move the contact to the other flank."""

_LEAST, _LONG = 0.01, 10
"""A steady stretch has at least the first fraction of the samples of its run, but a stretch of the
second number of smoothing windows is always long enough: in a long run that changes between two
speeds every stretch is a small fraction (chosen)."""

_BIN = 0.01  # width of the bins of the logarithm of speed


def levels(speed: Float[np.ndarray, " n"], travel: Float[np.ndarray, " n"]) -> list[float]:
    """Return the plateau speeds of a run in rad/s, the plateau with most travel first.

    The list is empty if the run has no steady speed.

    **Arguments**
    - `speed`: magnitudes > 0 in rad/s. `travel`: travel in rad at each sample.
    """
    index = np.floor(np.log(speed) / _BIN).astype(np.int32)
    index -= index.min()
    weight = np.bincount(index, travel) / travel.sum()
    width = round(2 * TOLERANCE / _BIN)
    plateaus = []
    needed = SHARE
    while True:
        window = np.convolve(weight, np.ones(width), "valid") if len(weight) > width else None
        start = 0 if window is None else int(np.argmax(window))
        inside = (index >= start) & (index < start + width)
        if weight[start : start + width].sum() < needed:
            return plateaus
        there = np.where(inside, travel, 0.0)
        plateaus.append(float(speed @ there / there.sum()))
        weight[start : start + width] = 0.0
        needed = FURTHER


def steady(
    speed: Float[np.ndarray, " n"], level: float, tolerance: float, window: int
) -> list[tuple[int, int]]:
    """Return stretches [start, stop) of a run at the speed `level` (rad/s), without ends of ramps.

    A sample is at the level if its speed deviates by at most `tolerance` (relative). A stretch
    continues through fluctuations below `FLUCTUATION`. At each end beside a ramp, it is shortened
    by the duration of the ramp from 10 % off the level to the tolerance, and by half the smoothing
    window. `window` is the length of that window in samples.
    """
    deviation = np.abs(speed / level - 1.0)
    stretches = []
    for start, stop in _merged(deviation <= tolerance, deviation > FLUCTUATION, window):
        first = start + _margin(speed[:start][::-1], level, window)
        last = stop - _margin(speed[stop:], level, window)
        if last - first >= 2:
            stretches.append((first, last))
    return stretches


def _margin(outside: Float[np.ndarray, " m"], level: float, window: int) -> int:
    """Return the number of samples to omit at one end of a stretch; see `steady`.

    `outside` holds the speeds beyond this end, the nearest sample first.
    """
    if len(outside) == 0:
        return 0
    ramp = np.abs(outside / level - 1.0) > RAMP
    return window // 2 + (int(np.argmax(ramp)) if ramp.any() else min(len(outside), window))


def _merged(
    inside: Bool[np.ndarray, " n"], outside: Bool[np.ndarray, " n"], window: int
) -> list[tuple[int, int]]:
    """Return the stretches [start, stop) in which `inside` is true, without short stretches.

    Two stretches are joined if at most `window` samples lie between them, or if no sample between
    them is true in `outside`.
    """
    left = np.concatenate([[0], np.cumsum(outside)])
    joined: list[tuple[int, int]] = []
    for start, stop in (span for span in runs(inside) if inside[span[0]]):
        first, last = joined[-1] if joined else (0, 0)
        if joined and (start - last <= window or left[start] == left[last]):
            joined[-1] = first, stop
        else:
            joined.append((start, stop))
    least = max(window, min(_LEAST * len(inside), _LONG * window))
    return [(start, stop) for start, stop in joined if stop - start >= least]


Kind = Literal["forward", "dwell", "backward"]

AFTER_REVERSAL = (1 - 1e-6) * DEG
"""Travel of the driving shaft, in rad, that is masked after a reversal and after a start from
standstill: one degree (chosen), slightly reduced so that no reading lies exactly on the limit,
where rounding errors would decide."""

SHORTEST_RUN = 15.5
"""A run whose travel is fewer quanta than this is noise at standstill (chosen). A quantum is the
step or the noise of the driving angle; see `Speed`."""

RAGGED = 0.100_01
"""Least speed for a certain flank in a run without plateau, relative to its top speed (chosen)."""

TORQUE = 0.049_99
"""Least torque that defines the flank, relative to its 95th percentile (chosen)."""

SHORTEST = 8
"""Least number of samples of a segment (chosen)."""


@dataclass(frozen=True)
class Segment:
    """Samples [start, stop) with certain contact on `flank`.

    `speed` is the mean speed of the driving shaft in rad/s, negative if φ₁ falls.
    """

    start: int
    stop: int
    flank: Flank
    speed: float


@dataclass(frozen=True)
class MotionPhase:
    """Samples [start, stop) with one direction of motion, or with standstill (dwell).

    `speed` is the mean speed of the driving shaft in rad/s, negative if φ₁ falls.
    """

    start: int
    stop: int
    kind: Kind
    speed: float


@dataclass(frozen=True)
class Segments:
    """Division of a log into segments with a certain flank, and into phases of motion.

    `segments` are parts of the phases `motion`. `read` is the number of samples of the log.
    `crossing` is the travel of the driving shaft in rad that is left out after each sample of
    `starts`, where the flank changes or a run begins. `unclear` says why the flank of many samples
    is unknown, and is empty otherwise. `still`: whether the samples are readings at standstill.
    """

    segments: tuple[Segment, ...]
    motion: tuple[MotionPhase, ...]
    read: int
    notes: tuple[str, ...] = ()
    crossing: float = AFTER_REVERSAL
    starts: tuple[int, ...] = ()
    unclear: str = ""
    still: bool = False

    @property
    def forward(self) -> int:
        """Number of samples certainly on flank A."""
        return self._count("A")

    @property
    def backward(self) -> int:
        """Number of samples certainly on flank B."""
        return self._count("B")

    @property
    def masked(self) -> int:
        """Number of samples whose flank is not certain."""
        return self.read - self.forward - self.backward

    def _count(self, flank: Flank) -> int:
        return sum(s.stop - s.start for s in self.segments if s.flank == flank)


def find_segments(log: EncoderLog, crossing: float = AFTER_REVERSAL) -> Segments:
    """Divide a log into segments on a certain flank and runs of one motion.

    - At steady speed the direction of motion defines the flank; ramps, dwell and the start of a
      run, over `crossing` rad of the driving shaft, are masked.
    - In a run without steady speed (sine, hand-driven) the samples above 10 % of its top speed are
      used, and a note reports this. So they are in all runs if none is long enough for a steady
      stretch between its ramps.
    - `log.direction` replaces the direction of motion; 0 is masked. The sign of `log.torque`
      replaces it where |torque| is at least 5 % of its 95th percentile, ramps included. If the log
      has both columns, samples where they disagree are masked.
    - Gaps in time (more than 5 usual intervals) and changes of plateau separate segments.
    """
    time = log.time
    angle = log.driving.steady_angle(time)
    cut = np.concatenate([[True], gaps_of(time)])
    speed = log.smooth_speed(angle)
    sense = _sense(speed, angle, cut)
    spans = runs(sense, cut)
    kinds: dict[int, Kind] = {1: "forward", 0: "dwell", -1: "backward"}
    motion = tuple(
        MotionPhase(a, b, kinds[int(sense[a])], _mean_speed(a, b, time, angle)) for a, b in spans
    )
    moving = [(m.start, m.stop) for m in motion if m.kind != "dwell"]
    flank = _flank(log, sense)
    flips = np.flatnonzero(flank)
    flips = flips[1:][np.diff(flank[flips]) != 0].tolist()
    starts = set[int](flips)  # where the flank changes or a run begins
    for start, stop in moving:
        goes_on = start == 0
        if start and cut[start]:
            # In a gap in time, as a logger of changes has it, the shaft stood still if it was
            # slower there than a share of the top speed of the run.
            over = abs(angle[start] - angle[start - 1]) / (time[start] - time[start - 1])
            goes_on = over > RAGGED * float(np.abs(speed.value[start:stop]).max())
        if not goes_on:
            starts.add(start)
    starts = sorted(starts)
    known = (flank != 0) & (sense != 0) & ~_crossing(starts, angle, crossing)
    edges = cut.copy()
    edges[[start for start, _ in spans]] = True

    def segments_of(certain: Bool[np.ndarray, " n"]) -> tuple[Segment, ...]:
        state = np.where(certain & known, flank, 0)
        return tuple(
            Segment(a, b, "A" if state[a] > 0 else "B", _mean_speed(a, b, time, angle))
            for a, b in runs(state, edges)
            if state[a] != 0 and b - a >= SHORTEST
        )

    certain, ragged = _certain(log, angle, speed, moving)
    segments = segments_of(certain)
    if not segments and ragged < len(moving):  # all runs are too short for their ramps
        certain, ragged = _certain(log, angle, speed, moving, steadily=False)
        segments = segments_of(certain)
    notes = []
    if ragged and log.torque is None:
        notes.append(
            f"no steady speed in {ragged} of {len(moving)} runs: everything faster than"
            f" {RAGGED:.0%} of the top speed of a run counts as on its flank"
        )
    used = [name for name in ("direction", "torque") if getattr(log, name) is not None]
    if used:
        notes.append(f"flanks assigned by the {' and the '.join(used)} column")
    return Segments(
        segments, motion, len(log), tuple(notes), crossing=crossing, starts=tuple(starts)
    )


def _sense(
    speed: Speed, angle: Float[np.ndarray, " n"], cut: Bool[np.ndarray, " n"]
) -> Int8[np.ndarray, " n"]:
    """Return the direction of motion per sample: +1, −1, or 0 at standstill.

    A run whose travel is below the noise counts as standstill.
    """
    sense = np.where(np.abs(speed.value) > speed.dwell, np.sign(speed.value), 0).astype(np.int8)
    for start, stop in runs(sense, cut):
        if sense[start] and abs(angle[stop - 1] - angle[start]) < SHORTEST_RUN * speed.quantum:
            sense[start:stop] = 0
    return sense


def _mean_speed(
    start: int, stop: int, time: Float[np.ndarray, " n"], angle: Float[np.ndarray, " n"]
) -> float:
    elapsed = time[stop - 1] - time[start]
    return float((angle[stop - 1] - angle[start]) / elapsed) if elapsed > 0 else 0.0


def _certain(
    log: EncoderLog,
    angle: Float[np.ndarray, " n"],
    speed: Speed,
    moving: list[tuple[int, int]],
    *,
    steadily: bool = True,
) -> tuple[Bool[np.ndarray, " n"], int]:
    """Return the mask of samples fast and steady enough, and the number of runs without plateau.

    `moving` holds the runs as [start, stop). With a torque column all samples are in the mask.
    `steadily`: whether plateaus are searched.
    """
    if log.torque is not None:
        return np.ones(len(log), bool), 0
    certain, ragged = np.zeros(len(log), bool), 0
    for start, stop in moving:
        run, plateaus = np.abs(speed.value[start:stop]), []
        if steadily:
            around = slice(max(start - 1, 0), stop + 1)
            travel = np.abs(np.gradient(angle[around])[start - around.start :][: stop - start])
            plateaus = levels(run, np.maximum(travel, 1e-3 * travel.mean()))
        for level in plateaus:
            unsteady = 3.0 * speed.quantum / (speed.window * log.interval_s * level)
            for a, b in steady(run, level, max(TOLERANCE, unsteady), speed.window):
                certain[start + a : start + b] = True
        if not plateaus:
            ragged += 1
            certain[start:stop] = run > RAGGED * run.max()
    return certain, ragged


def _flank(log: EncoderLog, sense: Int8[np.ndarray, " n"]) -> Int8[np.ndarray, " n"]:
    """Return the flank per sample: +1 for A, −1 for B, 0 if unknown.

    It comes from the direction column and the sign of the torque, or else from `sense` (motion).
    """
    flank = sense if log.direction is None else log.direction
    if log.torque is not None:
        loaded = np.abs(log.torque) >= TORQUE * np.quantile(np.abs(log.torque), 0.95)
        by_torque = np.where(loaded, np.sign(log.torque), 0).astype(np.int8)
        flank = by_torque if log.direction is None else np.where(flank == by_torque, flank, 0)
    return flank.astype(np.int8)


def _crossing(
    starts: list[int], angle: Float[np.ndarray, " n"], travel: float
) -> Bool[np.ndarray, " n"]:
    """Return the mask of the samples within `travel` rad after one of the indices `starts`."""
    masked = np.zeros(len(angle), bool)
    for start, stop in zip(starts, [*starts[1:], len(angle)], strict=False):
        beyond = np.abs(angle[start:stop] - angle[start]) >= travel
        masked[start : start + int(np.argmax(beyond)) if beyond.any() else stop] = True
    return masked


def still_segments(log: EncoderLog) -> Segments:
    """Return the readings of a table as segments, whose flank is that of the approach.

    The first reading, and one behind a way back to the start, was approached as the next one is.
    Of twice as many readings as usual at a place where the motion turns, half belong to each side;
    a column of directions replaces all this.
    """
    stop = stops_of(log)
    kept, angle = stop >= 0, log.driving.angle[stop >= 0]
    sense, how = np.zeros(len(log), np.int64), "that of the approach"
    sense[kept] = _approach(angle)
    if log.direction is not None:
        against = np.count_nonzero(log.direction[1:] * np.diff(log.driving.angle) < 0)
        sense, how = log.direction.astype(np.int64), "that of the direction column"
        sense[~kept] = 0
        said = f", which in {against} rows is not that of the step to their position (--invert"
        how += f"{said} driving --invert driven exchange both directions)" * bool(against)
    count, size = max(map(places, (angle, float(log.ratio) * angle))), len(np.unique(stop[kept]))
    parts = [(a, b, bool(sense[a] > 0)) for a, b in runs(sense) if sense[a]]
    return Segments(
        tuple(Segment(a, b, "A" if up else "B", 0.0) for a, b, up in parts),
        tuple(MotionPhase(a, b, "forward" if up else "backward", 0.0) for a, b, up in parts),
        len(log),
        (
            f"a table of {size} readings at standstill at {count} places: the flank is {how}, and"
            " there is no delay; if the shafts turned while it was recorded, say --running",
        ),
        crossing=0.0,
        still=True,
    )


def stops_of(log: EncoderLog) -> Int[np.ndarray, " n"]:
    """Return the number of the stop to which every sample belongs, −1 for one read in motion.

    Samples of one stop share its approach, so that they are one reading. Without a clock, and where
    most stops have one or two samples, every sample is a reading of its own.
    """
    step = np.diff(log.driving.angle, prepend=log.driving.angle[0])
    number = np.cumsum(np.abs(step) > SAME * usual_step(step))
    size = np.bincount(number)[number]
    usual = float(np.median(size))
    if "time" not in log.place.columns or usual < _SEVERAL:
        return np.arange(len(log))
    return np.where(size >= usual / _SEVERAL, number, -1)


def places(angle: Float[np.ndarray, " n"]) -> int:
    """Return the number of different places in a turn."""
    near = np.sort(np.mod(angle, REV))
    apart = np.diff(near, append=near[:1] + REV)
    return int(np.count_nonzero(apart > min(SAME * usual_step(np.diff(angle)), DEG)))


def _approach(angle: Float[np.ndarray, " n"]) -> Int[np.ndarray, " n"]:
    """Return the direction from which every reading was approached, ±1."""
    step, usual = np.diff(angle), usual_step(np.diff(angle))
    first = np.concatenate([[0], np.flatnonzero(np.abs(step) > SAME * usual) + 1])
    size = np.diff(first, append=len(angle))
    way = np.append(np.sign(np.diff(angle[first])), 0).astype(np.int64)
    far = np.append(np.abs(np.diff(angle[first])), 0.0) > 2 * usual
    sense = np.repeat(way, size)
    for k in range(1, len(first)):
        if not (far[k - 1] and way[k] == -way[k - 1]):
            turns = way[k] == -way[k - 1] and size[k] >= 2 * np.median(size)
            own = size[k] // 2 if turns else size[k]
            sense[first[k] : first[k] + own] = way[k - 1]
    return sense


_SEVERAL = 3
"""Least number of samples of the usual stop of a log that was recorded while shafts were held; in
stops that are so many times shorter the shafts moved (chosen)."""

FULL_TURN = 0.99
"""A shaft that turned at least so many times has a first order; tables end a step before a turn."""


@dataclass(frozen=True)
class Support:
    """Turns of each shaft over the samples whose flank is certain, and conclusions as sentences.

    `driving_resolved` and `driven_resolved` say whether the first order of the shaft can be
    determined and separated from that of the other shaft. `flanks` holds the flanks that have
    samples, "A" and "B".
    """

    driving_turns: float
    driven_turns: float
    driving_resolved: bool
    driven_resolved: bool
    flanks: tuple[str, ...]
    sentences: tuple[str, ...]


def support_of(log: EncoderLog, segments: Sequence[Segment]) -> Support:
    """Return the turns of both shafts over the segments, and what a fit can determine from them.

    The first order of a shaft needs one turn of this shaft. Both first orders are separable
    only after 1/|1 − i| driving turns (one beat period, i = ratio); with i = 1 they never are.
    """
    driving, driven = (turns_of(angle, segments) for angle in (log.driving_angle, log.driven_angle))
    beat = 1 / abs(1 - log.ratio) if log.ratio != 1 else None
    separable = beat is not None and driving >= beat
    flanks = tuple(sorted({segment.flank for segment in segments}))
    sentences = []
    if not segments:
        sentences.append("no sample lies on a certain flank, so nothing can be fitted")
    elif beat is None:
        sentences.append(
            "with ratio 1 both shafts share order 1: their eccentricities cannot be told apart"
        )
    elif not separable:
        sentences.append(
            f"the driving shaft turns {driving:.3g} times; under {float(beat):.3g} turns neither"
            " shaft's eccentricity can be told from the other's"
        )
    for name, turns in (("driving", driving), ("driven", driven)):
        if segments and turns < FULL_TURN:
            sentences.append(
                f"the {name} shaft turns only {turns:.3g} times, so its first order cannot be"
                " determined"
            )
    if len(flanks) == 1:
        sentences.append(
            f"one direction only (flank {flanks[0]}): no backlash, and eccentricities only if the"
            " encoders are perfect"
        )
    resolved = separable and driving >= FULL_TURN, separable and driven >= FULL_TURN
    return Support(driving, driven, *resolved, flanks, tuple(sentences))


HIGHEST, _MOST = 8, 2000  # orders of a shaft, and angles, that are looked at (chosen)
CLEAR = 0.1
"""Least share of an order that no other order imitates over the angles of a log; without it its
variance would be ten times as large (chosen)."""


def told_orders(
    angle: Float[np.ndarray, " n"], orders: Sequence[float], likely: int = 0
) -> list[bool]:
    """Return which orders the places of a table tell from a level and from the orders before them.

    At n places 360°/n apart the orders k and n − k have the same values, and of n/2 one part is
    seen only. Half of the readings are left for the noise.

    **Arguments**
    - `angle`: angles in rad. - `orders`: in cycles per turn, the likelier ones first.
    - `likely`: number of orders that are there for certain, and would be taken for the orders that
      look like them. Each is told whose two parts differ from a level, however little.

    **Example**
    ```python
    >>> import numpy as np
    >>> from vttig_jax.logs.motion.segments import told_orders
    >>> places = np.radians(np.arange(0.0, 360.0, 60.0))
    >>> [told_orders(np.tile(places, times), [1, 2, 3, 4]) for times in (1, 4)]
    [[True, False, False, False], [True, True, False, False]]
    >>> told_orders(np.tile(places, 4), [5, 1])  # 5 looks like 1
    [True, False]

    ```
    """
    basis, told = np.full((1, len(angle)), len(angle) ** -0.5), [False] * len(orders)
    for place, order in enumerate(orders):
        own = np.stack([np.cos(order * angle), np.sin(order * angle)])
        beside, new = (own - own @ known.T @ known for known in (basis[:1], basis))
        share, part = (CLEAR**3, beside) if place < likely else (CLEAR, new)
        # The last factor is the part of the second column that the first one does not have.
        clear = np.diag(np.linalg.qr(part.T)[1]) ** 2 >= share * len(angle) / 2
        told[place] = bool(len(basis) + 2 <= len(angle) / 2 and clear.all())
        if told[place] or place < likely:  # what is there is not taken for an order that is not
            factor = np.linalg.qr(new.T)
            seen = np.diag(factor[1]) ** 2 > 1e-9 * len(angle)
            basis = np.concatenate([basis, factor[0].T[seen]])
    return told


def tells_first_order(
    angle: Float[np.ndarray, " n"], orders: Sequence[float] | Float[np.ndarray, " k"]
) -> bool:
    """Return whether angles of a shaft tell its first order from a level and other orders.

    A log over a whole turn does, and so do n places 360°/n apart.

    **Arguments**
    - `angle`: angles in rad. - `orders`: orders of the model, in cycles per turn of this shaft.

    **Example**
    ```python
    >>> import numpy as np
    >>> from vttig_jax.logs.motion.segments import tells_first_order
    >>> places = np.radians(np.arange(0.0, 360.0, 30.0))
    >>> [tells_first_order(places[:count], [1, 2, 3]) for count in (12, 8)]
    [True, False]

    ```
    """
    phase = np.outer(orders, angle)
    own = np.repeat(np.isclose(orders, 1), 2)
    columns = np.concatenate([np.ones((1, len(angle))), np.cos(phase), np.sin(phase)])
    columns /= np.maximum(np.linalg.norm(columns, axis=1, keepdims=True), 1e-300)
    gram = columns @ columns.T + 1e-9 * np.eye(len(columns))
    share = 1 / np.diag(np.linalg.inv(gram))[1:].reshape(2, -1).T.ravel()
    return bool(own.any() and share[own].min() >= CLEAR)


def groups_of_speed(segments: Sequence[Segment], tolerance: float) -> list[int]:
    """Return a number for each segment, equal for segments of one flank and nearly one speed.

    The speed differs from that of the first segment of its group by at most the share `tolerance`.
    """
    firsts: list[Segment] = []
    numbers = []
    for one in segments:
        alike = (
            number
            for number, first in enumerate(firsts)
            if first.flank == one.flank
            and abs(one.speed - first.speed) <= tolerance * abs(first.speed)
        )
        numbers.append(next(alike, len(firsts)))
        firsts += [one] * (numbers[-1] == len(firsts))
    return numbers


def turns_of(angle: Float[np.ndarray, " n"], segments: Sequence[Segment]) -> float:
    """Return the turns of a shaft over segments; a part that tells its orders counts as one."""
    ends = [angle[k] for s in segments for k in (s.start, s.stop - 1)]
    turns = float(max(ends) - min(ends)) / REV if ends else 0.0
    if not 0 < turns < 1:
        return turns
    rows = np.concatenate([angle[s.start : s.stop] for s in segments])
    rows = rows[:: -(-len(rows) // _MOST)]
    return 1.0 if tells_first_order(rows, np.arange(1.0, HIGHEST + 1)) else turns
