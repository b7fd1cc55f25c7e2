"""Delays of several logs of one rig, which share one delay in the fit.

After a restart of the logger the delay may be different. With the delays dₖ ± sₖ of n logs and
their weighted mean d̄, the statistic Σ (dₖ − d̄)²/sₖ² tests whether the delays differ. The variance
τ² between the logs is estimated by the method of R. DerSimonian and N. Laird, Control. Clin. Trials
7 (1986) 177:

    τ² = max(0, (Σ wₖ (dₖ − d̄)² − (n − 1)) / (Σ wₖ − Σ wₖ² / Σ wₖ)),    wₖ = 1/sₖ².

The mean delay of the logs has the variance 1/Σ 1/(sₖ² + τ²).
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float
from scipy.special import chdtrc

from .delay_change import delay_of
from .linear_fit import LinearFit

_UNLIKELY = 1e-3  # the delays differ if equal delays scatter so much with less probability (chosen)


@dataclass(frozen=True, eq=False)
class DelaysOfLogs:
    """Delays of the logs that determine a delay.

    **Arguments**
    - `logs`: numbers of these logs; the first log of the fit has the number 1.
    - `value`, `std`: delay of each log, and its standard error from the noise of the log, s.
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
        """Standard deviation τ of the true delays between the logs, s."""
        weight = 1 / self.std**2
        scale = float(weight.sum() - np.sum(weight**2) / weight.sum())
        return float(np.sqrt(max(self._misfit - (len(weight) - 1), 0.0) / scale))

    @property
    def mean_std_s(self) -> float:
        """Standard error of the mean delay of the logs, s."""
        return float(1 / np.sqrt(np.sum(1 / (self.std**2 + self.between_s**2))))

    def farthest_s(self, value: float) -> float:
        """Return the largest absolute difference between the delay of a log and `value`, s."""
        return float(np.max(np.abs(self.value - value)))

    @property
    def sentence(self) -> str:
        """Sentence of the report if the delays of the logs differ."""
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
    """Return the delay of every log, estimated from this log alone.

    The result is None if fewer than two logs determine a delay.
    """
    found = []
    for number, (rows, one) in enumerate(zip(linear.rows, linear.channels, strict=True), 1):
        step = delay_of(linear, rows, [True] * len(rows.runs))
        if step is not None:
            found.append((number, one.delay_s + step[0], step[1]))
    if len(found) < 2:
        return None
    numbers, value, std = zip(*found, strict=True)
    return DelaysOfLogs(numbers, np.array(value), np.array(std))
