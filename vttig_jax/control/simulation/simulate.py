"""Simulation of one case from its first period to its last: with a report, or as a pure function.

`simulate` runs in chunks, between which Ctrl-C can interrupt it; `jit`, `vmap` and derivatives of
JAX can transform `run`.
"""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal, get_args

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from ...base.arrays import Numbers, known
from ...base.runtime import require_x64
from ...pair.gear_pair import Drive, GearPair
from ..controllers.controller import Controller, smoothed
from ..motion.motion import Motion
from ..scenario.scenario import Scenario
from ..scenario.spec import ScenarioSpec
from .case import Case, Sample, State, initial_state, metrics_of, run_periods
from .prepare import Fixed, Maps, prepared, prepared_case
from .result import Simulation

CHUNK = 1024
"""Plant steps in one compiled call; a chosen value.

Between two calls Ctrl-C can interrupt the run; much shorter calls would be slow."""


def simulate(
    scenario: ScenarioSpec | Scenario,
    pair: GearPair | Drive | None = None,
    *,
    folder: str | Path | None = None,
    controller: Controller | None = None,
    maps: Maps = Maps(),
    trace_every: int = 0,
    progress: Callable[[int, int], None] | None = None,
) -> Simulation:
    """Simulate the run of one scenario: the gear drive, its motion and its controller.

    **Arguments**
    - `scenario`: the specification of a scenario, or a `Scenario`, which goes with the arguments
      `trace_every` and `progress` alone. `vttig_jax.simulate` takes files too.
    - `pair`: gears instead of the pair file that the scenario names.
    - `folder`: folder for relative paths; by default the working folder.
    - `controller`: controller of the user, instead of that of the scenario; see `Controller`.
    - `maps`: flank models of the run folders and map files that the scenario names;
      `vttig_jax.simulate` reads them.
    - `trace_every`: number of periods from one sample of the trace to the next; 0 for no trace.
    - `progress`: is called with the numbers of finished and of all periods.

    **Raises** `ScenarioError` with file and key, `PairError`, and `ValueError` without 64-bit
    floats or for a `trace_every` below 0.

    **Example**
    ```python
    >>> import vttig_jax
    >>> from vttig_jax.control import parse_scenario_spec
    >>> from vttig_jax.rig import paper_pair
    >>> vttig_jax.enable_x64()
    >>> rig = {"driving_mm": 0.0226, "driving_phase_deg": 49.5, "driven_mm": 0.0273}
    >>> rig |= {"driven_phase_deg": 79.3, "constant_backlash_deg": 0.038}
    >>> motion = {"reversal_deg": 720.0, "dwell_s": 0.2}
    >>> scenario = {"pair": "pair.toml", "eccentricities": rig, "motion": motion}
    >>> spec = parse_scenario_spec(scenario | {"controller": "predictive"})
    >>> run = vttig_jax.simulate(spec, paper_pair())
    >>> run.outcome, round(run.metrics["residual_gap_deg"], 5)
    ('ok', 0.00075)

    ```
    """
    require_x64("simulate")
    if trace_every < 0:
        raise ValueError(f"Argument `trace_every` must be at least 0, but is {trace_every}.")
    objects, case = prepared_case(scenario, pair, folder, controller, maps)
    state, trace = run_in_chunks(case, trace_every, progress)
    if np.isnan(state.accumulators.output_squares):
        raise ValueError(
            f"Argument `controller` must command finite numbers, but"
            f" {type(case.controller).__name__} commands NaN."
        )
    spec = None if isinstance(scenario, Scenario) else scenario
    return Simulation(objects, spec, case, state.accumulators, trace)


def periods_of(motion: Motion, period: Any) -> int:
    """Return the number of periods (s) of the controller in a run of a motion."""
    return int(np.floor(float(motion.duration_s) / float(period) * (1 + 1e-12))) + 1


_run_periods = eqx.filter_jit(run_periods)


