"""Parameters of a given flank model in the result of a fit."""

from dataclasses import replace

import numpy as np

from ..base.numerics.quantiles import NORMAL_95
from .model.given_model import GivenModel
from .model.identifiability import Identifiability
from .report.parameters import BELOW, GIVEN_INSTEAD, SHAFTS, SIGNIFICANT, Parameter, undetermined
from .solve.solved_fit import SolvedFit

UNIT = "as given"
"""Unit of a parameter of a given flank model, which only its author knows."""

_SHARE = 1e-5
"""Share of the length of a column below which the free orders explain it; between the 1e-10 of a
column without data of its own and the 1e-3 of one that is hardly told apart (chosen)."""


def without_relation(identifiable: Identifiability) -> Identifiability:
    """Return the identifiability with the reason why no eccentricity and no encoder is fitted."""
    return replace(identifiable, reasons=dict.fromkeys(SHAFTS, GIVEN_INSTEAD))


def given_parameters(solved: SolvedFit, given: GivenModel | None) -> dict[str, Parameter]:
    """Return name → parameter of a given flank model, with standard error and 95 % interval.

    Without a given model there are none.
    """
    solution, found = solved.solution, {}
    for name in () if given is None else given.names:
        place = solution.names.index(name)
        if not solution.determined[place]:
            found[name] = undetermined(name, UNIT, _open_reason(solved, name))
            continue
        value, std = (
            float(solution.values[place]),
            float(np.sqrt(solution.covariance[place, place])),
        )
        margin = NORMAL_95 * std
        one = Parameter(
            name=name,
            unit=UNIT,
            value=value,
            std=std,
            low95=value - margin,
            high95=value + margin,
            determined=True,
            significant=True,
        )
        small = abs(value) < SIGNIFICANT * std
        found[name] = replace(one, significant=False, reason=BELOW) if small else one
    return found


def _open_reason(solved: SolvedFit, name: str) -> str:
    """Return why the logs leave a parameter open."""
    column, solution = solved.summary.columns.index(name), solved.solution
    whole, left = (
        sum(float(np.sum(one.factor[rows:, column] ** 2)) for one in solved.whitened)
        for rows in (0, solved.summary.columns.free_width)
    )
    if whole == 0 or left == 0:
        return "the data leave it open: no sample depends on it"
    if left < _SHARE**2 * whole:
        return "the free orders of the fit explain it as well; leave them out of `orders`"
    others = [
        other
        for other, good in zip(solution.names, solution.determined, strict=True)
        if not good and other != name
    ]
    if not others:
        return "the data leave it open: no sample depends on it"
    return "the data leave it open: it cannot be told from " + ", ".join(others)
