"""Recognition of the two shafts: from the names first, then from the given ratio."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import permutations

import numpy as np
from jaxtyping import Float

from ..channel.unwrap import find_modulus, unwrap
from . import question
from .candidates import Candidate

TOLERANCE = 0.005
"""Largest relative deviation of the slope of two columns from the given ratio (chosen)."""

APART = 0.05
"""Largest rms deviation of the driven column from a straight line over the driving one, as a
fraction of its travel (chosen)."""

MOST_ROWS = 20_000
"""Columns with more than about this number of rows are thinned for the slope (chosen)."""

_COPY = 1e-9
"""Two columns are one reading in two units if they differ by at most this fraction of their largest
value (chosen). The errors of real gears are larger."""


@dataclass(frozen=True)
class Scale:
    """Functions that convert the readings of columns to revolutions at common instants.

    `per_turn` returns the readings per revolution of a column in a role; it returns None if the
    unit is unknown, and raises `LogError` if counts per revolution are missing. `common` returns
    the readings of two columns at common instants.
    """

    per_turn: Callable[[Candidate, str], float | None]
    common: Callable[[Candidate, Candidate], tuple[np.ndarray, np.ndarray]]


def by_name(role: str, candidates: Sequence[Candidate], source: str) -> Candidate | None:
    """Return the column whose name contains the role `role`, or None if there is no such name.

    **Raises** `LogError` for several such columns, or if the only one is a setpoint.
    """
    named = [one for one in candidates if one.reading.role == role and one.reading.is_angle]
    if len(named) > 1:
        named = [one for one in named if one.turns] or named
    if len(named) > 1:
        raise question.several(role, named, source)
    if named and named[0].reading.setpoint:
        raise question.only_setpoint(role, named[0], source)
    return named[0] if named else None


def by_ratio(
    fixed: dict[str, Candidate],
    candidates: Sequence[Candidate],
    ratio: Fraction | None,
    scale: Scale,
    source: str,
) -> dict[str, Candidate]:
    """Return role → column for both shafts, from the given ratio of driven to driving speed.

    `fixed` is role → column for the shafts that are already known. Exactly one assignment of the
    other columns must have |slope of the driven over the driving angle| = ratio.

    **Raises** `LogError` if no assignment or several have this slope, for columns without a unit,
    and for shafts whose readings have opposite directions.
    """
    missing = [role for role in ("driving", "driven") if role not in fixed]
    turning = [one for one in candidates if one.turns and one.reading.is_angle]
    listed = [*turning, *(one for one in candidates if one.is_constant)]
    free = [one for one in turning if one.reading.role is None]
    # A second column with the name of a known shaft, such as `Input 2` beside `Input 1`.
    free += [one for one in turning if one.reading.role in fixed and not one.reading.setpoint]
    if ratio is None or len(free) < len(missing):
        others = [one for one in candidates if one.turns and one.reading.other]
        raise question.no_fit(missing, listed, ratio, source, others)
    pairs, signs, unknown = fitting_pairs(fixed, free, ratio, scale)
    if unknown:
        role, one = unknown[0]
        raise question.no_unit(role, one, source)
    if not pairs:
        raise question.no_fit(missing, listed, ratio, source)
    if ratio == 1:  # at another ratio two shafts of a simulation may be as exact as a copy
        apart = [k for k, (one, other) in enumerate(pairs) if not is_copy(one, other)]
        if apart:
            pairs, signs = [pairs[k] for k in apart], [signs[k] for k in apart]
    if len(pairs) > 1:
        raise question.two_fits(pairs, source)
    if signs[0] < 0:
        driving, driven = pairs[0]
        raise question.inverted(driving, driven, source)
    return dict(zip(("driving", "driven"), pairs[0], strict=True))


def fitting_pairs(
    fixed: dict[str, Candidate], free: Sequence[Candidate], ratio: Fraction, scale: Scale
) -> tuple[list[tuple[Candidate, Candidate]], list[int], list[tuple[str, Candidate]]]:
    """Return the pairs (driving, driven) of columns that have the given ratio, and their signs.

    `fixed` is role → column of known shafts, `free` are the columns for the others. The third
    result has a role and its column for every pair without a unit.
    """
    missing = [role for role in ("driving", "driven") if role not in fixed]
    unknown: list[tuple[str, Candidate]] = []
    pairs, signs = [], []
    for chosen in permutations(free, len(missing)):
        roles = {**fixed, **dict(zip(missing, chosen, strict=True))}
        per_turn = {role: scale.per_turn(one, role) for role, one in roles.items()}
        lacking = [role for role, size in per_turn.items() if size is None]
        if lacking:
            unknown.append((lacking[0], roles[lacking[0]]))
            continue
        driving, driven = scale.common(roles["driving"], roles["driven"])
        if len(driving) < 2:
            continue  # the two channels have no common time
        sign = have_slope(
            turns_of(driving, per_turn["driving"]),
            turns_of(driven, per_turn["driven"]),
            float(ratio),
        )
        if sign:
            pairs.append((roles["driving"], roles["driven"]))
            signs.append(sign)
    return pairs, signs, unknown


def is_copy(one: Candidate, other: Candidate) -> bool:
    """Return whether two columns hold the same reading, in two units or with another zero."""
    if one.values is None or other.values is None or len(one.values) != len(other.values):
        return False
    x, y = (values - values.mean() for values in (one.values, other.values))
    rest = y - float(x @ y / (x @ x)) * x
    return float(np.abs(rest).max()) <= _COPY * float(np.abs(y).max())


def turns_of(values: np.ndarray, per_turn: float | None) -> Float[np.ndarray, " n"]:
    """Return the readings in revolutions, unwrapped and minus the first one.

    `per_turn` is the number of readings per revolution, negative for an inverted encoder.
    """
    assert per_turn is not None  # columns without a unit are asked for before
    if np.issubdtype(values.dtype, np.floating) and np.all(values == np.rint(values)):
        values = values.astype(np.int64)
    modulus = find_modulus(values, abs(per_turn))
    if modulus is not None:
        values = unwrap(values, modulus)
    return (values - values[0]) / per_turn


def have_slope(x: Float[np.ndarray, " n"], y: Float[np.ndarray, " n"], ratio: float) -> int:
    """Return the sign of the slope of `y` over `x` if its magnitude is `ratio`, else 0.

    `x` and `y` are angles in revolutions; the tolerances are `TOLERANCE` and `APART`.
    """
    thin = slice(None, None, max(1, len(x) // MOST_ROWS))
    x, y = x[thin] - x[thin].mean(), y[thin] - y[thin].mean()
    slope = float(x @ y / (x @ x))
    apart = float(np.std(y - slope * x)) > APART * float(np.ptp(y))
    if apart or abs(abs(slope) / ratio - 1) > TOLERANCE:
        return 0
    return 1 if slope > 0 else -1
