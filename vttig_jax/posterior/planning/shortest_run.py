"""The shortest run that reaches wanted standard errors."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

from ...base.errors import NoAnswerError
from ...base.runtime import require_x64
from ...base.threads import one_blas_thread
from ...pair.eccentricities import Eccentricities
from ...pair.gear_pair import Drive, GearPair
from ...pair.schema import HarmonicOrders
from .assumptions import assumed_values
from .noise import PlannedNoise
from .plan import Assumptions, DelayChoice, planned
from .result import Plan
from .run import MOST_SAMPLES, Directions, PlannedRun

MOST_TURNS = 1000.0


@one_blas_thread
def shortest_run(
    pair: GearPair | Drive,
    target: Mapping[str, float],
    *,
    rate_hz: float,
    noise: PlannedNoise,
    most_turns: float = MOST_TURNS,
    speed_rpm: float | Sequence[float] = 60.0,
    directions: Directions = "both",
    passes: int | None = None,
    dwell_s: float = 2.0,
    ramp_s: float = 0.5,
    eccentricities: Eccentricities | None = None,
    assumed: Mapping[str, float] | None = None,
    options: HarmonicOrders | None = None,
    encoder_terms: bool = True,
    delay: DelayChoice = "auto",
) -> Plan:
    """The plan with the fewest whole turns a pass that reaches every wanted standard error.

    More turns never tell less once every first order has turns enough, so the run is lengthened
    until it suffices and then bisected.

    **Arguments**
    - `target`: name of a parameter → wanted standard error in its unit, such as
      `{"driving_eccentricity_mm": 1e-4}`.
    - `most_turns`: upper bound of the search, 1000 by default; never beyond ten million samples.
    - the others as in `plan`.

    **Raises** `NoAnswerError` where no run of this kind reaches it, with the reason.

    **Example**
    ```python
    >>> import vttig_jax
    >>> from vttig_jax.posterior import PlannedNoise
    >>> from vttig_jax.posterior import shortest_run
    >>> from vttig_jax.rig import paper_pair
    >>> vttig_jax.enable_x64()
    >>> noise = PlannedNoise(std_deg=0.002, correlation_s=0.00475)
    >>> wanted = {"driving_eccentricity_mm": 2e-4}
    >>> shortest_run(paper_pair(), wanted, rate_hz=1987.0, noise=noise).run.turns
    15.0

    ```
    """
    require_x64("shortest_run")
    if not target:
        raise ValueError("Argument `target` must name at least one parameter, but is empty.")
    for name, value in target.items():
        if not 0 < value < math.inf:
            raise ValueError(
                f"Argument `target` must hold positive standard errors, but {name} is {value!r}."
            )
    speeds = tuple(speed_rpm) if isinstance(speed_rpm, Sequence) else (speed_rpm,)
    longest = PlannedRun(most_turns, speeds, rate_hz, directions, passes, dwell_s, ramp_s)
    values = assumed_values(pair, eccentricities, assumed)
    assumptions = Assumptions(values, noise, options or pair.fit, encoder_terms, delay)
    return _searched(pair, longest, assumptions, target)


def _searched(
    pair: GearPair | Drive,
    longest: PlannedRun,
    assumptions: Assumptions,
    target: Mapping[str, float],
) -> Plan:
    """Lengthen the run until it is enough, then bisect; std ∝ 1/√turns says where to look."""
    most = _most_turns(longest)
    least = max(1, math.ceil(longest.least_turns))

    def attempt(turns: int) -> Plan | NoAnswerError:
        return _attempt(pair, replace(longest, turns=float(turns)), assumptions, target)

    few, many = least - 1, min(least, most)
    found = attempt(many)
    while not _reached(found, target):
        if many == most:
            raise _unreachable(found, target, longest, most)
        if isinstance(found, Plan):
            _require_possible(found, target)
        few, many = many, min(max(2 * many, _guessed(found, target)), most)
        found = attempt(many)
    best, by_law = found, True
    while many - few > 1:
        middle = _guessed(best, target) if by_law else (few + many) // 2
        middle, by_law = min(max(middle, few + 1), many - 1), not by_law
        found = attempt(middle)
        if _reached(found, target):
            best, many = found, middle
        else:
            few = middle
    assert isinstance(best, Plan)  # `_reached` holds for no other
    return best


def _guessed(found: Plan | NoAnswerError, target: Mapping[str, float]) -> int:
    """Turns that reach the target if every standard error falls with their square root."""
    if isinstance(found, NoAnswerError):
        return 0
    excess = max(found.std(name) / wanted for name, wanted in target.items())
    return math.ceil(min(found.run.turns * excess**2, 1e9)) if excess < math.inf else 0


def _most_turns(longest: PlannedRun) -> int:
    """Whole turns within the bound of the search and that of memory."""
    a_turn = sum(60 / speed for speed in longest.speeds_rpm) * longest.each * longest.rate_hz
    return max(1, math.floor(min(longest.turns, 0.95 * MOST_SAMPLES / a_turn)))


def _attempt(
    pair: GearPair | Drive, run: PlannedRun, assumptions: Assumptions, target: Mapping[str, float]
) -> Plan | NoAnswerError:
    try:
        found = planned(pair, run, assumptions, target)
    except NoAnswerError as error:
        return error
    for name in target:
        if name not in found.parameters:
            known = ", ".join(found.parameters)
            raise ValueError(f"Argument `target` must hold names of {known}, but holds {name!r}.")
    return found


def _reached(found: Plan | NoAnswerError, target: Mapping[str, float]) -> bool:
    return isinstance(found, Plan) and all(found.std(n) <= wanted for n, wanted in target.items())


def _require_possible(found: Plan, target: Mapping[str, float]) -> None:
    """Raise where turns are not what is missing: both shafts turn enough, and still."""
    for name in () if found.short else target:
        if not found.parameters[name].determined:
            reason = found.parameters[name].reason
            raise NoAnswerError(f"no number of turns tells {name}: {reason}.", where="planned run")


def _unreachable(
    found: Plan | NoAnswerError, target: Mapping[str, float], longest: PlannedRun, most: int
) -> NoAnswerError:
    if isinstance(found, NoAnswerError):
        return found
    _require_possible(found, target)
    limit = "as asked" if most == math.floor(longest.turns) else "the most that fit in memory"
    missed = []
    for name, wanted in target.items():
        one = found.parameters[name]
        if found.std(name) > wanted:
            seen = f"{one.std:.2g}" if one.std is not None else f"none ({one.reason})"
            missed.append(f"{name} {seen} instead of {wanted:g} {one.unit}")
    return NoAnswerError(
        f"{most} turns a pass, {limit}, are too few: {'; '.join(missed)}; allow more turns, less"
        " noise or more passes.",
        where="planned run",
    )
