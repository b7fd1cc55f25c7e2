"""Run of a case as a pure function, which `jit`, `vmap` and derivatives of JAX can transform."""

from dataclasses import replace
from pathlib import Path
from typing import Any, Literal, get_args

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from ...base.arrays import Numbers
from ...base.runtime import require_x64
from ...pair.gear_pair import Drive, GearPair
from ..controllers.controller import Controller
from ..controllers.smooth import smoothed
from ..motion.limits import is_concrete
from ..scenario.spec import ScenarioSpec
from .build import Maps
from .case import Case, Sample, initial_state, run_periods, trace_periods
from .metrics import metric_inputs_of, metrics_of, outcome_codes
from .simulate import periods_of, scenario_case

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
    scenario: str | Path | ScenarioSpec,
    pair: GearPair | Drive | None = None,
    *,
    folder: str | Path | None = None,
    controller: Controller | None = None,
    maps: Maps = Maps(),
    periods: int | None = None,
    rounding: Rounding = "exact",
    smooth_width: float | None = None,
) -> Case:
    """Build the case of a scenario for `run`: a pytree whose leaves are the numbers of the case.

    Encoder counts, actuator steps and comparisons in a controller are piecewise constant functions,
    whose derivative is zero. `rounding` and `smooth_width` replace them.

    **Arguments**
    - `scenario`, `pair`, `folder`, `controller`, `maps`: as for `simulate`.
    - `periods`: number of controller periods in a run; by default that of the motion. Periods after
      the end of the motion have no effect; a batch of motions needs the number of the longest one.
    - `rounding`: "exact" rounds as the hardware does, with derivatives of zero. "none" has encoders
      and an actuator without steps. "straight_through" computes rounded values, but derivatives as
      if they were not rounded, so the derivatives are not exactly those of the result.
    - `smooth_width`: relative width of the smoothed comparisons, as in `tune`; by default the
      controller of the scenario is used without smoothing.

    **Raises** what `simulate` raises, and `ValueError` for fewer `periods` than the motion has, an
    unknown `rounding`, and a `smooth_width` that is not positive or whose controller has no
    smoothed form.

    **Example**
    ```python
    >>> import vttig_jax
    >>> from vttig_jax.control import build_case, parse_scenario_spec
    >>> from vttig_jax.rig import paper_pair
    >>> vttig_jax.enable_x64()
    >>> rig = {"driving_mm": 0.0226, "driving_phase_deg": 49.5, "driven_mm": 0.0273}
    >>> rig |= {"driven_phase_deg": 79.3, "constant_backlash_deg": 0.038}
    >>> spec = parse_scenario_spec({"pair": "pair.toml", "eccentricities": rig})
    >>> build_case(spec, paper_pair()).periods
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
    _, _, case = scenario_case(scenario, pair, folder, controller, maps)
    if smooth_width is not None:
        case = replace(case, controller=smoothed(case.controller, smooth_width))
    needed = periods_of(case)
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
        encoder["count"], actuator["resolution"] = 0.0, 0.0
    return replace(
        case,
        driving_sensor=replace(case.driving_sensor, **encoder),
        driven_sensor=replace(case.driven_sensor, **encoder),
        actuator=replace(case.actuator, **actuator),
    )


def run(case: Case, *, trace: bool = False) -> CaseRun:
    """Run a case from its first period to its last; a pure function of the numbers of the case.

    It works with `jax.jit`, `jax.vmap` over stacked cases, and derivatives. Forward mode
    (`jax.jacfwd`) suits few inputs and long runs; `jax.grad` stores the state of every period. The
    derivatives hold for the sequence of events in this run: the instant of a contact or a detection
    moves within its period, but derivatives do not include that the event could move to another
    period. See `build_case` for `rounding` and `smooth_width`.

    **Arguments**
    - `case`: from `build_case`. - `trace`: whether to return the sample of every period.

    **Raises** `ValueError` for a traced case without a number of periods.

    **Example**
    ```python
    >>> import jax, vttig_jax
    >>> from vttig_jax.control import build_case, parse_scenario_spec, run, with_settings
    >>> from vttig_jax.rig import paper_pair
    >>> vttig_jax.enable_x64()
    >>> rig = {"driving_mm": 0.0226, "driving_phase_deg": 49.5, "driven_mm": 0.0273}
    >>> rig |= {"driven_phase_deg": 79.3, "constant_backlash_deg": 0.038}
    >>> motion = {"reversal_deg": 360.0, "dwell_s": 0.1, "ramp_s": 0.2}
    >>> given = {"pair": "pair.toml", "eccentricities": rig, "motion": motion}
    >>> spec = parse_scenario_spec(given | {"controller": "predictive"})
    >>> case = build_case(spec, paper_pair(), rounding="none", smooth_width=0.1)
    >>> def left(margin_mm):
    ...     changed = with_settings(case, {"judgement.margin_mm": margin_mm})
    ...     return run(changed).metrics["residual_gap_deg"]
    >>> print(f"{jax.jacfwd(left)(0.01):.4f} deg per mm")
    0.0751 deg per mm

    ```
    """
    if not case.periods and not is_concrete(case.motion.duration_s):
        raise ValueError(
            "Argument `case` must have its number of periods while it is traced, but it has none;"
            " build it with `build_case`."
        )
    return _run(case, case.periods or periods_of(case), trace)


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
