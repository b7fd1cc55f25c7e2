"""Flank of each segment, by torque or motion, and the ramps in which no flank is certain.

The sign of the transmitted torque defines the loaded flank. However, the torque of a motor also
accelerates its rotor and overcomes friction, and in a drive without backlash it says nothing about
flanks. Therefore torque and direction of motion are both tested in a linear model with a step of
the transmission error between the flanks, on up to 1000 samples; the torque is used if it fits
better.

**The gap after a reversal.** At one speed a gap and a delay of the driven channel leave the same
step between the flanks. They differ after a reversal: the driven shaft stands still until the
driving shaft has turned by the gap divided by the ratio, while the step of a delay follows the
speed. Let s be the travel of the driving shaft since the reversal, i the ratio and g the gap. The
transmission error then contains

    g · min(i s / g, 1) on the way to flank B,  g · (1 − min(i s / g, 1)) on the way to flank A.

g has the least sum of squares beside a delay. It is a gap if the likelihood is enough larger than
that of a delay alone.

**An overrunning load.** Friction slows a free load by a limited deceleration. If the drive brakes
harder, the load leaves flank A of a forward motion and lies on flank B until the drive brakes less.
The limit is unknown. It is found by a search for the least sum of squares. The flanks by this limit
are used if the likelihood improves enough and the estimated gap is positive.
"""

from bisect import bisect_right
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int

from ...base.numerics.student_noise import fit_student_noise
from ...base.numerics.well_conditioned import least_squares, orthonormal_basis
from ...base.units import DEG, REV
from ..channel.speed import Speed, is_at_standstill
from ..encoder_log import EncoderLog
from .segments import (
    AFTER_REVERSAL,
    Segment,
    Segments,
    find_segments,
    still_segments,
)

EVIDENCE = 50.0
"""Least likelihood ratio 2 Δ ln L by which one model of the flanks must beat another (chosen)."""

LEAST = 100
"""Least number of samples of a comparison (chosen)."""

_MOST = 1000  # largest number of samples that are compared (chosen)


def seen_gap(log: EncoderLog, by_motion: Segments, *, delayed: bool = True) -> float:
    """Return the step of the transmission error from flank A to B in rad, or 0 without evidence.

    **Arguments**
    - `by_motion`: segments with flanks by the direction of motion.
    - `delayed`: whether the channels may have a delay. At one speed a delay explains any step.
    """
    sense, rows = flank_rows(log, by_motion)
    if len(rows) < LEAST or len(np.unique(sense[rows])) < 2:
        return 0.0
    speed = log.driving_speed.value[rows] if delayed else np.zeros(len(rows))
    columns, error = columns_of(log, rows, speed), log.transmission_error[rows]
    without = error - columns @ least_squares(columns, error, 1e-9)
    least, gap = squares_with_step(error, columns, sense[rows])
    evidence = len(rows) * np.log(max(float(without @ without), 1e-300) / max(least, 1e-300))
    return max(gap, 0.0) if evidence >= EVIDENCE else 0.0


