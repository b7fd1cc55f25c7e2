"""Standard errors of a fit whose delay is known less well than the noise model says."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ...base.numerics.quantiles import NORMAL_95
from ..preliminary.delay import Delay
from ..preliminary.delay_blocks import DelayBlocks
from .solved_fit import SolvedFit


def with_uncertain_delay(
    solved: SolvedFit, delay: Delay, blocks: Sequence[DelayBlocks]
) -> SolvedFit:
    """Increase the standard error of the delay, and the errors of other parameters that follow.

    Two things increase it. The smoothed speed, whose coefficient is the delay, may contain noise
    that the shift of the driving angle does not contain: the standard error is divided by
    `delay.share`. And the delays of the `blocks` of a log may scatter. With the covariances c of
    all parameters with the delay, whose variance v grows to w, the covariance matrix grows by
    c cᵀ (w − v)/v².
    """
    if "delay" not in solved.solution.names:
        return solved
    solution = solved.solution
    place = solution.names.index("delay")
    with_delay = solution.covariance[:, place]
    variance = float(with_delay[place])
    step_s = float(solution.values[place])
    wanted = variance / delay.share**2 + _of_scatter(blocks, step_s)
    if not 0 < variance < wanted < np.inf:
        return solved
    more = np.outer(with_delay, with_delay) * (wanted - variance) / variance**2
    return replace(solved, solution=replace(solution, covariance=solution.covariance + more))


def _of_scatter(blocks: Sequence[DelayBlocks], step_s: float) -> float:
    """Return the variance, s², that the scatter of the delays within the logs adds to their mean.

    `step_s` is the correction of the delay that the fit states.
    """
    told = [one for one in blocks if len(one.value)]
    if not any(one.scatters for one in told):
        return 0.0
    weight = np.array([one.common_std_s**-2 for one in told])
    wide = [(one.half_width_s(step_s) / NORMAL_95) ** 2 - one.common_std_s**2 for one in told]
    more = [max(each, 0.0) * one.scatters for each, one in zip(wide, told, strict=True)]
    return float(weight**2 @ np.array(more) / weight.sum() ** 2)
