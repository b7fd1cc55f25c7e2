"""Gap between the flanks that resembles a delay of the driven channel, which the fit leaves out.

A delay d moves both flanks apart by i |ω₁| d each, like a gap. The interval of the gap has to allow
for a delay that the logs do not determine, and for one that is too small to be fitted.
"""

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from ...base.numerics.quantiles import NORMAL_95
from ...base.units import DEG
from ..model.identifiability import Identifiability
from ..preliminary.delay import Delay, one_speed
from .parameters import SIGNIFICANT, Parameter
from .record import Record

_TOGETHER = (
    "at one speed it is known only together with the delay; log a second speed, or give --delay or"
    " --delay-within"
)
_BELOW = "below three standard errors, which allow for the delay that is taken as zero"


class GapOfDelay(Record, frozen=True):
    """Gap that a delay which the fit takes as zero may add to the fitted gap, degrees.

    **Arguments**
    - `half_width_deg`: half-width of the 95 % interval of this gap. If it is `bounded`, all of the
      interval.
    - `bounded`: whether the logs do not determine the delay. Its gap is then equally probable
      within these bounds; otherwise it is normal with mean zero.
    """

    half_width_deg: float
    bounded: bool

    @property
    def std_deg(self) -> float:
        """Standard deviation of this gap, degrees."""
        return self.half_width_deg / (math.sqrt(3) if self.bounded else NORMAL_95)

    def widened(self, gap: Parameter) -> Parameter:
        """Return the fitted gap with the interval and the standard error that contain this gap.

        The negative part of an interval is cut off if this gap is `bounded`, because no gap is
        negative.
        """
        if gap.value is None or gap.std is None:
            return gap
        value, std = gap.value, math.hypot(gap.std, self.std_deg)
        half = math.hypot(NORMAL_95 * gap.std, self.half_width_deg)
        low, high = value - half, value + half
        if not self.bounded:
            significant = gap.significant and abs(value) >= SIGNIFICANT * std
            reason = gap.reason if significant == gap.significant else _BELOW
            return replace(
                gap, std=std, low95=low, high95=high, significant=significant, reason=reason
            )
        if high > 0:
            low, value = max(low, 0.0), max(value, 0.0)
        return replace(
            gap,
            value=value,
            std=std,
            low95=low,
            high95=high,
            significant=low > 0,
            reason=_TOGETHER,
        )

    def draws(self, gap: Float[np.ndarray, " n"], seed: int) -> Float[np.ndarray, " n"]:
        """Return one draw of this gap, rad, for each draw of the fitted gap, rad.

        If this gap is `bounded`, a sum of both below zero becomes zero: the intervals of the sum
        then begin at zero, as that of the fit does.
        """
        rng = np.random.default_rng([seed, len(gap)])
        half = self.half_width_deg * DEG
        if not self.bounded:
            return rng.normal(0.0, self.std_deg * DEG, len(gap))
        return np.maximum(rng.uniform(-half, half, len(gap)), -np.maximum(gap, 0.0))


def gap_of_delay(delay: Delay, identifiable: Identifiability) -> GapOfDelay | None:
    """Return the gap that the delay of a fit may add to the fitted gap.

    The result is None for one flank, and if the delay is fitted, given or left out by the user.
    """
    segments = [s for own in identifiable.segments for s in own]
    if len(identifiable.flanks) < 2 or not segments:
        return None
    if delay.bound_s:
        fastest = max(abs(s.speed) for s in segments)
        bound = 2 * abs(float(identifiable.terms.ratio)) * fastest * delay.bound_s
        return GapOfDelay(half_width_deg=bound / DEG, bounded=True)
    if late_s := delay.neglected_s(steady=one_speed(segments)):
        half = late_s * identifiable.gap_of_delay
        return GapOfDelay(half_width_deg=half / DEG, bounded=False)
    return None


def allowing_for(
    of_delay: GapOfDelay | None, parameters: Mapping[str, Parameter]
) -> dict[str, Parameter]:
    """Return the parameters with an interval of the constant backlash that contains this gap."""
    name = "constant_backlash_deg"
    wider = {} if of_delay is None else {name: of_delay.widened(parameters[name])}
    return {**parameters, **wider}
