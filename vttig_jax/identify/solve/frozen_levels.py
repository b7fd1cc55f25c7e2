"""Rounding errors that are constant in a run because of its motion, and shift the level of the run.

If the rounding error of a run is a constant with the standard deviation q, the covariance of the
parameters increases by q² a aᵀ, where a is the change of the parameters if the TE of this run
increases by 1 rad. The contributions of all runs add up. With two speeds the delay extrapolates the
levels of the runs, so that the error of the gap is several times larger than q.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from ...base.units import ARCSEC
from ...logs.checks.frozen_rounding import frozen_stds
from .sandwich import Functional, changes_by_constants
from .solved_fit import SolvedFit


@dataclass(frozen=True, eq=False)
class FrozenLevels:
    """Rounding errors that are constant in a run.

    **Arguments**
    - `stds`: standard deviation of the constant error of every run, rad of the driven shaft; 0 if
      the rounding averages out.
    """

    stds: Float[np.ndarray, " runs"]

    def covariance(self, solved: SolvedFit, functional: Functional) -> Float[np.ndarray, "k k"]:
        """Return the covariance of functions of the fit that these errors cause."""
        moved = changes_by_constants(solved, functional)
        return (moved * self.stds[:, None] ** 2).T @ moved

    @property
    def sentence(self) -> str:
        """Sentence that reports the rounding errors, and says how to avoid them."""
        count, total = int(np.count_nonzero(self.stds)), len(self.stds)
        some = "all" if count == total else f"{count} of {total}"
        return (
            f"the rounding of the readings may not average out in {some} runs: each sample is the"
            " same number of steps after the one before, or the readings have two clocks. The level"
            f" of such a run is known to {self.stds.max() / ARCSEC:.2g}″ only, however long it"
            " is, and the intervals contain that; a speed that is no round number, or both"
            " readings in one row, cures it"
        )


def with_frozen_levels(solved: SolvedFit) -> tuple[SolvedFit, FrozenLevels | None]:
    """Add the effect of constant rounding errors of the runs to the covariance of the parameters.

    **Returns** the solution, and the record of these errors; None if all rounding averages out.
    """
    logs = [one.log for one in solved.linear.inputs]
    runs = [[run.segment for of, run, _ in solved.runs if of == log] for log in range(len(logs))]
    stds = np.concatenate([frozen_stds(log, own) for log, own in zip(logs, runs, strict=True)])
    if not np.any(stds > 0):
        return solved, None
    solution, found = solved.solution, FrozenLevels(stds)
    own = found.covariance(solved, Functional(np.eye(len(solution.names))))
    wider = replace(solution, covariance=solution.covariance + own)
    return replace(solved, solution=wider), found
