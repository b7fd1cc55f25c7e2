"""Expected standard errors of a run that is not made yet, from its Fisher information."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, get_args

import jax.numpy as jnp
import numpy as np

from ...base.runtime import require_x64
from ...base.threads import one_blas_thread
from ...base.units import DEG
from ...identify.model.forward_model import drive_relation, pair_relation
from ...identify.preliminary.delay import Delay
from ...identify.report.parameters import outcome_of, parameters_of
from ...identify.settings import FitSettings
from ...identify.solve.least_squares import Solution, solve
from ...pair.eccentricities import Eccentricities
from ...pair.gear_pair import Drive, GearPair
from ...pair.schema import HarmonicOrders
from .assumptions import assumed_values, cartesian
from .noise import PlannedNoise, counting_std
from .result import Plan, conditions, notes, planned_parameter
from .rows import DELAY, PlannedRows, columns_of, delay_std, planned_rows, whitened_flanks
from .run import Directions, PlannedRun

DelayChoice = Literal["auto", "free", "off"]


@dataclass(frozen=True)
class Assumptions:
    """Assumptions of a plan besides the run: the rig, and the model of the fit.

    **Arguments**
    - `values`: amplitudes and phases by the parameter names of a fit.
    - `noise`, `orders`, `perfect_encoders`, `delay`: see `plan`.
    """

    values: Mapping[str, float]
    noise: PlannedNoise
    orders: HarmonicOrders
    perfect_encoders: bool
    delay: DelayChoice

    def __post_init__(self):
        if self.delay not in get_args(DelayChoice):
            raise ValueError(
                f'Argument `delay` must be "auto", "free" or "off", but is {self.delay!r}.'
            )


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

    The noise-free motion passes through the averages, harmonics and forward model of
    `identify.fit`. Its rows X are whitened with the known noise. J is the Jacobian of the model:

        covariance = (Jᵀ XᵀC⁻¹X J)⁻¹,   C the covariance of the noise of block means.

    The free orders of every flank are eliminated. No unbiased method has smaller errors; those of
    the fit, which must also estimate C, are larger by a few percent.

    **Arguments**
    - `pair`: gear pair, or a drive without geometry.
    - `turns`: turns of the driving shaft in every pass, ramps included.
    - `rate_hz`: sampling rate, Hz.
    - `noise`: noise of single samples of the transmission error, without counting.
    - `speed_rpm`: speed of the driving shaft; several speeds, each with its own passes in one
      recording, separate a delay from the constant backlash.
    - `directions`: "both", "forward" or "backward".
    - `passes`: passes at every speed; by default 2 for both directions, 1 for one.
    - `dwell_s`, `ramp_s`: standstill after every pass, time from standstill to speed, s.
    - `eccentricities`: assumed eccentricities; 0.02 mm each by default. They determine the standard
      error of a phase; constant backlash and axial position among them change no standard error.
    - `assumed`: amplitudes and phases by the names of a fit, "driving_encoder_arcsec" and others.
    - `orders`: harmonic orders to model; those of the pair by default.
    - `perfect_encoders`: fit no encoder eccentricity.
    - `delay`: "auto" fits a delay if there are several speeds; at one speed the ramps give its
      standard error, and the other parameters assume zero. "free" always fits it, "off" never.

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
    speeds = tuple(speed_rpm) if isinstance(speed_rpm, Sequence) else (speed_rpm,)
    run = PlannedRun(turns, speeds, rate_hz, directions, passes, dwell_s, ramp_s)
    values = assumed_values(pair, eccentricities, assumed)
    return plan_of_run(
        pair, run, Assumptions(values, noise, orders or pair.fit, perfect_encoders, delay), {}
    )


def plan_of_run(
    pair: GearPair | Drive,
    run: PlannedRun,
    assumptions: Assumptions,
    wanted: Mapping[str, float],
) -> Plan:
    """Return the plan of a run; `wanted` standard errors are shown beside the expected ones."""
    rows = planned_rows(run, pair, assumptions.orders, assumptions.noise)
    settings = FitSettings(perfect_encoders=assumptions.perfect_encoders, delay=assumptions.delay)
    split = not settings.perfect_encoders and len(rows.identifiable.flanks) == 2
    joint = rows.delay_source != "" and (
        assumptions.delay == "free"
        or (assumptions.delay == "auto" and rows.delay_source == "speeds")
    )
    solution = _noise_free_solution(pair, rows, assumptions.values, split=split, joint=joint)
    delay = _expected_delay(rows, solution, assumptions.delay)
    fitted = parameters_of(pair, rows.identifiable, solution, settings, delay)
    parameters = {
        name: planned_parameter(parameter, assumptions.values.get(name), wanted.get(name))
        for name, parameter in fitted.items()
    }
    counting = counting_std(pair)
    return Plan(
        pair,
        parameters,
        run,
        rows.used,
        assumptions.noise,
        counting / DEG,
        rows.noise,
        rows.identifiable.flanks,
        conditions(pair, rows, delay, split=split),
        outcome_of(fitted, solution.converged, settings),
        solution.covariance,
        solution.names,
        rows.identifiable.short,
        solution.weakest,
        notes(pair, run, rows, assumptions.orders, delay, assumptions.noise),
    )


def _noise_free_solution(
    pair: GearPair | Drive,
    rows: PlannedRows,
    values: Mapping[str, float],
    *,
    split: bool,
    joint: bool,
) -> Solution:
    """Return the solution of a log without noise; its covariance is that of a log with noise."""
    columns = columns_of(rows, with_delay=joint)
    terms, flanks = rows.identifiable.terms, rows.identifiable.flanks
    if isinstance(pair, Drive):
        relation = drive_relation(terms, columns, flanks)
    else:
        relation = pair_relation(pair, terms, columns, flanks, encoder_terms=split)
    tied = np.asarray(relation.coefficients(jnp.asarray(cartesian(relation.names, values))))
    with_ramps = joint and rows.delay_source == "ramps"
    return solve(relation, whitened_flanks(rows, columns, tied, with_ramps=with_ramps))


def _expected_delay(rows: PlannedRows, solution: Solution, choice: DelayChoice) -> Delay:
    """Return what the fit will report on a delay."""
    forced = choice == "free"
    if choice == "off":
        reason = "not fitted: both channels are taken to be sampled at the same instant"
        return Delay("off", reason=reason)
    if DELAY in solution.names:
        return Delay("fitted", forced=forced)
    if not rows.delay_source:
        alias = "the constant backlash" if len(rows.identifiable.flanks) == 2 else "an offset"
        reason = f"at one steady speed a delay cannot be told from {alias}; plan a second speed"
        return Delay("open", reason=reason, forced=forced)
    reason = "seen in the ramps only; the other parameters take it as zero"
    return Delay("insignificant", std_s=delay_std(rows, solution), reason=reason)
