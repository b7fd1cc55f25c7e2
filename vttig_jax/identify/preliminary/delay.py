"""Delay between the two channels: whether the logs show one, and the step that is left to it.

A driven reading that is d late adds −d ω₂ to the transmission error, odd in speed, so that it looks
like backlash. Only a change of speed on a flank tells the two apart. The column −ω₂ is the first
step; then the driving angle is taken at t − d, because a delay turns the harmonics too.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from jaxtyping import Float

from ...logs.motion.flank_assignment import Ramp
from ...logs.motion.segments import Segment
from ...pair.gear_pair import Flank
from .nuisance import NuisanceRegression

SIGNIFICANT = 4.0
"""Standard errors a delay must differ from zero by to be fitted unasked."""

TOLD = 1e-4
"""Share of −ω₂, squared, that offsets and harmonics must leave for a delay to be seen: a speed that
varies by 1 %. The counts alone let it seem to vary by half a percent."""

SAME_SPEED = 0.05
_SMALL, _SMALLEST_S = 0.01, 1e-9
_BRANCH = 0.25
"""Share of the gap by which a ramp may stand off its flank."""

State = Literal["fitted", "insignificant", "open", "given", "off"]


@dataclass(frozen=True)
class Delay:
    """What became of the delay.

    **Arguments**
    - `state`: "fitted" (a parameter of the solution), "insignificant" (seen, taken as zero), "open"
      (the logs cannot tell), "given" or "off".
    - `seconds`: by which the driving angle is shifted.
    - `step_s`, `std_s`: what the linear model still adds to it, and its standard error.
    - `reason`: why it is not fitted.
    - `forced`: asked for, whether the logs can tell it or not.
    """

    state: State
    seconds: float = 0.0
    step_s: float = 0.0
    std_s: float = 0.0
    reason: str = ""
    forced: bool = False

    @property
    def is_settled(self) -> bool:
        """True where another pass would not move it."""
        small = max(_SMALL * self.std_s, _SMALLEST_S)
        return self.state != "fitted" or abs(self.step_s) <= small

    def stepped(self) -> "Delay":
        """With the step taken."""
        return replace(self, seconds=self.seconds + self.step_s, step_s=0.0)


def judge_delay(
    own: NuisanceRegression,
    beside: Sequence[str],
    seconds: float,
    *,
    forced: bool,
    two_flanks: bool,
) -> Delay:
    """Decide on a delay from the linear model that has the coefficients `beside` too.

    `forced` keeps it whether significant or not.
    """
    if own.left("delay") < TOLD:
        like = "the constant backlash" if two_flanks else "an offset"
        reason = f"at one steady speed a delay cannot be told from {like}"
        return Delay("open", reason=f"{reason}; log a second speed", forced=forced)
    step, std = own.estimate("delay", [*beside, "delay"])
    total = seconds + step
    if forced or abs(total) > SIGNIFICANT * std:
        return Delay("fitted", seconds, step, std)
    return Delay(
        "insignificant",
        0.0,
        total,
        std,
        f"below {SIGNIFICANT:g} standard errors; the other parameters take it as zero",
    )


def one_speed(segments: Sequence[Segment]) -> bool:
    """True where every segment has nearly the same speed."""
    speeds = np.abs([s.speed for s in segments])
    return len(speeds) > 0 and bool(np.ptp(speeds) <= SAME_SPEED * speeds.max())


def on_its_branch(
    ramp: Ramp,
    rows: Float[np.ndarray, "n q"],
    residual_rows: Mapping[Flank, Float[np.ndarray, " q"]],
    noise_std: float,
) -> bool:
    """Does a ramp stay on the flank of its motion?

    `residual_rows` makes residuals of rows, flank by flank. A ramp is taken where nearly all of it
    lies nearer to its own flank than a quarter of the gap, or than four standard deviations.
    """
    own = ramp.segment.flank
    if own not in residual_rows or len(rows) == 0:
        return False
    residual = rows @ residual_rows[own]
    other = residual_rows.get("B" if own == "A" else "A")
    gap = np.abs(rows @ (other - residual_rows[own])) if other is not None else np.inf
    allowed = np.minimum(_BRANCH * gap + 3 * noise_std, np.inf)
    return bool(np.mean(np.abs(residual) <= allowed) >= 0.95)
