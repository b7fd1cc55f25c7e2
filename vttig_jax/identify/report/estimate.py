"""Parameters of a fit, with the tests that determine their standard errors."""

from dataclasses import dataclass

from ..preliminary.delay_change import DelayChange
from ..preliminary.delays_of_logs import DelaysOfLogs
from ..solve.beside import Walk
from ..solve.frozen_levels import FrozenLevels
from ..solve.sandwich import Scatter
from ..solve.solved_fit import SolvedFit
from .checks import GapAtSpeed, ReadingsComparison, Whiteness


@dataclass(frozen=True, eq=False)
class Estimate:
    """Solution of a fit with its final standard errors, and the tests that changed them.

    **Arguments**
    - `solved`: parameters, and the logs and the noise from which they were estimated.
    - `whiteness`: test of the whitened residual; None for a log without noise or too few rows.
    - `scatter`: parts of the log whose scatter gives the standard errors; None if the noise model
      gives them.
    - `readings`: comparison with backlash readings; None without readings.
    - `change`: change of the delay between the halves of a log; None if no delay is fitted or the
      halves do not determine it.
    - `delays`: delay of each log; None if no delay is fitted or fewer than two logs determine it.
    - `walk`: fit with a random walk as drift; None if the log shows no random walk.
    - `two_delays`: fit with another delay in the second half of each log; None if the delay does
      not change.
    - `least_drift`: fit without the powers of the drift that resemble the gap; None if the drift
      has no such powers.
    - `crossed`: gap of each log by its crossings beside a drift that was left out, rad, or none.
    - `rest_of_delay`: delay that the logs show beside the stated one, with its standard error, s;
      None if they show none, or if no delay is stated.
    - `frozen`: rounding of the encoders that does not average out; None if it averages out.
    - `gap_deviations`: gap at several speeds minus the gap of the fit.
    - `least_gap_std`: lower bound of the standard error of the gap, rad, from these deviations.
    """

    solved: SolvedFit
    whiteness: Whiteness | None
    scatter: Scatter | None
    readings: ReadingsComparison | None
    change: DelayChange | None
    delays: DelaysOfLogs | None
    walk: Walk | None = None
    two_delays: SolvedFit | None = None
    least_drift: SolvedFit | None = None
    crossed: tuple[float, ...] = ()
    rest_of_delay: tuple[float, float] | None = None
    frozen: FrozenLevels | None = None
    gap_deviations: tuple[GapAtSpeed, ...] = ()
    least_gap_std: float = 0.0

    @property
    def rivals(self) -> tuple[SolvedFit, ...]:
        """Second fits of the same logs, whose values the intervals of the first contain."""
        of_walk = None if self.walk is None else self.walk.solved
        found = (of_walk, self.two_delays, self.least_drift)
        return tuple(one for one in found if one is not None)
