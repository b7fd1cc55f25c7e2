"""Construction of the result of a fit from the compressed logs."""

from collections.abc import Mapping
from dataclasses import replace

import msgspec
import numpy as np
from jaxtyping import Float

from ..base.numerics.quantiles import NORMAL_95
from ..base.units import DEG
from ..logs.readers.backlash_readings import BacklashReadings
from ..pair.gear_pair import Drive, Flank, GearPair
from .evidence import Evidence
from .fit_result import Fit
from .given_parameters import with_given, without_relation
from .model.column_layout import own_parameters
from .model.fitted_model import fitted_model
from .model.forward_model import relation_of
from .model.given_model import GivenModel
from .model.identifiability import SINGLE_TURN, Identifiability
from .noise.noise_model import whiten
from .preliminary.delay import Delay
from .preliminary.delay_blocks import blocks_of_logs
from .preliminary.delay_change import (
    DelayChange,
    change_between_fits,
    delay_change,
    with_rival,
    with_two_delays,
)
from .preliminary.delay_check import rest_of_delay
from .preliminary.delays_of_logs import DelaysOfLogs, delays_of_logs
from .preliminary.model_selection import SelectedModel, with_least_drift
from .preliminary.wander import with_walk
from .report.check_records import Lines, checks_of
from .report.checks import REMEMBERS, ReadingsComparison, Whiteness
from .report.comparisons.backlash_readings import (
    comparison,
    gap_of_both_flanks,
    gap_of_one_flank,
    judged,
    require_gap,
    updated,
    with_constant_backlash,
)
from .report.conditions import conditions_of, is_split
from .report.covered_gap import covered_gap, gap_deviations, least_stds
from .report.estimate import Estimate
from .report.gap_of_delay import allowing_for, gap_of_delay
from .report.notes import notes_of, warnings_of
from .report.order_table import order_table
from .report.parameters import outcome_of, parameters_of, regressors_of
from .report.per_log import log_record
from .report.residual_tests import whiteness
from .settings import FitSettings
from .solve.beside import beside, beside_walk
from .solve.frozen_levels import with_frozen_levels
from .solve.least_squares import solve
from .solve.residuals import (
    lifted,
    restored,
    sample_residual_rms,
)
from .solve.sandwich import Scatter, widened
from .solve.solved_fit import SolvedFit
from .solve.uncertain_delay import with_uncertain_delay

_OF_CHANGE = 0.3  # least half-width of the interval of the delay, relative to its change; chosen


def build_fit(
    selected: SelectedModel,
    estimate: Estimate,
    pair: GearPair | Drive,
    identifiable: Identifiability,
    settings: FitSettings,
    *,
    lines: Lines,
) -> Fit:
    """Build the result with orders, checks and notes; `lines` are spectral lines; see `Lines`."""
    linear, split = selected.linear, is_split(identifiable, settings)
    solved, solution = estimate.solved, estimate.solved.solution
    delay = _with_change(selected.delay, estimate.change)
    of_delay = gap_of_delay(delay, identifiable)
    given = _at_solution(solved)
    known = identifiable if given is None else without_relation(identifiable)
    parameters = allowing_for(of_delay, parameters_of(pair, known, solution, settings, delay))
    parameters = parameters if given is None else with_given(parameters, solved, given)
    regressors = regressors_of(solution, linear.inputs[0].log)
    orders = order_table(solved, estimate.scatter, short=identifiable.short)
    residual_rms = sample_residual_rms(linear, solved.weights)
    curves, residuals = solved.curves_and_residuals
    gap = covered_gap(estimate, of_delay, unbounded=delay.is_unbounded)
    checks = checks_of(
        selected, estimate, pair, parameters, orders=orders, gap=gap, of_delay=of_delay, found=lines
    )
    logs = tuple(log_record(linear, solution, log) for log in range(len(linear.inputs)))
    warnings = warnings_of(selected, identifiable, estimate, regressors, logs, checks=checks)
    return Fit(
        pair=pair,
        source=", ".join(one.log.source for one in linear.inputs),
        sha256=" ".join(one.log.sha256 for one in linear.inputs),
        outcome=outcome_of(
            parameters,
            solution.converged,
            settings,
            contradiction=gap.contradicts(residual_rms / DEG),
        ),
        flanks=identifiable.flanks,
        samples={key: sum(log.samples[key] for log in logs) for key in logs[0].samples},
        zero=logs[0].zero,
        zero_readings=logs[0].zero_readings,
        conditional_on=conditions_of(pair, split, settings, selected),
        parameters=parameters,
        orders=orders,
        model=solved.model,
        given=None if given is None else fitted_model(given, solved.model),
        noise=solved.noise,
        residual_rms_deg=residual_rms / DEG,
        curves=curves,
        residuals=residuals,
        covariance=solution.covariance,
        covariance_names=solution.names,
        values=solution.values,
        regressors=regressors,
        checks=checks,
        warnings=warnings,
        notes=(*warnings, *notes_of(selected, identifiable, estimate, of_delay, settings)),
        logs=logs,
        evidence=_evidence(selected, solved, settings, split) if given is None else None,
    )


