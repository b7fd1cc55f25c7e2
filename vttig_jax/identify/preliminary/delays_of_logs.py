"""Delays of several logs of one rig, which share one delay in the fit.

A logger that is started anew may have another delay. With the delay dₖ ± sₖ of each of n logs, the
statistic Σ (dₖ − d̄)²/sₖ² tells whether they differ, and the variance τ² between the logs is that
of R. DerSimonian and N. Laird, Control. Clin. Trials 7 (1986) 177:

    τ² = max(0, (Σ wₖ (dₖ − d̄)² − (n − 1)) / (Σ wₖ − Σ wₖ² / Σ wₖ)),    wₖ = 1/sₖ².

The mean of the logs has the variance 1/Σ 1/(sₖ² + τ²).
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float
from scipy.special import chdtrc

from .delay_change import delay_of
from .linear_fit import LinearFit

_UNLIKELY = 1e-3  # probability of the scatter of equal delays; chosen value


@dataclass(frozen=True, eq=False)
class DelaysOfLogs:
    """Delay of every log that determines one, and its standard error by the noise, s.

    **Arguments**
    - `logs`: numbers of these logs, from 1.
    """

    logs: tuple[int, ...]
    value: Float[np.ndarray, " n"]
    std: Float[np.ndarray, " n"]

    @cached_property
    def _misfit(self) -> float:
        weight = 1 / self.std**2
        mean = float(weight @ self.value / weight.sum())
        return float(weight @ (self.value - mean) ** 2)

    @property
    def differ(self) -> bool:
        """Whether the delays differ by more than the noise of the logs explains."""
        return len(self.value) > 1 and bool(chdtrc(len(self.value) - 1, self._misfit) < _UNLIKELY)

    @cached_property
    def between_s(self) -> float:
        """Standard deviation τ between the logs, s."""
        weight = 1 / self.std**2
        scale = float(weight.sum() - np.sum(weight**2) / weight.sum())
        return float(np.sqrt(max(self._misfit - (len(weight) - 1), 0.0) / scale))

    @property
    def mean_std_s(self) -> float:
        """Standard error of the mean of the logs, s."""
        return float(1 / np.sqrt(np.sum(1 / (self.std**2 + self.between_s**2))))

    def farthest_s(self, value: float) -> float:
        """Return the largest distance of the delay of a log from `value`, s."""
        return float(np.max(np.abs(self.value - value)))

    @property
    def sentence(self) -> str:
        """Sentence on delays that differ."""
        each = ", ".join(
            f"{1e3 * value:.4g} ± {1e3 * std:.1g} ms (log {number})"
            for number, value, std in zip(self.logs, self.value, self.std, strict=True)
        )
        return (
            f"the delays of the logs differ: {each}. The fit has one delay, and its interval"
            " contains all of them; a gap between the flanks takes a part of the difference, so fit"
            " the logs one by one if the logger was started anew"
        )


def delays_of_logs(linear: LinearFit) -> DelaysOfLogs | None:
    """Return the delay of every log beside harmonics of its own; None unless two logs tell it."""
    found = []
    for number, (rows, one) in enumerate(zip(linear.rows, linear.channels, strict=True), 1):
        step = delay_of(linear, rows, [True] * len(rows.runs))
        if step is not None:
            found.append((number, one.delay_s + step[0], step[1]))
    if len(found) < 2:
        return None
    numbers, value, std = zip(*found, strict=True)
    return DelaysOfLogs(numbers, np.array(value), np.array(std))
