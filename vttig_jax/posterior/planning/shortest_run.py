"""Search for the shortest run whose fit reaches the wanted standard errors."""

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from ...base.errors import NoAnswerError
from ...base.runtime import require_x64
from ...pair.gear_pair import Drive, GearPair
from .plan import plan
from .result import Plan
from .run import MOST_SAMPLES, PlannedRun, speeds_of

MOST_TURNS = 1000.0  # default of the largest number of turns of a pass (chosen)


def shortest_run(
    pair: GearPair | Drive,
    target: Mapping[str, float],
    *,
    most_turns: float = MOST_TURNS,
    **planned: Any,
) -> Plan:
    """Return the plan with the fewest turns per pass that reaches the wanted standard errors.

    The number of driving turns per pass is whole. More turns never give less information once every
    first order has enough turns. Therefore the run is first doubled until it reaches the target,
    and then the number of turns is found by bisection.

    **Arguments**
    - `target`: name of a parameter → wanted standard error in its unit, for example
      `{"driving_eccentricity_mm": 1e-4}`.
    - `most_turns`: largest number of turns per pass, 1000 by default. A run of more than ten
      million samples is never tried.
    - `planned`: the other arguments of `plan`.

    **Raises** `NoAnswerError` with the reason if no run of this kind reaches the target.

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
    16.0

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
    own = {name: planned[name] for name in PlannedRun.__dataclass_fields__ if name in planned}
    longest = PlannedRun(most_turns, speeds_of(planned.get("speed_rpm", 60.0)), **own)
    samples = sum(60 / speed for speed in longest.speeds_rpm) * longest.pass_count * longest.rate_hz
    most = max(1, math.floor(min(most_turns, 0.95 * MOST_SAMPLES / samples)))
    least = max(1, math.ceil(longest.least_turns))
    few, many = least - 1, min(least, most)
    best = _attempt(pair, many, target, planned)
    while not _reaches_target(best, target):
        if many == most:
            raise _unreachable(best, target, longest, most)
        if isinstance(best, Plan):
            _require_possible(best, target)
        few, many = many, min(2 * many, most)
        best = _attempt(pair, many, target, planned)
    while many - few > 1:
        middle = (few + many) // 2
        result = _attempt(pair, middle, target, planned)
        if _reaches_target(result, target):
            best, many = result, middle
        else:
            few = middle
    assert isinstance(best, Plan)  # because it reaches the target
    own = {name: replace(p, wanted=target.get(name)) for name, p in best.parameters.items()}
    return replace(best, parameters=own)


def _attempt(
    pair: GearPair | Drive, turns: int, target: Mapping[str, float], planned: dict[str, Any]
) -> Plan | NoAnswerError:
    """Return the plan with these turns per pass, or why it has no answer."""
    try:
        result = plan(pair, turns=float(turns), **planned)
    except NoAnswerError as error:
        return error
    for name in target:
        if name not in result.parameters:
            known = ", ".join(result.parameters)
            raise ValueError(f"Argument `target` must hold names of {known}, but holds {name!r}.")
    return result


def _reaches_target(result: Plan | NoAnswerError, target: Mapping[str, float]) -> bool:
    return isinstance(result, Plan) and all(result.std(n) <= wanted for n, wanted in target.items())


def _require_possible(result: Plan, target: Mapping[str, float]) -> None:
    """Raise `NoAnswerError` if both shafts turn enough, but a wanted parameter is undetermined."""
    for name in () if result.short else target:
        if not result.parameters[name].determined:
            reason = result.parameters[name].reason
            raise NoAnswerError(f"no number of turns fixes {name}: {reason}.", where="planned run")


def _unreachable(
    result: Plan | NoAnswerError, target: Mapping[str, float], longest: PlannedRun, most: int
) -> NoAnswerError:
    if isinstance(result, NoAnswerError):
        return result
    _require_possible(result, target)
    limit = "as asked" if most == math.floor(longest.turns) else "the most that fit in memory"
    missed = []
    for name, wanted in target.items():
        p = result.parameters[name]
        if result.std(name) > wanted:
            reached = f"{p.std:.2g}" if p.std is not None else f"none ({p.reason})"
            missed.append(f"{name} {reached} instead of {wanted:g} {p.unit}")
    cures = "allow more turns, less noise or more passes"
    if "constant_backlash_deg" in target and len(longest.speeds_rpm) == 1:
        cures += ", or plan a second speed, which tells a delay from the constant backlash"
    return NoAnswerError(
        f"{most} turns a pass, {limit}, are too few: {'; '.join(missed)}; {cures}.",
        where="planned run",
    )