def _at_solution(solved: SolvedFit) -> GivenModel | None:
    """Return the given flank model with the parameters of the solution; None without one."""
    given, solution = solved.linear.model.given, solved.solution
    if given is None:
        return None
    return given.updated(solution.names, solution.values)


def estimate_of(
    solved: SolvedFit,
    selected: SelectedModel,
    pair: GearPair | Drive,
    identifiable: Identifiability,
    *,
    settings: FitSettings,
    readings: BacklashReadings | None,
) -> Estimate:
    """Return the parameters with standard errors that the log itself and the readings support.

    **Arguments**
    - `solved`: parameters with the standard errors of the noise model, from `solve_model`.
    """
    solved, white, scatter = _with_own_errors(solved, identifiable)
    own_errors = _widening(solved)
    frozen = None
    if identifiable.turns["driving"] >= SINGLE_TURN:  # a table of one turn holds places
        solved, frozen = with_frozen_levels(solved)
    other = None if _has_own_drift(identifiable, settings) else with_walk(selected)
    walk = None
    if other is not None:
        solved, walk = beside_walk(solved, solve_model(other, pair, identifiable, settings))
    # The constant backlash is undetermined there, so that only the covered gap has to contain it.
    other = with_least_drift(selected)
    least_drift = other and solve_model(other, pair, identifiable, settings)
    solved, compared = _with_readings(solved, readings, pair, settings.use_readings)
    fitted = selected.delay.state == "fitted"
    # Delays of opposite signs in the two halves have a mean that is not significant.
    tested = fitted or selected.delay.state == "insignificant"
    change, blocks = None, ()
    if tested and walk is None:
        names = solved.solution.names
        factor = own_errors[names.index("delay")] if fitted else own_errors.max(initial=1.0)
        blocks = blocks_of_logs(selected, float(factor))
        change = with_rival(delay_change(blocks), selected)
    elif tested:  # a level that moves within a block looks like another delay there
        change = with_rival(change_between_fits(selected.linear), selected)
    two_delays = None
    if change is not None and change.is_clear:
        two_delays = solve_model(with_two_delays(selected), pair, identifiable, settings)
        solved, _ = beside(solved, two_delays, without=("delay",))
    delays = delays_of_logs(selected.linear) if fitted else None
    solved = with_uncertain_delay(solved, selected.delay, blocks)
    deviations = gap_deviations(solved)
    least = least_stds(deviations, float(identifiable.terms.ratio))
    return Estimate(
        solved=_with_least_stds(_with_delays(solved, change, delays), least),
        whiteness=white,
        scatter=scatter,
        readings=compared,
        change=change,
        delays=delays,
        walk=walk,
        two_delays=two_delays,
        least_drift=least_drift,
        crossed=selected.crossed,
        rest_of_delay=_rest_of_delay(selected),
        frozen=frozen,
        gap_deviations=deviations,
        least_gap_std=least.get("constant_backlash", 0.0),
    )


def _rest_of_delay(selected: SelectedModel) -> tuple[float, float] | None:
    """Return the delay, s, that contradicts the stated one, with its standard error; or None."""
    if selected.delay.state not in ("off", "given"):
        return None
    names, _ = own_parameters(selected.summary.columns)
    return rest_of_delay(selected.weights, selected.linear, names)


def solve_model(
    selected: SelectedModel,
    pair: GearPair | Drive,
    identifiable: Identifiability,
    settings: FitSettings,
) -> SolvedFit:
    """Return the parameters with the standard errors of the noise model."""
    summary, linear = selected.summary, selected.linear
    noise, whitened = whiten(
        summary, selected.weights.variance_factor, few_turns=identifiable.few_turns
    )
    relation = relation_of(
        pair,
        identifiable.terms,
        summary.columns,
        identifiable.flanks,
        encoder_terms=is_split(identifiable, settings),
        gear_terms=not settings.perfect_gears,
    )
    solution = restored(solve(relation, whitened), linear.levels, linear.model.given)
    return SolvedFit(
        linear=linear,
        summary=summary,
        noise=noise,
        whitened=whitened,
        solution=solution,
        model_covariance=solution.covariance,
    )


def _with_own_errors(
    solved: SolvedFit, identifiable: Identifiability
) -> tuple[SolvedFit, Whiteness | None, Scatter | None]:
    """Replace the standard errors by those from the log itself if the noise model may be wrong.

    On few turns they come from cosine sums of the scores and from noise correlated from run to run,
    in a table of a single turn from the cosine sums alone. On more turns they come from the scatter
    of blocks of the log, if a test shows that the whitened residual is still correlated. If the
    residual is only rounding, which follows no noise model, there is no test and no replacement.

    **Returns** the solution, the record of the test, and the source of the standard errors; it is
    None if they are those of the noise model.
    """
    noise, solution = solved.noise, solved.solution
    if noise.is_rounding:
        return solved, None, None
    curves, residuals = solved.curves_and_residuals
    noises = [noise.at(curve.mean_speed) for curve in curves]
    white = whiteness(residuals, [curve.time for curve in curves], noises)
    few_turns = identifiable.few_turns
    if not few_turns and (white is None or white.probability >= REMEMBERS):
        return solved, white, None
    scatter: Scatter = "blocks"
    if few_turns:
        scatter = "memory" if identifiable.turns["driving"] >= SINGLE_TURN else "cosines"
    widening = widened(solved, scatter)
    covariance = solution.covariance * np.outer(widening, widening)
    if white is not None:
        white = msgspec.structs.replace(white, widening=float(widening.max()))
    return replace(solved, solution=replace(solution, covariance=covariance)), white, scatter