def flank_rows(
    log: EncoderLog, segments: Segments
) -> tuple[Int[np.ndarray, " n"], Int[np.ndarray, " m"]]:
    """Return the flank of every sample, and the indices of samples for a comparison.

    The flank is +1 on A, −1 on B and 0 elsewhere. The indices are evenly spaced among the samples
    on a flank that are no spikes.
    """
    sense = np.zeros(len(log), np.int8)
    for segment in segments.segments:
        sense[segment.start : segment.stop] = 1 if segment.flank == "A" else -1
    rows = np.flatnonzero((sense != 0) & ~log.spikes)
    return sense, rows[:: max(1, -(-len(rows) // _MOST))].copy()


def columns_of(
    log: EncoderLog, rows: Int[np.ndarray, " m"], speed: Float[np.ndarray, " m"]
) -> Float[np.ndarray, "m p"]:
    """Return a design matrix at the samples `rows`, one row per sample.

    Its columns are an offset, the scaled speed, and cosine and sine of the angle of each shaft that
    covers at least one turn.
    """
    columns = [np.ones(len(rows)), speed / max(float(np.abs(speed).max()), 1e-300)]
    for angle in (log.driving_angle[rows], log.driven_angle[rows]):
        columns += [np.cos(angle), np.sin(angle)] if np.ptp(angle) >= REV else []
    return np.stack(columns, axis=1)


def squares_with_step(
    error: Float[np.ndarray, " m"], columns: Float[np.ndarray, "m p"], flank: Int[np.ndarray, " m"]
) -> tuple[float, float]:
    """Fit the transmission error `error` (rad) by `columns` and a step from flank A to flank B.

    Return the residual sum of squares in rad² and the step in rad.
    """
    design = np.column_stack([columns, (flank < 0).astype(np.float64)])
    solution = least_squares(design, error, 1e-9)
    return float(np.sum((error - design @ solution) ** 2)), float(solution[-1])


_MOST_CROSSED = 2000  # largest number of samples that are compared (chosen)
_TRIALS = 60  # number of trial values of the gap, at equal ratios (chosen)
_SHARES = 0.5, 0.9
"""Longest crossing, as a share of the median travel between two reversals; the second share is for
strokes of less than `_SHORT_STROKE`, rad, in which no gap is seen below the first (all chosen)."""

_SHORT_STROKE = 2 * REV


def crossed_gap(log: EncoderLog, by_motion: Segments) -> float:
    """Return the gap in rad of the driven shaft by its crossings, or 0 without evidence for one.

    It is also 0 if no crossing is longer than `AFTER_REVERSAL`, which is always masked.

    Before the first reversal the place of the teeth is unknown, so that the first part of this
    travel is left out.

    **Arguments**
    - `by_motion`: segments with flanks by the direction of motion.
    """
    moving = [phase for phase in by_motion.motion if phase.kind != "dwell"]
    turns = [k for k in range(1, len(moving)) if moving[k].kind != moving[k - 1].kind]
    if not turns:
        return 0.0
    angle = log.driving_angle
    start, stop = np.array([(phase.start, phase.stop) for phase in moving]).T
    before = np.concatenate([[0], np.cumsum(stop - start)])
    place = np.arange(0, before[-1], max(1, -(-int(before[-1]) // _MOST_CROSSED)))
    phase = np.searchsorted(before, place, side="right") - 1
    rows = start[phase] + place - before[phase]  # evenly spaced samples in motion
    leg = np.searchsorted(turns, phase, side="right")  # motion between two reversals, from 0
    sense = np.array([1 if one.kind == "forward" else -1 for one in moving])[phase]
    origin = angle[[moving[0].start, *(moving[k].start for k in turns)]]
    travel = np.abs(angle[rows] - origin[leg])
    stroke = float(np.median(np.abs(np.diff([*origin, angle[moving[-1].stop - 1]]))))
    shares = _SHARES if stroke < _SHORT_STROKE else _SHARES[:1]
    ratio, gap = float(log.ratio), 0.0
    for longest in (share * stroke for share in shares):
        gap = 0.0
        # The place of the teeth is known after a reversal or after the longest crossing.
        known = ~log.spikes[rows] & ((leg > 0) | (travel > longest))
        used, way = rows[known], sense[known]
        if len(used) < LEAST or longest <= AFTER_REVERSAL or len(np.unique(way)) < 2:
            continue
        basis = orthonormal_basis(columns_of(log, used, log.driving_speed.value[used]), 1e-9)
        error = log.transmission_error[used] - np.mean(log.transmission_error[used])
        # The first trial value is no gap.
        gaps = ratio * np.append(0.0, np.geomspace(AFTER_REVERSAL, longest, _TRIALS))[:, None]
        left = np.minimum(ratio * travel[known], gaps)
        rest = error - np.where(way > 0, gaps - left, left)
        rest -= (rest @ basis) @ basis.T
        squares = np.maximum(np.einsum("gm,gm->g", rest, rest), 1e-300)
        best = 1 + int(np.argmin(squares[1:]))
        if best > 1 and len(used) * np.log(squares[0] / squares[best]) >= EVIDENCE:
            gap = float(gaps[best, 0])
        if 0 < gap < longest * ratio:
            break  # a longer crossing would be seen at the limit
    return gap


_QUANTILES = (0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.95)
"""First trial values of the limit, as quantiles of the positive decelerations (chosen)."""

_FINE = 0.05
"""Largest quantisation of the deceleration, relative to its 90 % quantile (chosen)."""

_MOST_DIFFERENCED = 5000  # largest number of samples to choose the differencing interval (chosen)
_ROUNDS = 3  # number of bisections of the limit, and of iterations of the gap (chosen)
_FACTORS = (3.0, 1.7, 1.3, 1.15, 1.07, 1.03)
"""Factors by which the final search multiplies and divides the limit (chosen)."""


def overrunning_segments(log: EncoderLog, by_motion: Segments) -> Segments | None:
    """Return segments with the flanks of a load that overruns, or None without evidence for it.

    **Arguments**
    - `by_motion`: segments with flanks by the direction of motion. The travel that they mask after
      a change of flank is masked in the result, too.
    """
    speed = log.driving_speed
    sense, rows = flank_rows(log, by_motion)
    half = _half_interval(log, speed)
    seen = _braking(log, speed, half, rows)
    braked = seen > 0
    if len(rows) < LEAST or braked.sum() < LEAST / 4:
        return None
    columns = columns_of(log, rows, speed.value[rows])
    error = log.transmission_error[rows]

    def fit(limit: float) -> tuple[float, float]:
        """Return the sum of squares and the gap if the load overruns beyond a limit in rad/s²."""
        flank = np.where(seen > limit, -sense[rows], sense[rows])
        return squares_with_step(error, columns, flank)

    fits = {limit: fit(limit) for limit in np.quantile(seen[braked], _QUANTILES).tolist()}
    for _ in range(_ROUNDS):  # halves the distances of the best limit from its neighbours
        limits = sorted(fits)
        best = min(fits, key=fits.__getitem__)
        place = limits.index(best)
        for other in limits[max(place - 1, 0) : place] + limits[place + 1 : place + 2]:
            middle = 0.5 * (best + other)
            fits[middle] = fit(middle)
    limit = min(fits, key=fits.__getitem__)
    (least, gap), usual = fits[limit], fit(np.inf)[0]
    if gap <= 0 or len(rows) * np.log(usual / max(least, 1e-300)) < EVIDENCE:
        return None
    motion = np.sign(speed.value).astype(np.int8)
    braking = _braking(log, speed, half, np.arange(len(log)))
    tried: dict[float, tuple[float, np.ndarray]] = {}  # limit → sum of squares, place in the gap
    for factor in _FACTORS:
        best = min(tried, key=lambda one: tried[one][0], default=limit)
        for trial in (one for one in (best, best * factor, best / factor) if one not in tried):
            width = gap
            for _ in range(_ROUNDS):
                place = _place(log, motion, braking - trial, max(width, 1e-6) / float(log.ratio))
                design = np.column_stack([columns, place[rows]])
                solution = np.linalg.lstsq(design, error, rcond=1e-9)[0]
                tried[trial] = float(np.sum((error - design @ solution) ** 2)), place
                width = float(solution[-1])
    limit = min(tried, key=lambda one: tried[one][0])
    place = tried[limit][1]
    found = [
        fit_student_noise(error, np.column_stack([columns, each])).log_likelihood
        for each in (place[rows], (sense[rows] < 0).astype(np.float64))
    ]
    if 2 * (found[0] - found[1]) < EVIDENCE:
        return None
    flank = np.where(place == 0, 1, np.where(place == 1, -1, 0)).astype(np.int8)
    assigned = find_segments(replace(log, direction=flank), by_motion.crossing)
    note = (
        f"the load overruns: while the drive brakes by more than {limit:.3g} rad/s², the contact is"
        " on the other flank"
    )
    return replace(assigned, notes=(*by_motion.notes, note))


def _half_interval(log: EncoderLog, speed: Speed) -> int:
    """Return half of the interval over which speed differences are taken, in samples.

    A speed difference gives the deceleration. The interval is so long that the quantisation of the
    deceleration is small. This is tested at evenly spaced samples.
    """
    interval = log.interval_s
    quantum = speed.quantum / (speed.window * interval)
    rows = np.arange(0, len(log), -(-len(log) // _MOST_DIFFERENCED))
    half = max(speed.window // 2, 1)
    while True:
        usual = float(np.quantile(np.abs(_braking(log, speed, half, rows)), 0.9))
        if quantum <= _FINE * usual * 2 * half * interval or half > len(log) // 50:
            return half
        half *= 2


def _braking(
    log: EncoderLog, speed: Speed, half: int, rows: Int[np.ndarray, " m"]
) -> Float[np.ndarray, " m"]:
    """Return the deceleration of the driving shaft in rad/s² at the samples `rows`.

    It is positive while the shaft slows down. `half` is half the differencing interval in samples.
    """
    low, high = np.maximum(rows - half, 0), np.minimum(rows + half, len(log) - 1)
    elapsed = np.maximum(log.time[high] - log.time[low], 1e-300)
    return -np.sign(speed.value[rows]) * (speed.value[high] - speed.value[low]) / elapsed


def _place(
    log: EncoderLog, motion: Int[np.ndarray, " n"], excess: Float[np.ndarray, " n"], gap: float
) -> Float[np.ndarray, " n"]:
    """Return the place of the load in the gap at every sample: 0 on flank A, 1 on flank B.

    The load runs ahead of the drive by x with ẍ = `excess` (braking beyond the limit, rad/s²) and
    0 ≤ x ≤ `gap`, in rad of the driving shaft. At x = 0 the load lies on the flank of the motion,
    and at x = `gap` on the other flank. A reversal (change of `motion`) resets x to 0.
    """
    ahead, x, rate = np.zeros(len(log)), 0.0, 0.0
    steps = np.diff(log.time, prepend=log.time[0]).tolist()
    turned = np.diff(motion, prepend=motion[0]) != 0
    for k, (push, step, new) in enumerate(
        zip(excess.tolist(), steps, turned.tolist(), strict=True)
    ):
        if new:
            x = rate = 0.0
        rate += push * step
        x += rate * step
        if not 0 < x < gap:
            x, rate = (0.0, 0.0) if x <= 0 else (gap, 0.0)
        ahead[k] = x
    share = ahead / gap
    return np.where(motion >= 0, share, 1 - share)


_BETTER = 0.5
"""The torque is used if the residual sum of squares with its flanks is below this fraction of that
with the flanks of the motion (chosen)."""

_GAPS = (2.0, 1.5, 1.2)
"""Travel after a reversal that is masked, as a multiple of the mean gap (chosen). It exceeds 1
because the gap varies along the teeth. The smaller numbers are for strokes that are too short for
the larger ones."""

_LEAST_GAPS = 1.1
"""Travel that is masked in strokes that are too short for all of `_GAPS`, as a multiple of the gap
(chosen). It exceeds 1 because the crossing is found among trial values."""

_WIDER = 1.05
"""The travel that is masked is widened only by more than this factor (chosen)."""

_DISAGREEING = 0.01
_MOST_SAMPLES = 20_000
"""Torque and motion are compared if their flanks differ at least at this fraction of samples. The
comparison uses at most about `_MOST_SAMPLES` samples (both chosen)."""


def assigned_segments(log: EncoderLog, *, still: bool | None = None) -> Segments:
    """Return segments whose flanks come from the direction column, the torque or the motion.

    The direction column has priority; the torque must fit better than the motion. A note names the
    choice. `still`: whether the log is a table of readings at standstill; by default the log says.
    """
    steps, clock = np.diff(log.driving.angle), "time" in log.place.columns
    if is_at_standstill(steps, log.time, clock=clock) if still is None else still:
        return still_segments(log)
    by_torque = find_segments(log)
    if log.direction is not None:
        return by_torque
    if log.torque is None:
        return _by_motion(log, by_torque)
    by_motion = find_segments(replace(log, torque=None))
    if not by_motion.segments or _torque_fits_better(log, by_torque, by_motion):
        return by_torque
    note = (
        "flanks assigned by the motion: the sign of the torque column does not tell them better,"
        " so the column is only a regressor"
    )
    return replace(by_motion, notes=(*by_motion.notes, note))


def _by_motion(log: EncoderLog, found: Segments) -> Segments:
    """Return segments with flanks by the direction of motion, or those of an overrunning load.

    `found` holds segments by the motion. The start of each run is masked until the driving shaft
    has crossed the gap that the log shows.
    """
    crossed = crossed_gap(log, found)
    plain, found = found, _beyond(log, found, max(crossed, seen_gap(log, found)))
    if crossed > 0.0 and found is plain and float(log.ratio) * plain.crossing < crossed:
        crossing = crossed / float(log.ratio)
        few = find_segments(log, _LEAST_GAPS * crossing)
        unclear = (
            f"the teeth need {crossing / DEG:.2g}° of the driving shaft to cross the gap after a"
            " reversal, and on a flank all strokes are too short to show it behind the crossing;"
            " log longer strokes"
        )
        return replace(few, notes=(*few.notes, unclear), unclear=unclear)
    if crossed > 0.0 and found is not plain:
        # The crossings show that the step is no delay, so that behind them it is the gap.
        gap = seen_gap(log, found, delayed=False)
        found = _beyond(log, plain, gap) if gap > 0.0 else found
        found = _beyond(log, found, seen_gap(log, found, delayed=False))
    if found.crossing > AFTER_REVERSAL:
        note = (
            f"the first {found.crossing / DEG:.2g}° of the driving shaft after a reversal are left"
            " out, because the teeth cross the gap there"
        )
        found = replace(found, notes=(*found.notes, note))
    return overrunning_segments(log, found) or found


def _beyond(log: EncoderLog, found: Segments, gap: float) -> Segments:
    """Return `found` with up to `_GAPS` times the gap left out after reversals, if this is more.

    A flank is not given up: if the runs on it are shorter, `found` stays as it is.
    """
    for gaps in _GAPS:
        crossing = gaps * gap / float(log.ratio)
        if crossing <= _WIDER * found.crossing:
            break
        beyond = find_segments(log, crossing)
        flanks = [{segment.flank for segment in one.segments} for one in (beyond, found)]
        if flanks[0] == flanks[1]:
            return beyond
    return found


def _torque_fits_better(log: EncoderLog, by_torque: Segments, by_motion: Segments) -> bool:
    """Return whether flanks by the torque explain the transmission error better than by the motion.

    Both linear models have an offset, speed, torque, first orders, and a backlash ≥ 0 between the
    flanks. If both assignments nearly agree, return True.
    """
    assert log.torque is not None  # checked by the caller
    torque, motion = (flank_rows(log, one)[0] for one in (by_torque, by_motion))
    both = np.flatnonzero((torque != 0) & (motion != 0))
    if np.mean(torque[both] != motion[both]) < _DISAGREEING:
        return True
    rows = both[:: max(1, len(both) // _MOST_SAMPLES)]
    columns = columns_of(log, rows, log.driving_speed.value[rows])
    columns = np.column_stack([columns, log.torque[rows]])
    error = log.transmission_error[rows] - np.mean(log.transmission_error[rows])
    misfits = []
    for flank in (torque[rows], motion[rows]):
        squares, step = squares_with_step(error, columns, flank)
        if step < 0:
            squares = squares_with_step(error, columns, np.zeros_like(flank))[0]
        misfits.append(squares)
    return misfits[0] < _BETTER * misfits[1]


@dataclass(frozen=True)
class Ramp:
    """Samples of a run before or after its steady speed, with the flank by the direction of motion.

    While the driving shaft accelerates its load (`speeding_up`), the flank is nearly certain. While
    it slows down, the inertia of the driven side may move the contact to the other flank.
    """

    segment: Segment
    speeding_up: bool


def find_ramps(log: EncoderLog, segments: Segments) -> tuple[Ramp, ...]:
    """Return the ramps before and after the segments of every run, without crossings of the gap.

    If a torque or direction column of the log defines the flank, no ramps are returned.
    """
    if log.torque is not None or log.direction is not None:
        return ()
    ramps = []
    for run in segments.motion:
        inside = [s for s in segments.segments if run.start <= s.start and s.stop <= run.stop]
        if run.kind == "dwell" or not inside:
            continue
        first, last = inside[0], inside[-1]
        begun = bisect_right(segments.starts, run.start) - 1
        origin = log.driving_angle[segments.starts[begun] if begun >= 0 else run.start]
        crossed = np.abs(log.driving_angle[run.start : first.start] - origin) >= segments.crossing
        begin = run.start + int(np.argmax(crossed)) if crossed.any() else first.start
        for start, stop, up in ((begin, first.start, True), (last.stop, run.stop, False)):
            if stop > start:
                ramps.append(Ramp(Segment(start, stop, first.flank, first.speed), up))
    return tuple(ramps)
