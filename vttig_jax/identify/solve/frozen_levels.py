"""Rounding errors that are constant in a run because of its motion, and shift the level of the run.

If the rounding error of a run is a constant with the standard deviation q, the covariance of the
parameters increases by q² a aᵀ, where a is the change of the parameters if the TE of this run
increases by 1 rad. The contributions of all runs add up. If runs share one error, their a add up
instead, so that a gap, which is a difference of runs, does not change. With two speeds the delay
extrapolates the levels of the runs, so that the error of the gap is several times larger than q.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from scipy.linalg import block_diag

from ...base.units import ARCSEC
from ...logs.checks.frozen_rounding import frozen_rounding
from .sandwich import Functional, changes_by_constants
from .solved_fit import SolvedFit


@dataclass(frozen=True, eq=False)
class FrozenLevels:
    """Rounding errors that are constant in a run.

    **Arguments**
    - `stds`: standard deviation of the independent constant error of every run, rad of the driven
      shaft; 0 if the rounding averages out.
    - `shared`: standard deviations of errors that runs have in common, one row for each error.
    """

    stds: Float[np.ndarray, " runs"]
    shared: Float[np.ndarray, "errors runs"]

    def covariance(self, solved: SolvedFit, functional: Functional) -> Float[np.ndarray, "k k"]:
        """Return the covariance of functions of the fit that these errors cause."""
        moved = changes_by_constants(solved, functional)
        own, together = self.stds[:, None] * moved, self.shared @ moved
        return own.T @ own + together.T @ together

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

    **Returns** the solution, and the record of these errors; None if all rounding averages out or
    moves the zero of the angles only.
    """
    logs = [one.log for one in solved.linear.inputs]
    runs = [[run.segment for of, run, _ in solved.runs if of == log] for log in range(len(logs))]
    rounding = [frozen_rounding(log, own) for log, own in zip(logs, runs, strict=True)]
    stds = np.concatenate([one.stds for one in rounding])
    shared = np.asarray(block_diag(*[one.shared for one in rounding]))
    if not (np.any(stds) or np.any(shared)):
        return solved, None
    solution, found = solved.solution, FrozenLevels(stds, shared)
    own = found.covariance(solved, Functional(np.eye(len(solution.names))))
    wider = replace(solution, covariance=solution.covariance + own)
    return replace(solved, solution=wider), found if np.any(stds) else None
