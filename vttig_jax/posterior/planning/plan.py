"""Expected standard errors of a run that is not yet recorded, and the shortest run for them."""

import math
from bisect import bisect_left
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache
from typing import Any, Literal

from ...base.errors import NoAnswerError
from ...base.runtime import require_x64
from ...base.threads import one_blas_thread
from ...base.units import DEG
from ...identify.fit_settings import FitSettings
from ...identify.identification import conditions_of, outcome_of, told_by
from ...model.parameters import FULL_TURN
from ...pair.gear_pair import Drive, Eccentricities, GearPair
from ...pair.schema import HarmonicOrders
from .expected import assumed_values, expected_fit, too_short
from .noise import PlannedNoise, counting_std
from .result import Plan, notes, planned_parameter
from .run import MOST_SAMPLES, Directions, PlannedRun, speeds_of

DelayChoice = Literal["auto", "off"] | float
"""Values of the setting `delay` of a fit: "auto", "off", or a number of seconds."""

MOST_TURNS = 1000.0  # default of the largest number of turns of a pass (chosen)

BESIDE = ("gap_over_angles_covered", "backlash_plus_delay_deg")
"""Parameters of a fit that depend on the angles of its log; a plan leaves them out."""


@one_blas_thread
def plan(
    pair: GearPair | Drive,
    *,
    turns: float,
    rate_hz: float,
    noise: PlannedNoise,
    speed_rpm: float | Sequence[float] = 60.0,
    directions: Directions = "both",
    passes: int | None = None,
    dwell_s: float = 2.0,
    ramp_s: float = 0.5,
    eccentricities: Eccentricities | None = None,
    assumed: Mapping[str, float] | None = None,
    orders: HarmonicOrders | None = None,
    perfect_encoders: bool = False,
    delay: DelayChoice = "auto",
) -> Plan:
    """Return the expected standard errors of all parameters that a fit of this run will report.

    The rows of the planned motion go through the model of `vttig_jax.fit`. Its density is taken at
    the expected products of their columns and readings, and the standard errors are those of its
    posterior there: the expected information. Drift, a delay that changes and a gap that changes
    with the speed are part of the model as in a fit, at the smallest size that such a log allows.

    **Arguments**
    - `pair`: gear pair, or a drive without geometry.
    - `turns`: turns of the driving shaft in every pass, ramps included.
    - `rate_hz`: sampling rate, Hz.
    - `noise`: noise of single samples of the transmission error, without counting.
    - `speed_rpm`: speed of the driving shaft, or several speeds, each with its own passes in one
      recording. Several speeds separate a delay from the constant backlash.
    - `directions`: "both", "forward" or "backward".
    - `passes`: passes at every speed; by default 2 for both directions, 1 for one.
    - `dwell_s`, `ramp_s`: standstill after every pass, and time from standstill to speed, s.
    - `eccentricities`: assumed eccentricities; 0.02 mm each by default. They determine the standard
      error of a phase; their constant backlash and axial position change no standard error.
    - `assumed`: assumed amplitudes, phases and delay by the parameter names of a fit, for example
      "driving_encoder_arcsec".
    - `orders`: harmonic orders to model; those of the pair by default.
    - `perfect_encoders`: fit no encoder eccentricity.
    - `delay`: as in the fit. "auto" fits a delay, which half a sampling interval bounds unless
      several speeds or the ramps tell it; "off" fits none, and a number of seconds is a known one.

    **Returns** a `Plan`.

    **Raises** `NoAnswerError` for a run that determines nothing, `UsageError` for one that is too
    long to plan, `ValueError` for wrong arguments and without 64-bit floats.

    **Example**
    ```python
    >>> import vttig_jax
    >>> from vttig_jax.posterior import plan
    >>> from vttig_jax.posterior import PlannedNoise
    >>> from vttig_jax.rig import paper_pair
    >>> vttig_jax.enable_x64()
    >>> noise = PlannedNoise(std_deg=0.002, correlation_s=0.00475)
    >>> result = plan(paper_pair(), turns=21.0, rate_hz=1987.0, noise=noise)
    >>> print(f"{result.parameters['driving_eccentricity_mm'].std:.5f} mm")
    0.00017 mm

    ```
    """
    require_x64("plan")
    values = assumed_values(pair, eccentricities, assumed)
    settings = FitSettings(perfect_encoders=perfect_encoders, delay=delay)
    if settings.delay != "auto" and "delay_s" in values:
        raise ValueError(
            'Argument `assumed` must hold a delay_s only if `delay` is "auto", but'
            f" `delay` is {delay!r}, so that no delay is fitted."
        )
    run = PlannedRun(turns, speeds_of(speed_rpm), rate_hz, directions, passes, dwell_s, ramp_s)
    counting = counting_std(pair)
    if not (noise.std_deg or noise.white_std_deg or counting):
        raise ValueError(
            "Argument `noise` must not be zero if the pair file gives no counts of the encoders,"
            " but it is: every standard error would be zero."
        )
    orders = orders or pair.fit
    fit, steady = expected_fit(run, pair, orders, noise, values, settings)
    fitted = told_by(fit, pair, settings, "planned run")[1]
    fitted = {name: p for name, p in fitted.items() if name not in BESIDE}
    outcome = outcome_of(fitted)
    if outcome == "not_determined":
        raise too_short(run)
    (rows,) = fit.rows
    size = rows.samples.shape[1]
    return Plan(
        pair=pair,
        parameters={name: planned_parameter(p, values.get(name)) for name, p in fitted.items()},
        run=run,
        used=rows.samples.size,
        noise=noise,
        counting_std_deg=counting / DEG,
        row_s=size / rate_hz,
        row_std_deg=math.sqrt(noise.autocovariance(size, rate_hz, 1, counting)[0]) / DEG,
        flanks=fit.scope.flanks,
        conditional_on=conditions_of(fit, pair, settings, fitted),
        outcome=outcome,
        short=tuple(shaft for shaft, turned in fit.scope.turns.items() if turned < FULL_TURN),
        notes=notes(pair, run, orders, noise, fit, steady),
    )


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
    attempt = cache(lambda turns: _attempt(pair, turns, target, planned))
    few, many = least - 1, min(least, most)
    while not _reaches_target(attempt(many), target):
        if many == most:
            raise _unreachable(attempt(many), target, longest, most)
        if isinstance(best := attempt(many), Plan):
            _require_possible(best, target)
        few, many = many, min(2 * many, most)
    turns = range(few + 1, many + 1)
    enough = bisect_left(turns, True, key=lambda k: _reaches_target(attempt(k), target))
    best = attempt(turns[enough])
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
