"""Expected standard errors of a run that is not yet recorded, from its Fisher information."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from ...base.runtime import require_x64
from ...base.threads import one_blas_thread
from ...base.units import DEG
from ...identify.model.forward_model import drive_relation, pair_relation
from ...identify.preliminary.delay import NEGLECTED, SIGNIFICANT, Delay
from ...identify.report.gap_of_delay import allowing_for, gap_of_delay
from ...identify.report.parameters import outcome_of, parameters_of
from ...identify.settings import FitSettings
from ...identify.solve.least_squares import Solution, solve
from ...pair.eccentricities import Eccentricities
from ...pair.gear_pair import Drive, GearPair
from ...pair.schema import HarmonicOrders
from .assumptions import assumed_values, cartesian
from .noise import PlannedNoise, counting_std
from .result import Plan, conditions, delay_notes, notes, planned_parameter
from .rows import DELAY, PlannedRows, columns_of, planned_rows, whitened_flanks
from .run import Directions, PlannedRun

DelayChoice = Literal["auto", "free", "off"] | float
"""Values of the setting `delay` of a fit: "auto", "free", "off", or a number of seconds."""


@dataclass(frozen=True)
class Assumptions:
    """Assumptions of a plan besides the run: the rig, and the model of the fit.

    **Arguments**
    - `values`: amplitudes, phases and delay by the parameter names of a fit.
    - `noise`, `orders`, `perfect_encoders`, `delay`: see `plan`.
    """

    values: Mapping[str, float]
    noise: PlannedNoise
    orders: HarmonicOrders
    perfect_encoders: bool
    delay: DelayChoice

    def __post_init__(self):
        if self.settings.delay not in ("auto", "free") and "delay_s" in self.values:
            raise ValueError(
                'Argument `assumed` must hold a delay_s only if `delay` is "auto" or "free", but'
                f" `delay` is {self.delay!r}, so that no delay is fitted."
            )

    @property
    def settings(self) -> FitSettings:
        """Settings of the fit for which the run is planned."""
        return FitSettings(perfect_encoders=self.perfect_encoders, delay=self.delay)


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

    The block rows X are computed from the noise-free motion as in `identify.fit`. With the
    covariance C of the noise of these block means, and the Jacobian J of the tied coefficients with
    respect to the parameters,

        covariance = (Jᵀ XᵀC⁻¹X J)⁻¹.

    The free orders of every flank are eliminated. No unbiased method has smaller standard errors
    (Cramér–Rao bound). Those of the fit are a few percent larger, because it also estimates C.

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
    - `delay`: as in the fit. "auto" fits a delay if several speeds, or else the ramps, separate it
      from the constant backlash; it is not fitted if the assumed `delay_s` is below 4 standard
      errors. "free" always fits a delay, "off" never, and a number of seconds is a known delay.

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
    run = PlannedRun(
        turns=turns,
        speeds_rpm=speeds,
        rate_hz=rate_hz,
        directions=directions,
        passes=passes,
        dwell_s=dwell_s,
        ramp_s=ramp_s,
    )
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
    """Return the plan of a run; the report compares the expected standard errors with `wanted`."""
    rows = planned_rows(run, pair, assumptions.orders, assumptions.noise)
    settings = assumptions.settings
    split = not settings.perfect_encoders and len(rows.identifiable.flanks) == 2
    solution, delay = _solved(pair, rows, assumptions, split=split)
    fitted = allowing_for(
        gap_of_delay(delay, rows.identifiable),
        parameters_of(pair, rows.identifiable, solution, settings, delay),
    )
    parameters = {
        name: planned_parameter(parameter, assumptions.values.get(name), wanted.get(name))
        for name, parameter in fitted.items()
    }
    counting = counting_std(pair)
    return Plan(
        pair=pair,
        parameters=parameters,
        run=run,
        used=rows.used,
        noise=assumptions.noise,
        counting_std_deg=counting / DEG,
        blocks=rows.noise,
        flanks=rows.identifiable.flanks,
        conditional_on=conditions(pair, rows, delay, split=split),
        outcome=outcome_of(fitted, solution.converged, settings),
        covariance=solution.covariance,
        covariance_names=solution.names,
        short=rows.identifiable.short,
        weakest=solution.weakest,
        notes=(
            *notes(pair, run, rows, assumptions.orders, assumptions.noise),
            *delay_notes(rows, delay, solution, assumed="delay_s" in assumptions.values),
        ),
    )


def _solved(
    pair: GearPair | Drive, rows: PlannedRows, assumptions: Assumptions, *, split: bool
) -> tuple[Solution, Delay]:
    """Return the expected solution of the fit, and the delay that the fit will report.

    `split` is True if the fit separates encoder errors from gear errors.
    """

    def solution(*, joint: bool) -> Solution:
        return _noise_free_solution(pair, rows, assumptions.values, split=split, joint=joint)

    choice = assumptions.settings.delay
    if choice not in ("auto", "free"):
        return solution(joint=False), _unfitted(choice)
    if not rows.delay_source:
        alias = "the constant backlash" if len(rows.identifiable.flanks) == 2 else "an offset"
        reason = f"at one steady speed a delay cannot be told from {alias}; plan a second speed"
        return solution(joint=False), Delay("open", reason=reason, forced=choice == "free")
    found = solution(joint=True)
    place = found.names.index(DELAY)
    std = float(np.sqrt(found.covariance[place, place]))
    assumed = assumptions.values.get("delay_s")
    if choice == "auto" and assumed is not None and abs(assumed) <= SIGNIFICANT * std:
        return solution(joint=False), _insignificant(assumed, std, rows.interval_s)
    return found, Delay("fitted", assumed or 0.0, 0.0, std, forced=choice == "free")


def _insignificant(assumed_s: float, std_s: float, within_s: float) -> Delay:
    """Return a delay that the fit will take as zero, with the rms of its expected estimates."""
    expected_s = math.hypot(assumed_s, std_s)
    return Delay("insignificant", 0.0, expected_s, std_s, NEGLECTED, within_s=within_s)


def _unfitted(choice: str | float) -> Delay:
    """Return the delay of a fit that does not fit it: "off", or given in seconds."""
    if isinstance(choice, str):
        reason = "not fitted: both channels are taken to be sampled at the same instant"
        return Delay("off", reason=reason)
    return Delay("given", choice, reason=f"given as {choice:g} s, not fitted")


def _noise_free_solution(
    pair: GearPair | Drive,
    rows: PlannedRows,
    values: Mapping[str, float],
    *,
    split: bool,
    joint: bool,
) -> Solution:
    """Return the solution of a planned log: noise-free parameters, covariance of a log with noise.

    **Arguments**
    - `values`: assumed amplitudes and phases. - `split`: fit encoder errors and gear errors.
    - `joint`: fit a delay too.
    """
    columns = columns_of(rows, with_delay=joint)
    terms, flanks = rows.identifiable.terms, rows.identifiable.flanks
    if isinstance(pair, Drive):
        relation = drive_relation(terms, columns, flanks)
    else:
        relation = pair_relation(pair, terms, columns, flanks, encoder_terms=split)
    tied = relation.linearised(cartesian(relation.names, values))[0]
    with_ramps = joint and rows.delay_source == "ramps"
    return solve(relation, whitened_flanks(rows, columns, tied, with_ramps=with_ramps))
