"""Samples of a log for the fit: the driving angle at the instant of the driven reading, and the
regressors other than harmonics: drift, delay, torque, speed, acceleration and ratio."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import final

import numpy as np
from jaxtyping import Float, Int

from ...base.errors import UsageError
from ...base.numerics.counting import nearest_whole, whole_above
from ...base.units import DEG
from ...logs.channel.spikes import without_spikes
from ...logs.encoder_log import EncoderLog
from ...logs.motion.segments import Segment
from ...pair.gear_pair import Drive, Flank, GearPair
from ..model.column_layout import ColumnLayout
from ..model.given_model import GivenModel, Linearised

Samples = Float[np.ndarray, " n"]


TORQUE_WINDOWS_S = (0.0, 0.05, 0.1, 0.2, 0.4, 0.8)
"""Durations of the averages of the torque, s; chosen values. Each average is tried as the regressor
of the wind-up, and the best one is kept. The torque reading of a motor is noisy, and noise in a
regressor biases its coefficient towards zero."""


DROPPED = 0.5
"""Weight below which a sample counts as an outlier; chosen value."""

_LEVELLED = 4096
"""Number of evenly spaced samples from which the level of a log is computed; chosen value."""


def torque_column(number: int) -> str:
    """Return the column name of the torque averaged over `TORQUE_WINDOWS_S[number]`."""
    return f"torque_{number}"


@dataclass(frozen=True)
class Drift:
    """Slow change of the transmission error: powers of time, or B-splines.

    **Arguments**
    - `order`: highest power of the scaled time.
    - `knots_s`: distance of the knots of a cubic B-spline, s; 0 for powers of time.
    - `stiffness`: standard deviation of the white noise of the rows divided by that of the step
      from one coefficient of the spline to the next; 0 for free coefficients.
    """

    order: int = 0
    knots_s: float = 0.0
    stiffness: float = 0.0

    def names(self, duration_s: float) -> tuple[str, ...]:
        """Return the names of the columns for a log of this duration."""
        if self.knots_s:
            count = max(1, nearest_whole(duration_s / self.knots_s)) + 2
            return tuple(f"spline_{k}" for k in range(1, count + 1))
        return tuple(f"drift_{k}" for k in range(1, self.order + 1))

    def held(self, columns: ColumnLayout) -> Float[np.ndarray, "steps q"]:
        """Return additional rows that penalise the steps between neighbouring spline coefficients.

        A row states "this step is zero" with the weight `stiffness`, so that the coefficients are
        a random walk (P. H. C. Eilers, B. D. Marx, Statist. Sci. 11 (1996) 89). The walk starts
        at zero, the coefficient of the basis function that the offset replaces.
        """
        own = [name for name in columns.own[0] if name.startswith("spline_")]
        count = len(own) if self.stiffness else 0
        rows = np.zeros((count, columns.width))
        start = columns.index(own[0]) if count else 0
        rows[:, start : start + count] = self.stiffness * steps(count)
        return rows

    def stiffness_s(self, duration_s: float) -> float | None:
        """Return the shortest period that the drift can follow, s; None without drift.

        It is twice the length of a piece of the spline, or 2 `duration_s`/`order` for powers.
        """
        if self.knots_s:
            return 2 * duration_s / max(1, nearest_whole(duration_s / self.knots_s))
        return 2 * duration_s / self.order if self.order else None


def steps(count: int) -> Float[np.ndarray, "m m"]:
    """Return the matrix of the steps of a random walk from zero."""
    return np.eye(count) - np.eye(count, k=-1)


@final
@dataclass(frozen=True, eq=False)
class Derived:
    """Column whose values are a function of single values of an array.

    They are computed for the samples that are read, because a column of every sample would need as
    much memory as a channel of the log.
    """

    source: Samples
    function: Callable[[Samples], Samples]

    def __getitem__(self, part: slice | Int[np.ndarray, " m"]) -> Samples:
        return self.function(self.source[part])


Column = Samples | Derived


@dataclass(frozen=True, eq=False)
class Regressors:
    """Samples and regressors of one log, in rad and s.

    The own columns of a log are the columns of the design matrix that belong to it alone, such as
    its drift; see `ColumnLayout`.

    **Arguments**
    - `driving`: φ₁ at the instant of the driven reading, t − `delay_s`.
    - `driven`: φ₂ as read.
    - `error`: flank → φ₂ − i φ₁ minus `level` and the effect of a logged axial position.
    - `own`: name → values of the own columns of the log, without the offset.
    - `weight`: weight of every sample; None for equal weights.
    - `pull`: values that Huber's loss subtracts from `error` to limit the influence of outliers;
      None for zero.
    - `level`: subtracted level, rad; see `level_of`.
    - `drift`: drift, whose columns are among `own`.
    - `slopes`: names of the parameters of a given flank model; empty without one.
    - `given`: flank → values and derivatives of the given model; `error` does not contain it.
    """

    log: EncoderLog
    time: Samples
    driving: Samples
    driven: Samples
    error: dict[Flank, Samples]
    own: dict[str, Column]
    delay_s: float = 0.0
    weight: Samples | None = None
    sample_s: float = 0.0
    pull: Samples | None = None
    level: float = 0.0
    drift: Drift = Drift()
    slopes: tuple[str, ...] = ()
    given: dict[Flank, Linearised] = field(default_factory=dict)

    def own_on(self, flank: Flank) -> dict[str, Column]:
        """Return name → values of the own columns on a flank, those of a given model included."""
        if not self.slopes:
            return self.own
        slopes = self.given[flank].slopes.T
        return self.own | dict(zip(self.slopes, slopes, strict=True))


def level_of(log: EncoderLog) -> float:
    """Return the median transmission error of a log, rounded to whole degrees, in rad.

    If the encoders have different zeros, the transmission error is radians from zero, and its noise
    is microradians. In products the constant would remove the digits of the noise, and the first
    step of the solver would turn it into eccentricities of metres. The level is therefore
    subtracted before any product, and added to the offset again. It is 0 for a common zero.
    """
    error = log.transmission_error
    return float(np.rint(np.median(error[:: max(1, len(error) // _LEVELLED)]) / DEG)) * DEG


def read_channels(
    log: EncoderLog,
    pair: GearPair | Drive,
    regressors: Sequence[str],
    drift: Drift,
    delay_s: float = 0.0,
    weight: Samples | None = None,
    pull: Samples | None = None,
    given: GivenModel | None = None,
) -> Regressors:
    """Shift the driving angle to t − `delay_s`, and compute the columns of `regressors`.

    A `given` flank model is subtracted from the transmission error, and its derivatives are
    columns. `weight` and `pull` are those of a robust loss; see `Regressors`.

    **Raises** `NoAnswerError` if a given model is not finite at an angle of the log, and
    `UsageError` if the torque is a regressor but the log has no torque column.
    """
    driving = shifted(log, delay_s, weight)
    ratio = float(log.ratio)
    level = level_of(log)
    error = log.transmission_error
    if level:
        error = error - level
    if driving is not log.driving_angle:
        error = error + ratio * (log.driving_angle - driving)
    if pull is not None:
        error = error - pull
    # Outliers are removed here, because a late reading would look like a change of the speed.
    smooth = driving if weight is None else without_spikes(driving, log.time, weight < DROPPED)
    own = _drift_columns(log.time, drift)
    for name in regressors:
        if name == "torque":
            own |= _torque_columns(log)
        else:
            own[name] = _COLUMNS[name](log, smooth, ratio)
    correction = _axial_correction(log, pair)
    flanks: tuple[Flank, ...] = ("A", "B")
    linearised: dict[Flank, Linearised] = {}
    if given is not None:
        linearised = {flank: given.on(driving, flank, log.source) for flank in flanks}
    modelled = {flank: one.value for flank, one in linearised.items()}
    return Regressors(
        log=log,
        time=log.time,
        driving=driving,
        driven=log.driven_angle,
        error={f: _less(error, correction.get(f), modelled.get(f)) for f in flanks},
        own=own,
        delay_s=delay_s,
        weight=weight,
        sample_s=log.interval_s,
        pull=pull,
        level=level,
        drift=drift,
        slopes=() if given is None else given.names,
        given=linearised,
    )


def _less(error: Samples, *parts: Samples | None) -> Samples:
    """Return `error` minus all `parts` that are not None.

    Without such a part the result is the array `error` itself, which both flanks then share.
    """
    for part in parts:
        error = error if part is None else error - part
    return error


def shifted(log: EncoderLog, delay_s: float, weight: Samples | None = None) -> Samples:
    """Return φ₁, rad, at the times t − `delay_s`, by cubic interpolation between the samples.

    The interpolation omits spikes and samples of little `weight`, because one late reading would
    change the angle of the next sample. The angle of a sample of little weight changes by the
    travel of the shaft, so that its distance from the interpolated curve stays the same.
    """
    angle = log.driving.steady_angle(log.time)
    if delay_s == 0:
        return angle
    from scipy.interpolate import CubicHermiteSpline  # slow to import, and needed for delays only

    doubtful = np.zeros(len(angle), bool) if weight is None else weight < DROPPED
    spikes = np.zeros(len(angle), bool) if log.driving.spikes is None else log.driving.spikes
    time, first = np.unique(log.time, return_index=True)
    good = ~(spikes | doubtful)[first]
    if good.sum() < 2:
        good = ~spikes[first]
    time, first = time[good], first[good]
    curve = CubicHermiteSpline(time, angle[first], np.gradient(angle[first], time))
    moved = curve(np.clip(log.time - delay_s, time[0], time[-1]))
    off = doubtful & ~spikes
    moved[off] += angle[off] - curve(np.clip(log.time[off], time[0], time[-1]))
    return np.asarray(moved)


def trimmed(segment: Segment, channels: Regressors) -> Segment:
    """Return the segment without the samples whose shifted instant is outside it."""
    return trim(segment, channels.delay_s, channels.sample_s)


def trim(segment: Segment, delay_s: float, sample_s: float) -> Segment:
    """Return the segment without the samples whose shifted time t − `delay_s` is outside it."""
    lost = whole_above(abs(delay_s) / sample_s) if delay_s else 0
    start = segment.start + (lost if delay_s > 0 else 0)
    stop = segment.stop - (lost if delay_s < 0 else 0)
    return Segment(start, max(start, stop), segment.flank, segment.speed)


def _drift_columns(time: Samples, drift: Drift) -> dict[str, Column]:
    origin, half = (time[0] + time[-1]) / 2, (time[-1] - time[0]) / 2
    names = drift.names(2 * half)
    if not drift.knots_s:

        def power_of(power: int) -> Derived:
            return Derived(time, lambda seconds: ((seconds - origin) / half) ** power)

        return {name: power_of(power) for power, name in enumerate(names, 1)}
    from scipy.interpolate import BSpline  # slow to import, and seldom needed

    pieces = len(names) - 2
    inner = np.linspace(time[0], time[-1], pieces + 1)
    step = (time[-1] - time[0]) / pieces
    knots = np.concatenate(
        [inner[0] - step * np.arange(3, 0, -1), inner, inner[-1] + step * np.arange(1, 4)]
    )
    basis = BSpline.design_matrix(time, knots, 3).toarray()
    # The basis sums to one, which is the offset column; the first function is therefore left out.
    return {name: basis[:, k + 1] for k, name in enumerate(names)}


def _axial_correction(log: EncoderLog, pair: GearPair | Drive) -> dict[str, Samples]:
    """Return the part of the TE that an axial position s causes, rad, for each flank.

    It is + s tan β_L/R₂ on flank A and − s tan β_R/R₂ on flank B. A log without an axial position
    and a drive without gears have none.
    """
    if log.axial_mm is None or isinstance(pair, Drive):
        return {}
    (left, right), radius = pair.taper, pair.reference_radii[1]
    return {"A": log.axial_mm * left / radius, "B": -log.axial_mm * right / radius}


def _speed(log: EncoderLog, driving: Samples) -> Samples:
    """Return ω₁, rad/s, as logged, or by differences over windows that the resolution allows."""
    if log.speed is not None:
        return log.speed
    return log.smooth_speed(driving).value


def _delay(log: EncoderLog, driving: Samples, ratio: float) -> Column:
    """Return −ω₂, rad/s: the change of the TE per second by which the driven channel is late."""
    return Derived(log.smooth_speed(driving).value, lambda speed: -ratio * speed)


def _late_delay(log: EncoderLog, driving: Samples, ratio: float) -> Column:
    """Return the column of a delay in the second half of the log: −ω₂ there, 0 before."""
    late = log.time > 0.5 * (log.time[0] + log.time[-1])
    return np.where(late, -ratio * log.smooth_speed(driving).value, 0.0)


def _driven_speed(log: EncoderLog, driving: Samples, ratio: float) -> Samples:
    return ratio * _speed(log, driving)


def _driven_acceleration(log: EncoderLog, driving: Samples, ratio: float) -> Samples:
    if log.acceleration is not None:
        return ratio * log.acceleration
    smooth = log.smooth_speed(driving)
    half = max(1, smooth.window // 2)
    place = np.arange(len(log.time))
    low, high = np.maximum(place - half, 0), np.minimum(place + half, len(place) - 1)
    elapsed = log.time[high] - log.time[low]
    usual = np.median(elapsed)
    return ratio * (smooth.value[high] - smooth.value[low]) / np.maximum(elapsed, 1e-3 * usual)


def _torque_columns(log: EncoderLog) -> dict[str, Column]:
    """Return name → column of the torque, and of its moving averages.

    A window of `TORQUE_WINDOWS_S` is used if it lasts at least 3 samples and at most a twentieth
    of the log.
    """
    if log.torque is None:
        raise UsageError(
            "the torque is asked for, but the log has no torque column; name it with --column"
            " torque=NAME or in [log].",
            where=log.source,
        )
    from scipy.ndimage import uniform_filter1d  # slow to import, and needed with a torque only

    columns: dict[str, Column] = {}
    interval, duration = log.interval_s, np.ptp(log.time)
    for number, window_s in enumerate(TORQUE_WINDOWS_S):
        samples = nearest_whole(window_s / interval)
        if window_s == 0 or (samples >= 3 and window_s <= duration / 20):
            smooth = uniform_filter1d(log.torque, max(samples, 1), mode="nearest")
            columns[torque_column(number)] = smooth
    return columns


def _ratio(log: EncoderLog, driving: Samples, ratio: float) -> Samples:
    return driving - driving.mean()


_COLUMNS: dict[str, Callable[[EncoderLog, Samples, float], Column]] = {
    "delay": _delay,
    "delay_late": _late_delay,
    "ratio": _ratio,
    "acceleration": _driven_acceleration,
    "speed": _driven_speed,
}
