"""Delay between the two channels: its significance, and the remaining step of its estimate.

A driven reading that is late by d adds −d ω₂ to the transmission error. This term is odd in speed
and resembles backlash. Only a change of speed on a flank separates them. The coefficient of −ω₂ is
the first step. The driving angle is then taken at t − d, because a delay shifts the harmonics too.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from jaxtyping import Float

from ...base.numerics.quantiles import NORMAL_95
from ...logs.motion.flank_assignment import Ramp
from ...logs.motion.segments import Segment
from ...pair.gear_pair import Flank
from .nuisance import NuisanceRegression

SIGNIFICANT = 4.0
"""Standard errors above which a delay is fitted without a request; chosen value."""

TOLD = 1e-4
"""Smallest squared share of −ω₂ not explained by offsets and harmonics with which a delay is
identifiable: a speed variation of 1 %. Resolution alone can give an apparent variation of 0.5 %."""

SAME_SPEED = 0.05  # largest relative difference of speeds that count as equal; chosen value
_WIDE = 2.0
"""Standard errors of a delay that must lie within its bound; chosen value."""

_SMALL, _SMALLEST_S = 0.01, 1e-9  # step that counts as zero: in standard errors, and in s
_BRANCH = 0.25
"""Largest distance of a ramp from its flank, as a share of the gap; chosen value."""

State = Literal["fitted", "insignificant", "open", "given", "off"]


@dataclass(frozen=True)
class Delay:
    """Estimate of the delay, and the decision on it.

    **Arguments**
    - `state`: "fitted" (a parameter of the solution), "insignificant" (estimated, taken as zero),
      "open" (the logs do not determine it), "given" or "off".
    - `seconds`: shift of the driving angle, s.
    - `step_s`, `std_s`: further step of the linear model, and its standard error, s.
    - `reason`: reason why it is not fitted.
    - `within_s`: bound of |delay|, s, if the logs do not determine it.
    - `forced`: whether the user requires the delay, even if the logs do not determine it.
    """

    state: State
    seconds: float = 0.0
    step_s: float = 0.0
    std_s: float = 0.0
    reason: str = ""
    forced: bool = False
    within_s: float = 0.0

    @property
    def is_settled(self) -> bool:
        """Whether another pass would not change the delay."""
        small = max(_SMALL * self.std_s, _SMALLEST_S)
        return self.state != "fitted" or abs(self.step_s) <= small

    def unknown_s(self, *, steady: bool) -> float:
        """Return the size of a delay, s, that the fit leaves in the gap between the flanks.

        It is the bound of a delay that the logs do not tell, and at one speed (`steady`) the half
        width of the interval of an insignificant delay, which the fit takes as zero.
        """
        if self.state == "insignificant" and steady:
            return NORMAL_95 * self.std_s
        return self.bound_s

    @property
    def bound_s(self) -> float:
        """Bound of a delay that the logs do not tell, s; 0 for any other delay."""
        return self.within_s if self.state == "open" and not self.forced else 0.0

    def stepped(self) -> "Delay":
        """Return the delay with the step added."""
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
) -> Delay:
    """Decide on the delay by a linear model with the coefficients `beside` and the delay.

    At one speed (`steady`) an insignificant delay is open if its standard error is beyond the bound
    `within_s` of its size, s.

    If `forced`, the delay is fitted in any case.
    """
    like = "the constant backlash" if two_flanks else "an offset"
    reason = f"at one steady speed a delay cannot be told from {like}; log a second speed"
    unknown = Delay("open", reason=reason, forced=forced, within_s=within_s)
    if own.left("delay") < TOLD:
        return unknown
    step, std = own.estimate("delay", [*beside, "delay"])
    total = seconds + step
    if forced or abs(total) > SIGNIFICANT * std:
        return Delay("fitted", seconds, step, std)
    if steady and two_flanks and _WIDE * std > within_s:
        return unknown
    return Delay(
        "insignificant",
        0.0,
        total,
        std,
        f"below {SIGNIFICANT:g} standard errors; the other parameters take it as zero",
    )


def one_speed(segments: Sequence[Segment]) -> bool:
    """Return whether all segments have nearly the same speed."""
    speeds = np.abs([s.speed for s in segments])
    return len(speeds) > 0 and bool(np.ptp(speeds) <= SAME_SPEED * speeds.max())


def on_its_branch(
    ramp: Ramp,
    rows: Float[np.ndarray, "n q"],
    residual_rows: Mapping[Flank, Float[np.ndarray, " q"]],
    noise_std: float,
) -> bool:
    """Return whether a ramp stays on the flank of its motion.

    The residuals of at least 95 % of its rows must be at most a quarter of the gap plus three
    standard deviations of the noise. `residual_rows` gives the weights (−β, 1) of each flank.
    """
    own = ramp.segment.flank
    if own not in residual_rows or len(rows) == 0:
        return False
    residual = rows @ residual_rows[own]
    other = residual_rows.get("B" if own == "A" else "A")
    gap = np.abs(rows @ (other - residual_rows[own])) if other is not None else np.inf
    allowed = np.minimum(_BRANCH * gap + 3 * noise_std, np.inf)
    return bool(np.mean(np.abs(residual) <= allowed) >= 0.95)
