"""Delay of the driven channel: decision whether it is fitted, and the next step of its estimate.

A driven reading that is late by d adds −d ω₂ to the transmission error. This term changes its sign
with the direction of motion and therefore resembles backlash; only different speeds on one flank
separate the two. The first estimate of d is the coefficient of the column −ω₂. The next pass takes
the driving angle at t − d, because a delay also shifts the harmonics, and estimates the rest of d.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from ...base.numerics.quantiles import NORMAL_95
from ...logs.motion.segments import Segment
from .nuisance import NuisanceRegression

SIGNIFICANT = 4.0
"""Standard errors above which a delay is fitted without a request; chosen value."""

TOLD = 1e-4
"""A delay is identifiable if offsets and harmonics leave at least this share of the sum of squares
of the column −ω₂ unexplained. The value corresponds to a speed variation of 1 %. The resolution of
the encoder alone can give an apparent variation of 0.5 %."""

NEGLECTED = (
    f"below {SIGNIFICANT:g} standard errors; the other parameters take it as zero, and the interval"
    " of the gap allows for it"
)
"""Reason why an insignificant delay is not fitted."""

TOO_SHORT = (
    "the shafts turned too little to tell a small delay from their eccentricities; log longer"
    " strokes"
)
"""Reason why a delay of short strokes is not fitted."""

SAME_SPEED = 0.05  # largest relative difference of speeds that count as equal; chosen value
_WIDE = 2.0
"""A delay is open if its bound is smaller than this number of standard errors; chosen value."""

WITHIN_ONE_INTERVAL = "delay_within_one_sampling_interval"
"""Condition of a fit whose logs do not determine the delay, and whose user gives no bound of it."""

_LATCHED_S = 1e-7  # delay of channels that one clock samples, s; chosen value
_SIZES = 4000  # delays at which the posterior is computed; chosen value

_SMALL, _SMALLEST_S = 0.01, 1e-9  # step that counts as zero: in standard errors, and in s
_LEAST_SHARE = 0.05  # least share of a step of the delay; chosen value
State = Literal["fitted", "insignificant", "open", "given", "off"]


@dataclass(frozen=True)
class Delay:
    """Estimate of the delay, and the decision on it.

    **Arguments**
    - `state`: "fitted" (a parameter of the solution), "insignificant" (estimated, taken as zero),
      "open" (the logs do not determine it), "given" or "off".
    - `seconds`: delay that is already removed: the driving angle is taken this much earlier, s.
    - `step_s`, `std_s`: delay that the linear model finds in addition, and its standard error, s.
    - `reason`: reason why the delay is not fitted.
    - `within_s`: assumed bound of |delay|, s, of a delay that is open or insignificant.
    - `share`: change of the residual when the driving angle moves by a delay, over the change that
      the column of the smoothed speed predicts; it is below 1 if the readings jitter.
    - `forced`: whether the user requires the delay, even if the logs do not determine it.
    """

    state: State
    seconds: float = 0.0
    step_s: float = 0.0
    std_s: float = 0.0
    reason: str = ""
    forced: bool = False
    within_s: float = 0.0
    share: float = 1.0

    @property
    def is_settled(self) -> bool:
        """Whether another pass would not change the delay."""
        small = max(_SMALL * self.std_s, _SMALLEST_S)
        return self.state != "fitted" or abs(self.step_s) <= small

    def neglected_s(self, *, steady: bool) -> float:
        """Return the half-width of the 95 % interval, s, of a delay that the fit takes as zero.

        With the estimate d and its standard error s it is 1.96 √(d² + s²) if all runs have one
        speed (`steady`), where only ramps separate a delay from the gap. If several speeds tell the
        delay, it is the 95 % quantile of |delay| of a posterior, but not more than at one speed.
        Channels that one clock samples have any small delay, and channels that a program polls one
        after the other have any part of a sampling interval. Therefore one half of the prior is
        flat in log |delay|, from `_LATCHED_S` to `within_s`, and the other half in |delay|, up to
        `within_s`. The result is 0 unless the delay is insignificant.
        """
        if self.state != "insignificant":
            return 0.0
        widest = NORMAL_95 * float(np.hypot(self.step_s, self.std_s))
        if steady or self.within_s <= _LATCHED_S:
            return widest if steady else min(widest, self.within_s)
        size = np.geomspace(_LATCHED_S, self.within_s, _SIZES)
        signed = np.stack([size, -size])
        likelihood = np.exp(-(((signed - self.step_s) / self.std_s) ** 2) / 2).sum(axis=0)
        below = np.cumsum(likelihood * (1 / _SIZES + size / size.sum()))
        if not below[-1] > 0:  # all these delays are excluded
            return widest
        return min(widest, float(size[np.searchsorted(below, 0.95 * below[-1])]))

    @property
    def bound_s(self) -> float:
        """Bound of |delay|, s, if the logs do not determine the delay; otherwise 0."""
        return self.within_s if self.is_bounded else 0.0

    @property
    def is_bounded(self) -> bool:
        """Whether the logs do not determine the delay, and `within_s` bounds it."""
        return self.state == "open" and not self.forced

    @property
    def is_unbounded(self) -> bool:
        """Whether the logs do not determine the delay, and the user gives it no bound."""
        return self.state == "open" and self.forced

    def after(self, step_s: float) -> "Delay":
        """Return the delay with the `share` that the step `step_s` of the last pass reveals.

        If the column of the smoothed speed were exact, `step_s` would leave nothing to correct. If
        the rest `self.step_s` is the share 1 − s of it, the coefficient of this column has to be
        multiplied by 1/s to become a delay, and so has its standard error.
        """
        share = 1 - self.step_s / step_s
        return replace(self, share=float(np.clip(share, _LEAST_SHARE, 1.0)))

    def stepped(self) -> "Delay":
        """Return the delay with `step_s` added to `seconds`, for the next pass."""
        return replace(self, seconds=self.seconds + self.step_s, step_s=0.0)


def judge_delay(
    own: NuisanceRegression,
    beside: Sequence[str],
    seconds: float,
    *,
    forced: bool,
    two_flanks: bool,
    steady: bool,
    within_s: float,
    short: bool = False,
) -> Delay:
    """Decide whether the delay is fitted, insignificant or open (not determined by the logs).

    **Arguments**
    - `own`: linear regression. - `beside`: its coefficients that are estimated with the delay.
    - `seconds`: delay that is already removed, s.
    - `forced`: fit the delay even if it is insignificant.
    - `two_flanks`: whether the logs cover both flanks. - `steady`: whether all runs have one speed;
      an insignificant delay is then open if two standard errors exceed `within_s`.
    - `within_s`: assumed bound of |delay|, s, if the logs do not determine it.
    - `short`: whether no first order is fitted, because the shafts turn too little. The unknown
      eccentricities then resemble a delay, so that only one beyond `within_s` is fitted.
    """
    like = "the constant backlash" if two_flanks else "an offset"
    reason = f"at one steady speed a delay cannot be told from {like}; log a second speed"
    unknown = Delay("open", reason=reason, forced=forced, within_s=within_s)
    if own.left("delay") < TOLD:
        return unknown
    step, std = own.estimate("delay", [*beside, "delay"])
    total = seconds + step
    if short and two_flanks and not forced and abs(total) - SIGNIFICANT * std <= within_s:
        return replace(unknown, reason=TOO_SHORT)
    if forced or abs(total) > SIGNIFICANT * std:
        return Delay("fitted", seconds, step, std)
    if steady and two_flanks and _WIDE * std > within_s:
        return unknown
    return Delay(
        "insignificant",
        0.0,
        total,
        std,
        NEGLECTED,
        within_s=within_s,
    )


def one_speed(segments: Sequence[Segment]) -> bool:
    """Return whether all segments have nearly the same speed."""
    speeds = np.abs([s.speed for s in segments])
    return len(speeds) > 0 and bool(np.ptp(speeds) <= SAME_SPEED * speeds.max())
