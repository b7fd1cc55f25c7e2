"""Parameters of a fit with the tests that set their standard errors."""

from dataclasses import dataclass

from ..solve.solved_fit import SolvedFit
from .checks import ReadingsComparison, Whiteness
from .per_log import DelayChange


@dataclass(frozen=True, eq=False)
class Estimate:
    """Solution of a fit with its final standard errors, and the records of what changed them.

    **Arguments**
    - `solved`: parameters, and the logs and the noise from which they were estimated.
    - `whiteness`: test of the whitened residual; None for rounding and for too few rows.
    - `readings`: comparison with backlash readings; None without readings.
    - `change`: change of the delay within a log; None if no delay is fitted or no half tells it.
    """

    solved: SolvedFit
    whiteness: Whiteness | None
    readings: ReadingsComparison | None
    change: DelayChange | None
