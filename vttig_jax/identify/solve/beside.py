"""Standard errors of a fit, increased by a comparison with a second fit of the same logs."""

from collections.abc import Collection
from dataclasses import dataclass, replace

import numpy as np

from ...base.units import ARCSEC
from .solved_fit import SolvedFit

_OF_LEVEL = np.sqrt(0.5)
"""Standard deviation of the step of the drift from knot to knot, relative to that of the step of a
coefficient. At a knot the drift is (1, 4, 1)/6 of three neighbouring coefficients."""


@dataclass(frozen=True, eq=False)
class Walk:
    """Second fit of the same logs, with a random walk as drift.

    **Arguments**
    - `solved`: parameters of this second fit.
    - `widening`: largest factor by which it increases a standard error of the first fit.
    """

    solved: SolvedFit
    widening: float

    @property
    def knots_s(self) -> float:
        """Time of one step of the walk, s."""
        return self.solved.linear.model.drift.knots_s

    @property
    def step_arcsec(self) -> float:
        """Standard deviation of the change of the level from knot to knot, arcsec."""
        noise, drift = self.solved.noise, self.solved.linear.model.drift
        step = noise.innovation_std / (drift.stiffness * np.linalg.norm(noise.filter))
        return float(_OF_LEVEL * step) / ARCSEC


def beside_walk(solved: SolvedFit, other: SolvedFit) -> tuple[SolvedFit, Walk]:
    """Return `beside` for a fit `other` whose drift is a random walk, with a record of it."""
    wider, factor = beside(solved, other)
    return wider, Walk(other, factor)


def beside(
    solved: SolvedFit, other: SolvedFit, *, without: Collection[str] = ()
) -> tuple[SolvedFit, float]:
    """Increase the standard errors of `solved` by its difference from the fit `other`.

    With the difference d of both estimates of a parameter and the standard error s of the second,
    the standard error of the first is at least √(s² + d²). Parameters in `without` are not
    compared, because they mean something else in the second fit.

    **Returns** `solved` with the increased covariance, and the largest factor of a standard error.
    """
    solution, second = solved.solution, other.solution
    std, factor = np.sqrt(np.diag(solution.covariance)), np.ones(len(solution.names))
    for place, name in enumerate(solution.names):
        if name in second.names and name not in without and std[place] > 0:
            twin = second.names.index(name)
            away = float(solution.values[place] - second.values[twin])
            apart = np.hypot(away, np.sqrt(second.covariance[twin, twin]))
            factor[place] = max(float(apart / std[place]), 1.0)
    covariance = solution.covariance * np.outer(factor, factor)
    wider = replace(solved, solution=replace(solution, covariance=covariance))
    return wider, float(factor.max(initial=1.0))
