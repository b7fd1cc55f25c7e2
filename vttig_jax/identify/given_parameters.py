"""Parameters of a given flank model in the result of a fit."""

from dataclasses import replace

import numpy as np

from .compress.orthogonal import EMPTY
from .model.given_model import GivenModel
from .model.identifiability import Identifiability
from .report.parameters import (
    BELOW,
    GIVEN_INSTEAD,
    SHAFTS,
    SIGNIFICANT,
    Parameter,
    interval_of,
    undetermined,
)
from .solve.solved_fit import SolvedFit

_UNIT = "as given"
"""Unit that is shown for a parameter of a given flank model; the model does not state the unit."""


_GAP = "constant_backlash_deg"
_BESIDE = "negative: it is the part of the gap beside that of the flank model"


def without_relation(identifiable: Identifiability) -> Identifiability:
    """Return the identifiability with the reason why eccentricities and encoders are not fitted."""
    return replace(identifiable, reasons=dict.fromkeys(SHAFTS, GIVEN_INSTEAD))


def with_given(
    parameters: dict[str, Parameter], solved: SolvedFit, given: GivenModel
) -> dict[str, Parameter]:
    """Return the parameters of a fit with those of its flank model, `given`, under their names.

    The constant backlash may be negative, because the flank model may contain a gap itself.
    """
    solution, found = solved.solution, dict(parameters)
    gap = parameters[_GAP]
    if gap.value is not None and gap.value < 0:
        found[_GAP] = replace(gap, reason=_BESIDE)
    for name in given.names:
        place = solution.names.index(name) if name in solution.names else None
        if place is None or not solution.determined[place]:
            start = float(given.values[given.names.index(name)])
            found[name] = undetermined(name, _UNIT, _open_reason(solved, name, start))
            continue
        value = float(solution.values[place])
        std = float(np.sqrt(solution.covariance[place, place]))
        one = interval_of(name, _UNIT, value, std)
        small = abs(value) < SIGNIFICANT * std
        found[name] = replace(one, significant=False, reason=BELOW) if small else one
    return found


def _open_reason(solved: SolvedFit, name: str, start: float) -> str:
    """Return why the logs do not determine a parameter; `start` is its unchanged start value."""
    solution, own = solved.solution, solved.linear.own
    if own.raw[own.names.index(name)] <= EMPTY:
        return f"no sample depends on it; it stays at {start:.6g}"
    others = [
        other
        for other, good in zip(solution.names, solution.determined, strict=True)
        if not good and other != name
    ]
    if name in solution.names and others:
        return "the data leave it open: it cannot be told from " + ", ".join(others)
    return (
        "offset, constant backlash or the free orders of the fit explain it as well; it stays at"
        f" {start:.6g}"
    )
