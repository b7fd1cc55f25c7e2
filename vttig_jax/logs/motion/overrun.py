"""Flank of an overrunning load: its inertia carries it to the other flank while the drive brakes.

Friction slows a free load by a limited deceleration. If the drive brakes harder, the load leaves
flank A of a forward motion and lies on flank B until the drive brakes less. The limit is unknown.
It is found by a search for the least sum of squares. The flanks by this limit are used if the
likelihood improves enough and the estimated gap is positive.
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float, Int

from ...base.numerics.student_noise import fit_student_noise
from ..channel.speed import Speed
from ..encoder_log import EncoderLog
from .flank_step import EVIDENCE, LEAST, columns_of, flank_rows, squares_with_step
from .segments import AFTER_REVERSAL, Segments, find_segments

_SHARES = (0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.95)
"""First trial values of the limit, as quantiles of the positive decelerations (chosen)."""

_FINE = 0.05
"""Largest quantisation of the deceleration, relative to its 90 % quantile (chosen)."""

_MOST_SAMPLES = 5000  # largest number of samples to choose the differencing interval (chosen)
_ROUNDS = 3  # number of bisections of the limit, and of iterations of the gap (chosen)
_FACTORS = (3.0, 1.7, 1.3, 1.15, 1.07, 1.03)
"""Factors by which the final search multiplies and divides the limit (chosen)."""


def overrunning_segments(
    log: EncoderLog, by_motion: Segments, crossing: float = AFTER_REVERSAL
) -> Segments | None:
    """Return segments with the flanks of a load that overruns, or None without evidence for it.

    **Arguments**
    - `by_motion`: segments with flanks by the direction of motion.
    - `crossing`: travel in rad of the driving shaft that is masked after a change of flank.
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
    usual = squares_with_step(error, columns, sense[rows])[0]
    limits = list(np.quantile(seen[braked], _SHARES))
    limit, least, gap = _best_limit(error, columns, sense[rows], seen, limits)
    if gap <= 0 or len(rows) * np.log(usual / max(least, 1e-300)) < EVIDENCE:
        return None
    motion = np.sign(speed.value).astype(np.int8)
    braking = _braking(log, speed, half, np.arange(len(log)))
    limit, place = _profiled(
        log, motion=motion, braking=braking, limit=limit, gap=gap, rows=rows, columns=columns
    )
    found = [
        fit_student_noise(error, np.column_stack([columns, each])).log_likelihood
        for each in (place[rows], (sense[rows] < 0).astype(np.float64))
    ]
    if 2 * (found[0] - found[1]) < EVIDENCE:
        return None
    flank = np.where(place == 0, 1, np.where(place == 1, -1, 0)).astype(np.int8)
    assigned = find_segments(replace(log, direction=flank), crossing)
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
    rows = np.arange(0, len(log), -(-len(log) // _MOST_SAMPLES))
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


def _profiled(
    log: EncoderLog,
    motion: Int[np.ndarray, " n"],
    braking: Float[np.ndarray, " n"],
    limit: float,
    gap: float,
    rows: Int[np.ndarray, " m"],
    columns: Float[np.ndarray, "m p"],
) -> tuple[float, Float[np.ndarray, " n"]]:
    """Return the limit in rad/s² with the least sum of squares, and the load's place in the gap.

    The place is given at every sample: 0 on flank A, 1 on flank B.

    **Arguments**
    - `motion`: sign of the speed. `braking`: deceleration of the driving shaft, rad/s².
    - `limit`, `gap`: first estimates, rad/s² of the driving shaft and rad of the driven shaft.
    - `rows`, `columns`: samples of the comparison and their design matrix.
    """
    error, ratio = log.transmission_error[rows], float(log.ratio)
    found: dict[float, tuple[float, float, np.ndarray]] = {}

    def tried(trial: float) -> float:
        width = gap
        for _ in range(_ROUNDS):
            place = _place(log, motion, braking - trial, max(width, 1e-6) / ratio)
            design = np.column_stack([columns, place[rows]])
            solution = np.linalg.lstsq(design, error, rcond=1e-9)[0]
            square, width = float(np.sum((error - design @ solution) ** 2)), float(solution[-1])
            found[trial] = square, width, place
        return found[trial][0]

    for factor in _FACTORS:
        best = min(found, key=lambda one: found[one][0], default=limit)
        for trial in (best, best * factor, best / factor):
            if trial not in found:
                tried(trial)
    best = min(found, key=lambda one: found[one][0])
    return best, found[best][2]


def _place(
    log: EncoderLog,
    motion: Int[np.ndarray, " n"],
    excess: Float[np.ndarray, " n"],
    gap: float,
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


def _flanks(
    sense: Int[np.ndarray, " m"], braking: Float[np.ndarray, " m"], limit: float
) -> Int[np.ndarray, " m"]:
    """Return +1 for flank A, −1 for flank B: `sense`, reversed where `braking` exceeds `limit`."""
    beyond: Bool[np.ndarray, " m"] = braking > limit
    return np.where(beyond, -sense, sense).astype(np.int8)


def _best_limit(
    error: Float[np.ndarray, " m"],
    columns: Float[np.ndarray, "m p"],
    sense: Int[np.ndarray, " m"],
    braking: Float[np.ndarray, " m"],
    limits: list[float],
) -> tuple[float, float, float]:
    """Return the limit in rad/s² with the least sum of squares, the sum, and the gap of its fit.

    The search starts with the trial values `limits`; `sense` is the flank by the motion, ±1.
    """

    def tried(limit: float) -> tuple[float, float]:
        return squares_with_step(error, columns, _flanks(sense, braking, limit))

    found = {limit: tried(limit) for limit in limits}
    for _ in range(_ROUNDS):
        best = min(found, key=lambda limit: found[limit][0])
        known = sorted(found)
        place = known.index(best)
        for other in known[max(place - 1, 0) : place] + known[place + 1 : place + 2]:
            middle = 0.5 * (best + other)
            found[middle] = tried(middle)
    best = min(found, key=lambda limit: found[limit][0])
    return best, *found[best]
