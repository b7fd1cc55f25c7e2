"""Expected standard errors of a run before it is made: the Fisher information of its design."""

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
from ...identify.settings import Choices
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
    """All of a plan but the run: what the rig is like, and what the fit will model.

    **Arguments**
    - `values`: amplitudes and phases by the names of a fit.
    - `noise`, `options`, `encoder_terms`, `delay`: see `plan`.
    """

    values: Mapping[str, float]
    noise: PlannedNoise
    options: HarmonicOrders
    encoder_terms: bool
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
    options: HarmonicOrders | None = None,
    encoder_terms: bool = True,
    delay: DelayChoice = "auto",
) -> Plan:
    """Expected standard error of every parameter that a fit of such a run will report.

    The noise-free motion goes through the averages, harmonics and relation of `identify.fit`; its
    rows X are whitened with the known noise, and with the Jacobian J of the relation

        covariance = (Jᵀ XᵀC⁻¹X J)⁻¹,   C the covariance of the noise of block means,

    the free orders of every flank eliminated. No unbiased method does better; the fit, which has to
    estimate C too, comes within a few percent.

    **Arguments**
    - `pair`: the gear pair, or a drive without geometry.
    - `turns`: of the driving shaft in every pass, ramps included.
    - `rate_hz`: of sampling.
    - `noise`: of single samples of the transmission error, before counting.
    - `speed_rpm`: of the driving shaft; several speeds, each with passes of its own in one
      recording, tell a delay from the constant backlash.
    - `directions`: "both", "forward" or "backward".
    - `passes`: at every speed; 2 for both directions.
    - `dwell_s`, `ramp_s`: standstill after every pass, time from standstill to speed.
    - `eccentricities`: of the gears; 0.02 mm each by default. They decide what a phase costs; the
      constant backlash and the axial position among them change no standard error.
    - `assumed`: amplitudes and phases by the names of a fit, "driving_encoder_arcsec" and the like.
    - `options`: orders to model; those of the pair by default.
    - `encoder_terms`: False takes the encoders to be perfect.
    - `delay`: "auto" fits a delay with several speeds; at one speed the ramps tell how well it is
      known, and the other parameters take it as zero. "free" fits it in any case, "off" in none.

    **Returns** a `Plan`.

    **Raises** `NoAnswerError` for a run that can tell nothing, `UsageError` for one that is too
    long to plan, `ValueError` for wrong arguments and without 64-bit floats.

    **Example**
    ```python
    >>> import vttig_jax
    >>> from vttig_jax.posterior import plan
    >>> from vttig_jax.posterior import PlannedNoise
    >>> from vttig_jax.rig import paper_pair
    >>> vttig_jax.enable_x64()
    >>> noise = PlannedNoise(std_deg=0.002, correlation_s=0.00475)
    >>> found = plan(paper_pair(), turns=21.0, rate_hz=1987.0, noise=noise)
    >>> print(f"{found.parameters['driving_eccentricity_mm'].std:.5f} mm")
    0.00017 mm

    ```
    """
    require_x64("plan")
    speeds = tuple(speed_rpm) if isinstance(speed_rpm, Sequence) else (speed_rpm,)
    run = PlannedRun(turns, speeds, rate_hz, directions, passes, dwell_s, ramp_s)
    values = assumed_values(pair, eccentricities, assumed)
    return planned(
        pair, run, Assumptions(values, noise, options or pair.fit, encoder_terms, delay), {}
    )


def planned(
    pair: GearPair | Drive,
    run: PlannedRun,
    assumptions: Assumptions,
    wanted: Mapping[str, float],
) -> Plan:
    """The plan of a run; `wanted` standard errors stand beside those expected."""
    rows = planned_rows(run, pair, assumptions.options, assumptions.noise)
    choices = Choices(encoder_terms=assumptions.encoder_terms, delay=assumptions.delay)
    split = choices.encoder_terms and len(rows.identifiable.flanks) == 2
    joint = rows.told != "" and (
        assumptions.delay == "free" or (assumptions.delay == "auto" and rows.told == "speeds")
    )
    solution = _solved(pair, rows, assumptions.values, split=split, joint=joint)
    delay = _delay(rows, solution, assumptions.delay)
    found = parameters_of(pair, rows.identifiable, solution, choices, delay)
    parameters = {
        name: planned_parameter(one, assumptions.values.get(name), wanted.get(name))
        for name, one in found.items()
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
        outcome_of(found, solution.converged, choices),
        solution.covariance,
        solution.names,
        rows.identifiable.short,
        solution.weakest,
        notes(pair, run, rows, assumptions.options, delay, assumptions.noise),
    )


def _solved(
    pair: GearPair | Drive,
    rows: PlannedRows,
    values: Mapping[str, float],
    *,
    split: bool,
    joint: bool,
) -> Solution:
    """The solution of a log without noise; its covariance is that of one with it."""
    columns = columns_of(rows, with_delay=joint)
    terms, flanks = rows.identifiable.terms, rows.identifiable.flanks
    if isinstance(pair, Drive):
        relation = drive_relation(terms, columns, flanks)
    else:
        relation = pair_relation(pair, terms, columns, flanks, encoder_terms=split)
    tied = np.asarray(relation.coefficients(jnp.asarray(cartesian(relation.names, values))))
    with_ramps = joint and rows.told == "ramps"
    return solve(relation, whitened_flanks(rows, columns, tied, with_ramps=with_ramps))


def _delay(rows: PlannedRows, solution: Solution, choice: DelayChoice) -> Delay:
    """What the fit will know of a delay."""
    forced = choice == "free"
    if choice == "off":
        reason = "not fitted: both channels are taken to be sampled at the same instant"
        return Delay("off", reason=reason)
    if DELAY in solution.names:
        return Delay("fitted", forced=forced)
    if not rows.told:
        like = "the constant backlash" if len(rows.identifiable.flanks) == 2 else "an offset"
        reason = f"at one steady speed a delay cannot be told from {like}; plan a second speed"
        return Delay("open", reason=reason, forced=forced)
    reason = "seen in the ramps only; the other parameters take it as zero"
    return Delay("insignificant", std_s=delay_std(rows, solution), reason=reason)
