"""Check of the shafts that column names say, against the motion of all columns."""

from collections.abc import Mapping, Sequence
from fractions import Fraction

import numpy as np

from . import question
from .candidates import Candidate
from .shafts import Scale, fitting_pairs

_STRETCHES = 200
"""Number of stretches of a log over which travel and mean speed are compared (chosen)."""

_SPEED = 0.999
"""Least correlation of the travel of a column over each stretch with the mean of another column
there, if the other one is its speed (chosen)."""


def check_names(
    named: Mapping[str, Candidate],
    others: Sequence[Candidate],
    ratio: Fraction | None,
    scale: Scale,
    source: str,
) -> None:
    """Check the columns that names make the shafts; `named` is role → column of both shafts.

    `others` are the columns without a role, and `ratio` is driven over driving speed, if it is
    given.

    **Raises** `LogError` if a named column without a unit is the speed of another column, or if the
    named columns do not turn as given although two other columns do.
    """
    others = [one for one in others if one.turns and one.reading.is_angle]
    for role, one in named.items():
        for other in others:
            if one.reading.unit is None and is_speed_of(one, other):
                raise question.named_speed(role, one, other, source)
    if ratio is None or not all(one.turns for one in named.values()):
        return
    fitting, _, unknown = fitting_pairs(dict(named), (), ratio, scale)
    if fitting or unknown:
        return
    measured = [one for one in others if not one.reading.setpoint]
    turning, _, _ = fitting_pairs({}, measured, ratio, scale)
    if turning:
        raise question.names_against_ratio(named, turning[0], ratio, source)


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
