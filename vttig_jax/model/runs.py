"""Runs of a log with a known flank, and ramps whose flank the fit decides."""

from itertools import pairwise

import numpy as np
from jaxtyping import Float
from scipy.ndimage import uniform_filter1d

from ..base.units import ARCSEC, REV
from ..logs.channel.unwrap import step_of
from ..logs.checks.sampling import MODELLED, MOST_SAMPLES, commensurate
from ..logs.encoder_log import EncoderLog
from ..logs.motion.flank_assignment import find_ramps
from ..logs.motion.segments import FULL_TURN, Segments, places, stops_of
from .rows import Run, S, Shafts, merged

_TORQUE_S = 0.1
"""Time over which torque is averaged: its noise would make the coefficient too small."""

_ENOUGH = 20_000
"""Number of samples from which slope and level of a log are seen (chosen)."""

_TWICE = 1.8
"""Readings at a place of a table, on average, above which they tell a drift (chosen)."""

_LEAST = 16
"""Fewest samples of a ramp: the smoothed speed does not follow shorter ones."""


def shafts_of(log: EncoderLog, segments: Segments, *, planned: bool = False) -> Shafts:
    """Return a log as the model sees it.

    The runs are the segments and the ramps on which a shaft speeds up: its load presses on the
    flank of its motion. On ramps that slow down, and between two speeds, the driven shaft may
    overrun; they are `ramps`, of which the fit keeps those that stay on their flank. Ramps tell the
    delay from the gap. A `planned` log has ideal speeds, which no machine holds so exactly that all
    its counts are locked to the clock.
    """
    if segments.still:
        return _still(log, segments)
    runs = [Run(s.start, s.stop, s.flank) for s in segments.segments]
    slowing: list[Run] = []
    blurred = log.driving_speed.window // 2  # there the smoothed speed spans the standstill
    locked = commensurate(log, segments.segments, MODELLED if planned else MOST_SAMPLES)
    offsets = [(a, b, std * ARCSEC) for one in locked for a, b, std in one.offsets if not planned]
    # The rounding of a ramp is noise, which runs of one rounding error each do not have.
    free = sum(run.stop - run.start for run in runs) > 2 * sum(b - a for a, b, _ in offsets)
    for ramp in find_ramps(log, segments) if free else ():
        start, stop = ramp.segment.start, ramp.segment.stop
        start, stop = (start + blurred, stop) if ramp.speeding_up else (start, stop - blurred)
        if stop - start >= _LEAST:
            chosen = runs if ramp.speeding_up else slowing
            chosen.append(Run(start, stop, ramp.segment.flank))
    for first, second in pairwise(segments.segments):
        between = slice(first.stop, second.start)
        same = first.flank == second.flank and first.speed * second.speed > 0
        inside = any(m.start <= first.start and second.stop <= m.stop for m in segments.motion)
        if same and inside and between.stop - between.start > 0:
            slowing.append(Run(between.start, between.stop, first.flank))
    last = {one.shaft: one.rounding_arcsec for one in locked}
    rounding = float(np.linalg.norm([*last.values()]) * ARCSEC)
    driving, ratio = log.driving.steady_angle(log.time), float(log.ratio)  # without spikes
    error = log.transmission_error
    if driving is not log.driving_angle:
        error = error + ratio * (log.driving_angle - driving)
    if log.driven is not None:
        error = error + (log.driven.steady_angle(log.time) - log.driven_angle)
    speed, torque = log.smooth_speed(driving).value, log.torque
    if torque is not None:
        window = max(1, round(_TORQUE_S / log.interval_s))
        torque = uniform_filter1d(torque, window, mode="nearest")
    found = Shafts(
        time=log.time,
        driving=driving,
        error=error,
        speed=speed,
        steady=speed,
        ratio=ratio,
        interval_s=log.interval_s,
        runs=merged(runs),
        ramps=tuple(sorted(slowing)),
        nominal=_nominal(driving, error, ratio, FULL_TURN),
        resolution=log.driving.resolution,
        torque=torque,
        axial_mm=log.axial_mm,
        rounding=rounding,
        offsets=tuple(offsets),
    )
    return found.steadied(driving, (*runs, *slowing))


def _nominal(
    driving: Float[np.ndarray, " n"], error: Float[np.ndarray, " n"], ratio: float, least: float
) -> tuple[float, float]:
    """Return slope and level of the driven over the driving angle.

    Over few turns a first order has a slope of its own, which is no error of the ratio: orders of
    the driven shaft are beside them if it turned at least `least` times.
    """
    thin = slice(None, None, 1 + len(driving) // _ENOUGH)
    angle = driving[thin]
    orders = np.arange(1, 5) if np.ptp(ratio * angle) >= least * REV else np.arange(0)
    phase = np.outer(ratio * angle, orders)
    columns = np.column_stack([angle, np.ones(len(angle)), np.cos(phase), np.sin(phase)])
    slope, level = np.linalg.lstsq(columns, error[thin], rcond=1e-6)[0][:2]
    return ratio + float(slope), float(level)


def _still(log: EncoderLog, segments: Segments) -> Shafts:
    """Return a table of readings at standstill, with all those of a flank in one run.

    They have no speed, and no noise that goes on from one to the next. The samples of a stop are
    one reading, their mean.
    """
    stop, runs, ends, index = stops_of(log), [], [0], [np.arange(0)]
    for flank in S:
        own = [np.arange(s.start, s.stop) for s in segments.segments if s.flank == flank]
        index += own
        ends.append(ends[-1] + len(np.unique(stop[np.concatenate([np.arange(0), *own])])))
        if ends[-1] > ends[-2]:
            runs.append(Run(ends[-2], ends[-1], flank))
    order = np.concatenate(index)
    first = np.flatnonzero(np.diff(stop[order], prepend=-1))
    size = np.diff(first, append=len(order))
    mean = lambda values: np.add.reduceat(values[order], first) / size  # noqa: E731
    driving, error = mean(log.driving_angle), mean(log.transmission_error)
    ratio, speed = float(log.ratio), np.zeros(len(first))
    # Readings that repeat at n places have one rounding, 2/n of its variance at every harmonic, of
    # which a ratio that is free lets as little as a third be seen.
    count = max(map(places, (driving, ratio * driving)))
    most = max((run.stop - run.start for run in runs), default=0)
    step = step_of(error) if log.driven is None else log.driven.resolution
    # Errors that are small beside a step come from places at whole steps, and not from rounding.
    step *= float(np.ptp(error)) > 0.1 * step
    return Shafts(
        time=mean(log.time),
        driving=driving,
        error=error,
        speed=speed,
        steady=speed,
        ratio=ratio,
        interval_s=log.interval_s,
        runs=tuple(runs),
        ramps=(),
        nominal=_nominal(driving, error, ratio, 0.0),
        resolution=log.driving.resolution,
        torque=None if log.torque is None else mean(log.torque),
        axial_mm=None if log.axial_mm is None else mean(log.axial_mm),
        still=True,
        tells_drift=len(first) >= _TWICE * count,
        rounding=step / (2 * count) ** 0.5 if most > 1.5 * count else 0.0,
    )
