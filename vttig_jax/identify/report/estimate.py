"""Parameters of a fit with the tests that set their standard errors."""

from dataclasses import dataclass

from ..preliminary.delay_change import DelayChange
from ..preliminary.delays_of_logs import DelaysOfLogs
from ..solve.beside_walk import Walk
from ..solve.frozen_levels import FrozenLevels
from ..solve.sandwich import Scatter
from ..solve.solved_fit import SolvedFit
from .checks import GapAtSpeed, ReadingsComparison, Whiteness


@dataclass(frozen=True, eq=False)
class Estimate:
    """Solution of a fit with its final standard errors, and the records of what changed them.

    **Arguments**
    - `solved`: parameters, and the logs and the noise from which they were estimated.
    - `whiteness`: test of the whitened residual; None for rounding and for too few rows.
    - `scatter`: parts of the log whose scatter gives the standard errors; None if the noise model
      gives them.
    - `readings`: comparison with backlash readings; None without readings.
    - `change`: change of the delay within a log; None if no delay is fitted or no half tells it.
    - `delays`: delays of several logs; None if no delay is fitted or fewer than two logs tell it.
    - `walk`: fit with a random walk as drift; None if the log does not demand it.
    - `frozen`: rounding that does not average out; None where it does.
    - `gap_deviations`: by how much the gap at the speeds of the log exceeds that of the fit.
    - `least_gap_std`: standard error of the gap, rad, that these deviations demand at least.
    """

    solved: SolvedFit
    whiteness: Whiteness | None
    scatter: Scatter | None
    readings: ReadingsComparison | None
    change: DelayChange | None
    delays: DelaysOfLogs | None
    walk: Walk | None = None
    frozen: FrozenLevels | None = None
    gap_deviations: tuple[GapAtSpeed, ...] = ()
    least_gap_std: float = 0.0
