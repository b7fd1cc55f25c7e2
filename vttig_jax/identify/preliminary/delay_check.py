"""Bound of a delay that the logs do not determine, and checks of a fitted and of a stated delay."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ...logs.channel.spikes import bends
from ..noise.noise_model import whiten
from ..settings import FitSettings
from .delay import SIGNIFICANT, TOLD, Delay, one_speed
from .linear_fit import Input, LinearFit, linear_fit
from .ramps import finest_row_s, with_ramps
from .robust import Reweighted

_MORE = 1.05
"""A fitted delay is rejected if it increases the residual by more than this factor (chosen)."""

_REAL = 2 / 3
"""Least share of the variance of the speed that is not noise of the readings (chosen)."""

_NOISE = (
    "the variations of the speed are mostly noise of the readings, so that they tell no delay; log"
    " a second speed"
)
_WORSE = "the delay that resembles the slow errors of the log leaves a larger residual than none"


def explaining(delay: Delay, weights: Reweighted, linear: LinearFit, *, bound_s: float) -> Delay:
    """Return the delay, or an open one if the speed is noise or the residual is larger with it.

    At a steady speed in one direction the smoothed speed consists of the noise of the driving
    readings, and its coefficient is no delay. In a run-up the speed grows in the same way as the
    drift. The log then cannot separate delay and drift, and the steps of the delay may diverge to a
    value that does not explain the log.

    **Arguments**
    - `weights`: weights of the samples. - `linear`: fit from which the delay is removed.
    - `bound_s`: a delay up to this bound is not checked; also the bound of an open delay, s.
    """
    one_way = len(linear.summary.flanks) == 1 and delay.state in ("fitted", "insignificant")
    if one_way and real_share(linear) < _REAL:
        return Delay("open", reason=_NOISE, within_s=bound_s)
    if delay.state != "fitted" or abs(delay.seconds) <= bound_s:
        return delay
    without = weights.look(linear.inputs, linear.model, 0.0, linear.block_s)
    left, before = (whiten(one.summary)[0].std for one in (linear, without))
    return delay if left <= _MORE * before else Delay("open", reason=_WORSE, within_s=bound_s)


def rest_of_delay(
    weights: Reweighted, linear: LinearFit, names: Sequence[str]
) -> tuple[float, float] | None:
    """Return the delay that the logs show beside a stated one, and its standard error, s.

    The result is None if it is not significant, or if the logs do not determine it.

    **Arguments**
    - `weights`: weights of the samples. - `linear`: fit with the stated delay.
    - `names`: its selected coefficients of drift and regressors.
    """
    inputs = linear.inputs
    other = linear_fit(
        inputs,
        replace(linear.model, regressors=(*linear.model.regressors, "delay")),
        linear.channels[0].delay_s,
        weights.values,
        finest_s=finest_row_s(inputs),
        pulls=weights.pulls,
    )
    if one_speed([segment for one in inputs for segment in one.segments]):
        other, _ = with_ramps(other)
    if other.own.left("delay") < TOLD:
        return None
    if len(other.summary.flanks) == 1 and real_share(other) < _REAL:
        return None
    rest, std = other.own.estimate("delay", [*names, "delay"])
    return (rest, std) if abs(rest) > SIGNIFICANT * std else None


def real_share(linear: LinearFit) -> float:
    """Return the share of the variance of the speed that the noise of readings does not explain.

    A reading of standard deviation σ gives the speed over a window of w seconds the variance
    2 σ²/w². σ is that of a reading about the line through its neighbours, outliers included.
    """
    speeds, noise = [], []
    for one, channels, segments in zip(
        linear.inputs, linear.channels, linear.segments, strict=True
    ):
        smooth = one.log.smooth_speed(channels.driving)
        bend = bends(channels.driving, one.log.time) / (smooth.window * one.log.interval_s)
        for segment in segments:
            part = slice(segment.start, segment.stop)
            speeds.append(np.abs(smooth.value[part]))
            noise.append(2 * bend[part] ** 2 / 1.5)
    if not speeds:
        return 0.0
    variance = float(np.var(np.concatenate(speeds)))
    return 1.0 - float(np.mean(np.concatenate(noise))) / variance if variance > 0 else 0.0


def delay_bound_s(inputs: Sequence[Input], settings: FitSettings) -> float:
    """Return the bound, s, of a delay that the logs do not determine.

    It is the setting `delay_within_ms`, or by default the longest median sampling interval.
    """
    if settings.delay_within_ms is not None:
        return 1e-3 * settings.delay_within_ms
    return max(one.log.interval_s for one in inputs)


def is_told_on_one_flank(plain: LinearFit) -> bool:
    """Return whether the logs cover one flank only, and identify the delay without ramps.

    If the speed varies once per turn, a delay looks like a first order there. A delay that is
    wrongly taken as zero would bias this order.
    """
    return len(plain.summary.flanks) == 1 and plain.own.left("delay") >= TOLD
