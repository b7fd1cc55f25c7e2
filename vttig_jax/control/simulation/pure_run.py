"""Run of a case as a pure function, which `jit`, `vmap` and derivatives of JAX can transform."""

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
from ..controllers.controller import Controller
from ..controllers.smooth import smoothed
from ..scenario.scenario import Scenario
from ..scenario.spec import ScenarioSpec
from .build import Maps
from .case import Case, Sample, initial_state, run_periods, trace_periods
from .metrics import metric_inputs_of, metrics_of, outcome_codes
from .prepare import Fixed, prepared
from .simulate import periods_of, specified_case

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
    scenario: str | Path | ScenarioSpec | Scenario,
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
        base = None if like is None else build_case(like)
        fixed = Fixed()
        if base is not None:
            a = base.actuator
            fixed = Fixed(base.substeps, a.periods, a.thrust is not None)
        case, _ = prepared(scenario, fixed)
        if (
            base is not None
        ):  # the static choices of `like`, such as whether its encoders have noise
            case = jax.tree.unflatten(jax.tree.structure(base), jax.tree.leaves(case))
    else:
        _, _, case = specified_case(scenario, pair, folder, controller, maps)
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
    return replace(_rounded(case, rounding), periods=periods or needed)


def _rounded(case: Case, rounding: Rounding) -> Case:
    """Return the case with the given treatment of encoder counts and actuator steps."""
    if rounding == "exact":
        return case
    straight = rounding == "straight_through"
    encoder, actuator = dict[str, Any](straight=straight), dict[str, Any](straight=straight)
    if not straight:
        encoder["counts_per_rev"], actuator["resolution_mm"] = 0.0, 0.0
    return replace(
        case,
        driving_encoder=replace(case.driving_encoder, **encoder),
        driven_encoder=replace(case.driven_encoder, **encoder),
        actuator=replace(case.actuator, **actuator),
    )


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
    - `smooth_width`: relative width of the smoothed comparisons, as in `tune`; by default the
      controller of the scenario is used without smoothing.

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
    start, numbers = initial_state(case), jnp.arange(periods)
    samples = None
    if trace:
        state, samples = trace_periods(case, start, numbers)
    else:
        state = run_periods(case, start, numbers)
    found = metric_inputs_of(case), state.accumulators
    return CaseRun(metrics_of(*found), outcome_codes(*found), samples)
