"""Computation of the checks of a fit as the records of `checks`."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from msgspec.structs import replace

from ...base.units import ARCSEC, DEG
from ...logs.channel.spikes import without_spikes
from ...logs.checks.ratio import seen_ratio
from ...pair.gear_pair import Drive, GearPair
from ..model.column_layout import is_shared
from ..model.mounting import mounting_of
from ..preliminary.linear_fit import Input, LinearFit
from ..preliminary.model_selection import SelectedModel
from ..solve.beside import Walk
from ..solve.least_squares import Solution
from ..solve.solved_fit import SolvedFit
from .checks import (
    Checks,
    CoveredGap,
    Disagreement,
    JoinedLine,
    RatioCheck,
    ResidualLine,
    Reversal,
    Wander,
)
from .comparisons.closure import closure, reversal_jumps
from .comparisons.repeatability import halves, passes
from .comparisons.same_rig import disagreements, refuse_different_rigs
from .covered_gap import compared_jumps, shifted
from .estimate import Estimate
from .gap_of_delay import GapOfDelay
from .order_table import Order
from .parameters import Parameter, variable_backlash_deg
from .per_log import start_of
from .record import Later
from .residual_tests import explained, hidden_shafts, lines_left


@dataclass(frozen=True)
class Lines:
    """Spectral lines of the residual that were found before the checks are computed.

    **Arguments**
    - `joined`: lines that were added to the model as fractional orders.
    - `joint`: lines of both flanks together in the residual of the last fit; None if this residual
      has not been searched.
    """

    joined: tuple[JoinedLine, ...] = ()
    joint: Sequence[ResidualLine] | None = None


def checks_of(
    selected: SelectedModel,
    estimate: Estimate,
    pair: GearPair | Drive,
    parameters: dict[str, Parameter],
    *,
    orders: Sequence[Order],
    gap: CoveredGap,
    of_delay: GapOfDelay | None,
    found: Lines = Lines(),
) -> Checks:
    """Return all checks of a fit.

    The comparisons of passes and halves and the search for lines are computed when they are first
    read; until then they keep the block rows of the logs in memory, but not the samples.
    """
    solved, drift = estimate.solved, selected.drift
    linear, weights, solution = solved.linear, solved.weights, solved.solution
    rows, terms, same_zero = linear.rows, linear.model.terms, linear.model.same_zero
    is_rounding, walk = solved.noise.is_rounding, estimate.walk
    gap_deg = abs(gap.value or 0.0) / abs(float(pair.ratio))
    jumps = _all_reversals(linear, solution, pair, parameters, gap_deg=gap_deg)
    longest = max(float(c.time[-1] - c.time[0]) for c in linear.channels)
    left = lambda: lines_left(rows, weights, terms, same_zero=same_zero, joint=found.joint)  # noqa: E731
    lines = Later(lambda: [] if is_rounding else left())
    return Checks(
        order_spectrum=tuple(one for one in orders if one.order == 1 and one.shaft != "mesh"),
        closure=closure(solved.curves_and_residuals[0], pair),
        whiteness=estimate.whiteness,
        wander=walk and _wander(walk, solved),
        readings=estimate.readings,
        reversals=jumps,
        jumps=compared_jumps(jumps, solved, gap),
        drawing_backlash_deg=_drawing_backlash_deg(pair),
        ratio=tuple(_ratio(one) for one in linear.inputs),
        agreement=_agreement(linear),
        gap_over_angles_covered=gap,
        gap_of_delay=of_delay,
        gap_by_speed=() if gap.value is None else shifted(estimate.gap_deviations, gap.value),
        explained=explained(linear, solved.summary.columns, weights),
        drift_order=drift.order,
        drift_knots_s=drift.knots_s or None,
        drift_stiffness_s=drift.stiffness_s(longest),
        drift_arcsec=_drift_arcsec(solution),
        outliers=selected.weights.outliers,
        weakest_direction=solution.weakest,
        solver_steps=solution.steps,
        passes=Later(
            lambda: [
                difference
                for log, own in enumerate(rows, 1)
                for difference in passes([run.curve for run in own.runs], log)
            ]
        ),
        halves=Later(
            lambda: [
                difference
                for log, own in enumerate(rows, 1)
                for difference in halves(own, terms, log)
            ]
        ),
        lines=lines,
        joined_lines=found.joined,
        hidden_shafts=Later(lambda: hidden_shafts(rows, weights, terms, [*found.joined, *lines])),
    )


def _wander(walk: Walk, solved: SolvedFit) -> Wander:
    left = np.concatenate(solved.curves_and_residuals[1]) / ARCSEC
    rms = float(np.sqrt(np.mean(left**2)))
    step = walk.step_arcsec
    return Wander(step, walk.knots_s, walk.widening, step / rms if rms else 0.0)


def _drift_arcsec(solution: Solution) -> tuple[float, ...]:
    values = zip(solution.names, solution.values, strict=True)
    return tuple(
        float(value) / ARCSEC for name, value in values if name.startswith(("drift_", "spline_"))
    )


def _all_reversals(
    linear: LinearFit,
    solution: Solution,
    pair: GearPair | Drive,
    parameters: dict[str, Parameter],
    *,
    gap_deg: float,
) -> tuple[Reversal, ...]:
    """Return the reversals of all logs, with the jump of the transmission error at each one."""
    return tuple(
        jump
        for log in range(len(linear.inputs))
        for jump in _reversals(linear, log, solution, pair, parameters, gap_deg=gap_deg)
    )


def _reversals(
    linear: LinearFit,
    log: int,
    solution: Solution,
    pair: GearPair | Drive,
    parameters: dict[str, Parameter],
    *,
    gap_deg: float,
) -> list[Reversal]:
    """Return the reversals of one log, each with the constant backlash by the paper's method.

    This constant backlash is the jump of the transmission error at the reversal minus the variable
    backlash j_v at the same angle. It is None for a drive and for a given flank model. `log` counts
    from 0. `gap_deg` is the gap as an angle of the driving shaft.
    """
    channels, one = linear.channels[log], linear.inputs[log].log
    error = one.driving_angle - channels.driving
    error *= float(one.ratio)
    error += one.transmission_error
    for name, values in channels.own.items():
        if is_shared(name) and name in solution.names:
            error -= solution.values[solution.names.index(name)] * values[:]
    error = without_spikes(error, one.time, one.spikes)
    segments = linear.inputs[log].found.segments
    jumps = reversal_jumps(channels.driving, error, segments, log + 1, gap_deg)
    if isinstance(pair, Drive) or linear.model.given is not None:
        return jumps
    start = start_of(linear, solution, log)
    gap = (solution.names, solution.values, [f.flank for f in linear.summary.flanks])
    mounting_deg = mounting_of(*gap, 0.0, log) / DEG
    found = []
    for jump in jumps:
        driven_deg = float(pair.ratio) * jump.driving_deg + mounting_deg
        variable = variable_backlash_deg(
            pair,
            parameters,
            jump.driving_deg + (start.driving_deg or 0.0),
            driven_deg + (start.driven_deg or 0.0),
        )
        constant = jump.jump_deg - variable
        found.append(replace(jump, variable_backlash_deg=variable, constant_backlash_deg=constant))
    return found


def _ratio(one: Input) -> RatioCheck:
    ratio = one.ratio or seen_ratio(one.log)
    return RatioCheck(f"{ratio.given}", ratio.seen, ratio.std, ratio.verdict, ratio.cause)


def _agreement(linear: LinearFit) -> tuple[Disagreement, ...]:
    """Compare the first orders of every log with those of the first log.

    **Raises** `LogError` for logs of different rigs.
    """
    if len(linear.rows) == 1:
        return ()
    found = disagreements(
        linear.rows, linear.model.terms, linear.starts, same_zero=linear.model.same_zero
    )
    refuse_different_rigs(found, [one.log.source for one in linear.inputs])
    return tuple(found)


def _drawing_backlash_deg(pair: GearPair | Drive) -> float | None:
    return None if isinstance(pair, Drive) else float(pair.drawing_backlash) / DEG
