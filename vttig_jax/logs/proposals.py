"""Commands that fit a log whose names and options leave open which column is which shaft.

The slope of two columns is the ratio of the shafts, so that a command states it. Which of the two
drives the other is known only to the user: each pair of columns has two commands.
"""

from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path

import numpy as np

from ..base.errors import VttigError
from ..base.units import REV
from .checks.fractions import ratio_option
from .checks.slope import slope
from .recognition.candidates import Candidate
from .recognition.command import fit_command
from .recognition.recognise import Search
from .recognition.request import SHAFTS, DriveRequest, in_words
from .recognition.shafts import APART, MOST_ROWS, is_copy, turns_of

_EQUAL = 1e-6
"""Least relative deviation of a ratio from 1 for two shafts that follow each other exactly, as in a
simulation; at a smaller one the columns are one reading in two units (chosen)."""

_MOST_COLUMNS = 8
"""Among more columns that can be a shaft no pairs are compared, only listed (chosen)."""


@dataclass(frozen=True)
class Proposal:
    """Command that fits the log if `condition` is true, such as "the motor drives the load"."""

    condition: str
    command: str


def with_ratio(request: DriveRequest, seen: tuple[float, float]) -> DriveRequest:
    """Return `request` with the likeliest text of the ratio `seen` (value, standard error).

    If the readings of the shafts have opposite directions, the driven encoder is inverted.
    """
    request = request if seen[0] > 0 else request.with_driven_inverted()
    return replace(request, ratio=ratio_option(abs(seen[0]), seen[1]))


def proposals(
    search: Search,
    path: str | Path,
    *,
    decimal: str | None = None,
    sample_rate_hz: int | float | None = None,
) -> tuple[Proposal, ...]:
    """Return the commands for both readings of the pairs of columns that turn together.

    `search` is a finished search without a ratio; `decimal` and `sample_rate_hz` as in
    `fit_command`. A command that would end in another question, for example for the time, is left
    out. One reading in two units is no pair, unless there is no other. Pairs of which a name tells
    a shaft come first, then those whose ratio is known best; of the two readings of a pair, the one
    with the faster driving shaft.
    """
    found: list[tuple[tuple[bool, float], list[Proposal]]] = []
    copies: list[Proposal] = []
    keywords = {"decimal": decimal, "sample_rate_hz": sample_rate_hz}
    for pair in _pairs(search):
        slopes = [(_slope(search, *order), order) for order in (pair, pair[::-1])]
        known = [(seen, order) for seen, order in slopes if seen is not None and _fit(*order)]
        commands: list[Proposal] = []
        for seen, (driving, driven) in sorted(known, key=lambda one: abs(one[0][0])):
            request = with_ratio(search.request, seen)
            chosen = {"driving": driving, "driven": driven}
            if (names := _complete(search, request, chosen, sample_rate_hz is None)) is None:
                continue
            drives = f"`{driving.name}` drives `{driven.name}`"
            command = fit_command(path, request, names, **keywords)
            commands.append(Proposal(f"{drives}: {in_words(request.speed_ratio)}", command))
        if is_copy(*pair) and all(abs(abs(seen[0]) - 1) < _EQUAL for seen, _ in known):
            copies += commands
            continue
        unnamed = not any(one.reading.role for one in pair)
        share = min((std / abs(value) for (value, std), _ in known), default=0.0)
        found.append(((unnamed, share), commands))
    ordered = [one for _, own in sorted(found, key=lambda one: one[0]) for one in own]
    return tuple(ordered or copies)


def _fit(driving: Candidate, driven: Candidate) -> bool:
    """Return whether the names of two columns allow these roles."""
    return driving.reading.role != "driven" and driven.reading.role != "driving"


def _complete(
    search: Search, request: DriveRequest, chosen: dict[str, Candidate], timed: bool
) -> dict[str, str] | None:
    """Return role → name of the columns of a complete command, or None if a question stays open.

    It is None, too, if an option or a name gives one of the roles to another column.
    """
    if any(search.roles.get(role, one.index) != one.index for role, one in chosen.items()):
        return None
    names = {role: search.name_of(one.index) for role, one in chosen.items()}
    trial = search.assuming(names, request)
    trial.take_stated(timed=timed)
    return None if trial.questions(timed=timed) else trial.column_names


def _pairs(search: Search) -> list[tuple[Candidate, Candidate]]:
    """Return the pairs of columns that can be the two shafts; a shaft with a role stays in all.

    There are none if more than `_MOST_COLUMNS` columns can be a shaft.
    """
    free = [one for one in search.free() if one.turns and one.reading.is_angle]
    fixed = [search.candidate(search.roles[role]) for role in SHAFTS if role in search.roles]
    if len(free) > _MOST_COLUMNS or "transmission_error" in search.roles:
        return []
    if len(fixed) == 1:
        return [(fixed[0], one) for one in free] if fixed[0].turns else []
    return list(combinations(free, 2))


def _slope(search: Search, first: Candidate, second: Candidate) -> tuple[float, float] | None:
    """Return the slope of `second` over `first` in turns, and its standard error.

    It is None if the columns do not turn together, and for unknown units and counts.
    """
    sizes = []
    for one, role in ((first, "driving"), (second, "driven")):
        try:
            sizes.append(search.per_turn(one, role))
        except VttigError:
            return None
    readings = search.common(first, second)
    if len(readings[0]) < 2 or None in sizes:
        return None
    thin = slice(None, None, max(1, len(readings[0]) // MOST_ROWS))
    x, y = (turns_of(one, size)[thin] * REV for one, size in zip(readings, sizes, strict=True))
    if min(float(np.ptp(x)), float(np.ptp(y))) == 0:
        return None
    value, std = slope(x, y)
    apart = float(np.std(y - value * x)) > APART * float(np.ptp(y))
    return None if apart or value == 0 else (value, std)