def run_in_chunks(
    case: Case, trace_every: int = 0, progress: Callable[[int, int], None] | None = None
) -> tuple[State, Sample | None]:
    """Run a case in chunks, between which Ctrl-C can interrupt it; return last state and trace.

    `trace_every`: see `simulate`. `progress` is called with the number of finished periods and the
    number of all periods.
    """
    periods = periods_of(case.motion, case.period)
    state, samples = initial_state(case), list[Sample]()
    chunk = max(CHUNK // case.substeps, 1)
    for first in range(0, periods, chunk):
        state, sample = _run_periods(case, state, first + jnp.arange(chunk), trace_every > 0)
        if trace_every:
            chosen = np.flatnonzero((np.arange(first, first + chunk) % trace_every) == 0)
            chosen = chosen[first + chosen < periods]
            samples.append(
                jax.tree.map(lambda values, rows=chosen: np.asarray(values)[rows], sample)
            )
        if progress is not None:
            progress(min(first + chunk, periods), periods)
    if not trace_every:
        return state, None
    return state, jax.tree.map(lambda *values: np.concatenate(values), *samples)


Rounding = Literal["exact", "none", "straight_through"]
_ROUNDINGS: tuple[Rounding, ...] = get_args(Rounding)


class CaseRun(eqx.Module):
    """Result of `run`.

    - `metrics`: name → value, in the unit at the end of the name; NaN for events that did not
      happen. - `outcome`: index of the outcome in `OUTCOMES`; 0 is ok.
    - `trace`: samples of all periods in s, rad and mm, or None.
    """

    metrics: dict[str, Float[Numbers, ""]]
    outcome: Int[Numbers, ""]
    trace: Sample | None


def build_case(
    scenario: ScenarioSpec | Scenario,
    pair: GearPair | Drive | None = None,
    *,
    folder: str | Path | None = None,
    controller: Controller | None = None,
    maps: Maps = Maps(),
    like: Scenario | None = None,
    periods: int | None = None,
    rounding: Rounding = "exact",
    smooth_width: float | None = None,
) -> Case:
    """Prepare a scenario to run; a pure function of all its numbers.

    The case is a pytree whose leaves are numbers; cases of equal structure can be stacked.

    **Arguments**
    - `scenario`, `pair`, `folder`, `controller`, `maps`: as for `simulate`.
    - `like`, `periods`, `rounding`, `smooth_width`: as for `run`.

    **Raises** what `simulate` and `run` raise.

    **Example**
    ```python
    >>> import vttig_jax
    >>> from vttig_jax.control import Scenario, build_case
    >>> from vttig_jax.rig import paper_eccentricities, paper_pair
    >>> vttig_jax.enable_x64()
    >>> build_case(Scenario(paper_pair(), paper_eccentricities())).periods
    47001

    ```
    """
    require_x64("build_case")
    if rounding not in _ROUNDINGS:
        raise ValueError(
            f"Argument `rounding` must be one of {', '.join(_ROUNDINGS)}, but is {rounding!r}."
        )
    if smooth_width is not None and not 0 < smooth_width < np.inf:
        raise ValueError(f"Argument `smooth_width` must be positive, but is {smooth_width}.")
    if isinstance(scenario, Scenario):
        fixed, base = Fixed(), None if like is None else build_case(like)
        if base is not None:
            limited = base.actuator.thrust is not None
            fixed = Fixed(base.substeps, base.actuator.periods, limited)
        case, _ = prepared(scenario, fixed)
        if base is not None:  # with all its static choices, such as whether encoders have noise
            case = jax.tree.unflatten(jax.tree.structure(base), jax.tree.leaves(case))
    else:
        _, case = prepared_case(scenario, pair, folder, controller, maps)
    if smooth_width is not None:
        case = replace(case, controller=smoothed(case.controller, smooth_width))
    needed = case.periods
    if known(case.motion, case.period):
        needed = max(needed, periods_of(case.motion, case.period))
    if not (needed or periods):
        raise ValueError(
            "Argument `periods` must be given, or `like`, for a motion whose numbers JAX traces,"
            " because the number of controller periods is static."
        )
    if periods is not None and periods < needed:
        raise ValueError(
            f"Argument `periods` must be at least {needed}, the periods of the motion, but is"
            f" {periods}."
        )
    if rounding != "exact":
        straight = rounding == "straight_through"
        counts = {"straight": True} if straight else {"counts_per_rev": 0.0}
        steps = {"straight": True} if straight else {"resolution_mm": 0.0}
        case = replace(
            case,
            driving_encoder=replace(case.driving_encoder, **counts),
            driven_encoder=replace(case.driven_encoder, **counts),
            actuator=replace(case.actuator, **steps),
        )
    return replace(case, periods=periods or needed)


def run(
    scenario: Scenario | Case,
    *,
    trace: bool = False,
    like: Scenario | None = None,
    periods: int | None = None,
    rounding: Rounding = "exact",
    smooth_width: float | None = None,
) -> CaseRun:
    """Run a scenario from its first period to its last; a pure function of all its numbers.

    It works with `jax.jit`, `jax.vmap`, and derivatives by every number. Forward mode
    (`jax.jacfwd`) suits few inputs and long runs; `jax.grad` stores the state of every period. The
    derivatives hold for the sequence of events in this run: the instant of a contact or a detection
    moves within its period, but derivatives do not include that the event could move to another
    period.

    Encoder counts, actuator steps and comparisons in a controller are piecewise constant functions,
    whose derivative is zero. `rounding` and `smooth_width` replace them.

    **Arguments**
    - `scenario`: a `Scenario`, or a case from `build_case`, to which no further argument but
      `trace` applies. - `trace`: whether to return the sample of every period.
    - `like`: a scenario of known numbers and of the same kind. The choices that must be static
      follow from it where JAX traces the numbers of `scenario`: number of periods, plant steps in a
      period, length of the queue of commands, part of the hunting period in a flank table.
    - `periods`: number of controller periods in a run; by default that of the motion. Periods after
      the end of the motion have no effect; a batch of motions needs the number of the longest one.
    - `rounding`: "exact" rounds as the hardware does, with derivatives of zero. "none" has encoders
      and an actuator without steps. "straight_through" computes rounded values, but derivatives as
      if they were not rounded, so the derivatives are not exactly those of the result.
    - `smooth_width`: relative width of the smoothed comparisons; by default the controller of the
      scenario is used without smoothing.

    **Raises** what `simulate` raises, and `ValueError` for a static choice that would follow from a
    traced number, fewer `periods` than the motion has, an unknown `rounding`, and a `smooth_width`
    that is not positive or whose controller has no smoothed form.

    **Example**
    ```python
    >>> import jax, vttig_jax
    >>> from vttig_jax.control import Predictive, Reversal, Scenario, run
    >>> from vttig_jax.rig import paper_eccentricities, paper_pair
    >>> vttig_jax.enable_x64()
    >>> motion = Reversal(reversal_deg=360, dwell_s=0.1, ramp_s=0.2)
    >>> def left(margin_mm):
    ...     controller = Predictive(margin_mm=margin_mm)
    ...     scenario = Scenario(paper_pair(), paper_eccentricities(), motion, controller=controller)
    ...     return run(scenario, rounding="none", smooth_width=0.1).metrics["residual_gap_deg"]
    >>> print(f"{jax.jacfwd(left)(0.01):.4f} deg per mm")
    0.0751 deg per mm

    ```
    """
    if isinstance(scenario, Case):
        case = scenario
    else:
        case = build_case(
            scenario, like=like, periods=periods, rounding=rounding, smooth_width=smooth_width
        )
    if not case.periods and not known(case.motion):
        raise ValueError(
            "Argument `case` must have its number of periods while it is traced, but it has none;"
            " build it with `build_case`."
        )
    return _run(case, case.periods or periods_of(case.motion, case.period), trace)


@eqx.filter_jit
def _run(case: Case, periods: int, trace: bool) -> CaseRun:
    state, samples = run_periods(case, initial_state(case), jnp.arange(periods), trace)
    return CaseRun(*metrics_of(case, state.accumulators), samples)
