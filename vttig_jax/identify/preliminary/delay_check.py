"""Bound of a delay that a log does not tell, and check that a fitted one explains the log."""

from collections.abc import Sequence

import numpy as np

from ..noise.noise_model import whiten
from ..settings import FitSettings
from .delay import Delay
from .linear_fit import Input, LinearFit
from .robust import Reweighted

_MORE = 1.05
"""Residual with a delay over that without it, above which it does not explain the log (chosen)."""

_WORSE = "the delay that resembles the slow errors of the log leaves a larger residual than none"


def explaining(delay: Delay, weights: Reweighted, linear: LinearFit, *, bound_s: float) -> Delay:
    """Return the delay, or an open one if it is several samples and leaves more than none does.

    In a run-up the speed grows like the drift. Neither is then known beside the other, and the
    steps of the delay may run away to one that no column explains.

    **Arguments**
    - `linear`: fit at the shift of the delay.
    - `bound_s`: largest delay that is not looked at, and bound of an open one, s.
    """
    if delay.state != "fitted" or abs(delay.seconds) <= bound_s:
        return delay
    without = weights.look(linear.inputs, linear.model, 0.0, linear.block_s)
    left, before = (whiten(one.summary)[0].std for one in (linear, without))
    return delay if left <= _MORE * before else Delay("open", reason=_WORSE, within_s=bound_s)


def delay_bound_s(inputs: Sequence[Input], settings: FitSettings) -> float:
    """Return the bound of a delay that the logs do not tell: a sampling interval unless given."""
    if settings.delay_within_ms is not None:
        return 1e-3 * settings.delay_within_ms
    return max(float(np.median(np.diff(one.log.time))) for one in inputs)