def _has_own_drift(identifiable: Identifiability, settings: FitSettings) -> bool:
    """Return whether the drift is not selected by BIC, because of few turns or a setting of it."""
    return settings.states_drift or identifiable.few_turns


def _with_readings(
    solved: SolvedFit,
    readings: BacklashReadings | None,
    pair: GearPair | Drive,
    as_data: bool,
) -> tuple[SolvedFit, ReadingsComparison | None]:
    """Compare backlash readings with the fitted backlash.

    **Returns** the solution and the record of the comparison, None without readings. If `as_data`,
    the readings are further data of the solution.
    """
    if readings is None:
        return solved, None
    flanks: list[Flank] = [flank.flank for flank in solved.summary.flanks]
    given = solved.linear.model.given is not None
    require_gap(pair, flanks, as_data, readings.source, given=given)
    driving = readings.driving_angle
    if len(flanks) == 2:
        gap = gap_of_both_flanks(driving, solved)
        compared = judged(comparison(readings, gap, solved.solution, used=as_data), gap)
    else:
        assert isinstance(pair, GearPair)  # checked by `require_gap`
        solved = replace(solved, solution=with_constant_backlash(solved.solution))
        gap = gap_of_one_flank(driving, pair, solved.solution, flanks[0])
        compared = comparison(readings, gap, solved.solution, used=as_data)
    if as_data:
        solved = replace(solved, solution=updated(solved.solution, gap, readings))
    return solved, compared


def _with_delays(
    solved: SolvedFit, change: DelayChange | None, delays: DelaysOfLogs | None
) -> SolvedFit:
    """Return the solution with a standard error of the delay that allows for changes of the delay.

    The half-width of its 95 % interval is at least 0.3 of a clear change between the halves of a
    log. If the delays of the logs differ, the interval contains all of them, and it is at least as
    wide as the interval of their mean.
    """
    if "delay" not in solved.solution.names:
        return solved
    half = _least_half_width_s(change)
    if delays is not None and delays.differ:
        place = solved.solution.names.index("delay")
        value = solved.linear.channels[0].delay_s + float(solved.solution.values[place])
        half = max(half, NORMAL_95 * delays.mean_std_s, delays.farthest_s(value))
    return _with_least_stds(solved, {"delay": half / NORMAL_95})


def _with_change(delay: Delay, change: DelayChange | None) -> Delay:
    """Return the delay; the interval of one that is not fitted also contains part of a change."""
    return replace(delay, std_s=max(delay.std_s, _least_half_width_s(change) / NORMAL_95))


def _least_half_width_s(change: DelayChange | None) -> float:
    """Return the least half-width of the interval of a delay with this change, s."""
    return 0.0 if change is None or not change.is_clear else _OF_CHANGE * abs(change.change_s)


def _with_least_stds(solved: SolvedFit, least: Mapping[str, float]) -> SolvedFit:
    """Increase the standard errors to at least those in `least`; correlations do not change."""
    solution = solved.solution
    stds = np.sqrt(np.diag(solution.covariance))
    wanted = np.array([least.get(name, 0.0) for name in solution.names])
    scale = np.where(wanted > stds, wanted / np.where(stds > 0, stds, 1.0), 1.0)
    if np.all(scale == 1.0):
        return solved
    covariance = solution.covariance * np.outer(scale, scale)
    return replace(solved, solution=replace(solution, covariance=covariance))


def _evidence(
    selected: SelectedModel, solved: SolvedFit, settings: FitSettings, split: bool
) -> Evidence:
    """Return the compressed logs and the solution for the posterior."""
    linear, solution = solved.linear, solved.solution
    return Evidence(
        summary=lifted(solved.summary, linear.levels),
        encoder_terms=split,
        gear_terms=not settings.perfect_gears,
        determined=tuple(
            n for n, good in zip(solution.names, solution.determined, strict=True) if good
        ),
        jacobian=solution.jacobian,
        partial=solved.noise.partial,
        variance_factor=selected.weights.variance_factor,
        delay_s=linear.channels[0].delay_s,
        widening=_widening(solved),
    )


def _widening(solved: SolvedFit) -> Float[np.ndarray, " p"]:
    """Return the final standard errors divided by those of the noise model, at least 1.

    The factor of a constant backlash that only readings determine is 1.
    """
    final, alone = np.diag(solved.solution.covariance), np.diag(solved.model_covariance)
    alone = np.pad(alone, (0, len(final) - len(alone)))
    known = np.isfinite(final) & (alone > 0)
    square = np.divide(final, alone, where=known, out=np.ones(len(final)))
    return np.sqrt(np.maximum(square, 1.0))
