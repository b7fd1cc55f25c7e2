"""Check of the shafts that column names say, against the motion of all columns."""

from collections.abc import Collection, Mapping, Sequence
from fractions import Fraction

import numpy as np

from ...base.errors import LogError
from . import question
from .candidates import Candidate
from .shafts import Scale, fitting_pairs, have_slope, is_copy, turns_of

_STRETCHES = 200
"""Number of stretches of a log over which travel and mean speed are compared (chosen)."""

_SPEED = 0.999
"""Least correlation of the travel of a column over each stretch with the mean of another column
there, if the other one is its speed (chosen)."""


def check_names(
    named: Mapping[str, Candidate],
    guessed: Collection[str],
    others: Sequence[Candidate],
    ratio: Fraction | None,
    *,
    scale: Scale,
    source: str,
) -> None:
    """Check the columns that names make the shafts.

    `named` is role → column of both shafts, and `guessed` are the roles that no user stated.
    `others` are the columns without a role, and `ratio` is driven over driving speed, if it is
    given.

    **Raises** `LogError` if a named column without a unit is the speed of another column, if
    another column holds nearly the same angle, as a setpoint and a measured angle do, or if the
    named columns do not turn as given although two other columns do. Columns that the user stated
    for both shafts are taken.
    """
    others = [one for one in others if one.turns and one.reading.is_angle]
    for role, one in named.items():
        if role not in guessed:
            continue
        for other in others:
            if one.reading.unit is None and is_speed_of(one, other):
                raise question.named_speed(role, one, other, source)
        twin = next((other for other in others if _is_twin(one, other, role, scale)), None)
        if twin is not None:
            raise question.twins(role, one, twin, source)
    by_name = named.keys() & set(guessed)
    if ratio is None or not by_name or not all(one.turns for one in named.values()):
        return
    fitting, _, unknown = fitting_pairs(dict(named), (), ratio, scale)
    if fitting or unknown:
        return
    measured = [one for one in others if not one.reading.setpoint]
    turning, _, _ = fitting_pairs({}, measured, ratio, scale)
    if turning:
        raise question.names_against_ratio(named, turning[0], ratio, source)


def _is_twin(one: Candidate, other: Candidate, role: str, scale: Scale) -> bool:
    """Return whether two columns hold nearly the same angle, but are no copies of one reading."""
    if other.reading.setpoint or is_copy(one, other):
        return False
    try:
        per_turn = [scale.per_turn(column, role) for column in (one, other)]
    except LogError:  # counts per revolution are missing
        return False
    if None in per_turn or not one.turns:
        return False
    first, second = scale.common(one, other)
    if len(first) < 2:
        return False
    return have_slope(turns_of(first, per_turn[0]), turns_of(second, per_turn[1]), 1.0) > 0


def is_speed_of(one: Candidate, other: Candidate) -> bool:
    """Return whether a column is the speed of another column of the same, even rows.

    The mean of a speed over a stretch of the log is proportional to the travel over it.
    """
    if not one.turns or not other.turns:
        return False
    assert one.values is not None and other.values is not None  # columns that turn have values
    if len(one.values) != len(other.values):
        return False
    edges = np.unique(np.linspace(0, len(one.values) - 1, _STRETCHES + 1).astype(np.int64))
    if len(edges) < 4:
        return False
    travel = np.diff(other.values[edges].astype(np.float64))
    sums = np.concatenate([[0.0], np.cumsum(one.values, dtype=np.float64)])
    mean = np.diff(sums[edges]) / np.diff(edges)
    if np.ptp(travel) == 0 or np.ptp(mean) == 0:
        return False
    return abs(float(np.corrcoef(travel, mean)[0, 1])) >= _SPEED
