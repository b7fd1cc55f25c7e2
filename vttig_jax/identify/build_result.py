"""Construction of the result of a fit from the compressed logs."""

from collections.abc import Callable
from dataclasses import replace

import msgspec
import numpy as np

from ..base.units import DEG
from ..logs.readers.backlash_readings import BacklashReadings
from ..pair.gear_pair import Drive, GearPair
from .compress.harmonic_summary import HarmonicSummary
from .evidence import Evidence
from .fit_result import Fit
from .model.forward_model import ForwardModel, relation_of
from .model.identifiability import Identifiability
from .noise.noise_model import NoiseModel, WhitenedFlank, whiten
from .preliminary.delay import one_speed
from .preliminary.linear_fit import LinearFit
from .preliminary.model_selection import FEW_TURNS, SelectedModel
from .report.backlash_readings import (
    comparison,
    gap_of_both_flanks,
    gap_of_one_flank,
    judged,
    require_gap,
    updated,
    with_constant_backlash,
)
from .report.check_records import checks_of
from .report.checks import REMEMBERS, ReadingsComparison, ResidualLine, Whiteness
from .report.covered_gap import covered_gap, depends_on_speed, gap_by_speed
from .report.notes import conditions_of, notes_of, speed_note
from .report.order_table import fitted_model, order_table
from .report.parameters import NORMAL_95, outcome_of, parameters_of, regressors_of
from .report.per_log import DelayChange, delay_change, log_record
from .report.residual_tests import explained, lines_left, whiteness
from .settings import FitSettings
from .solve.least_squares import Solution, solve
from .solve.residuals import (
    Weights,
    curves_and_residuals,
    flank_coefficients,
    lifted,
    restored,
    sample_residual_rms,
    weights_of_logs,
)
from .solve.sandwich import widened, widened_on_few_turns

_CLEARLY = 6.0
"""Least size of a gap below zero that contradicts the log, in rms residuals; a smaller one may be
friction or wind-up (chosen value)."""

_OF_CHANGE = 0.3  # half-width of the delay's interval as a share of its change; chosen value


def build_fit(
    selected: SelectedModel,
    pair: GearPair | Drive,
    identifiable: Identifiability,
    settings: FitSettings,
    readings: BacklashReadings | None,
) -> Fit:
    """Solve for the parameters, and build the result with orders, checks and notes."""
    summary, linear = selected.summary, selected.linear
    both_flanks = len(identifiable.flanks) == 2
    split = both_flanks and not (settings.perfect_encoders or settings.perfect_gears)
    noise, whitened = whiten(summary, selected.weights.variance_factor)
    relation = _relation(summary, pair, identifiable, split, settings)
    solution = restored(solve(relation, whitened), linear.levels)
    few_turns = isinstance(pair, Drive) and identifiable.turns["driving"] < FEW_TURNS
    solution, white = _with_blocks(linear, summary, noise, whitened, solution, few_turns)
    solution, compared = _with_readings(
        readings, pair, linear, summary, whitened, solution, settings.use_readings
    )
    coefficients = flank_coefficients(whitened, solution)
    weights = weights_of_logs(summary, coefficients)
    change = delay_change(linear) if selected.delay.state == "fitted" else None
    solution = _with_change(solution, change)
    margin = _delay_margin(selected, identifiable)
    parameters = parameters_of(pair, identifiable, solution, settings, selected.delay, margin)
    regressors = regressors_of(solution, linear.inputs[0].log)
    orders = order_table(summary, whitened, solution, coefficients)
    curves, residuals = curves_and_residuals(linear, weights)
    model = fitted_model(summary, coefficients, linear.levels[0])
    unsure = max(margin, _delay_error(selected, identifiable))
    gap = covered_gap(linear, model, summary, whitened, solution, coefficients, unsure)
    gaps = ()
    if gap.value is not None:
        gaps = gap_by_speed(linear, weights, gap.value, noise.correlation_s)
    residual_deg = sample_residual_rms(linear, weights) / DEG
    contradiction = gap.is_contradiction and -(gap.value or 0.0) > _CLEARLY * residual_deg
    logs = tuple(log_record(linear, solution, log) for log in range(len(linear.inputs)))
    return Fit(
        pair=pair,
        source=", ".join(one.log.source for one in linear.inputs),
        sha256=" ".join(one.log.sha256 for one in linear.inputs),
        outcome=outcome_of(parameters, solution.converged, settings, contradiction=contradiction),
        flanks=identifiable.flanks,
        samples={key: sum(log.samples[key] for log in logs) for key in logs[0].samples},
        zero=logs[0].zero,
        zero_readings=logs[0].zero_readings,
        conditional_on=conditions_of(pair, split, settings, selected),
        parameters=parameters,
        orders=orders,
        model=model,
        noise=noise,
        residual_rms_deg=residual_deg,
        curves=curves,
        residuals=residuals,
        covariance=solution.covariance,
        covariance_names=solution.names,
        values=solution.values,
        regressors=regressors,
        checks=checks_of(
            selected,
            solution,
            pair,
            parameters,
            orders,
            curves,
            white,
            compared,
            gap,
            gaps,
            explained(linear, summary.columns, weights),
            _lines(linear, weights, noise),
        ),
        notes=(
            *notes_of(selected, identifiable, solution, noise, regressors, logs),
            *([speed_note(gaps)] if depends_on_speed(gaps) else []),
            *([change.sentence] if change and change.is_clear else []),
        ),
        logs=logs,
        evidence=_evidence(selected, solution, noise, split, settings),
    )


def _with_change(solution: Solution, change: DelayChange | None) -> Solution:
    """Return the solution with a standard error of the delay that contains its change.

    The half-width of the interval is at least 0.3 of a clear change between the halves of a log.
    """
    if change is None or not change.is_clear or "delay" not in solution.names:
        return solution
    place = solution.names.index("delay")
    std = float(np.sqrt(solution.covariance[place, place]))
    scale = np.ones(len(solution.names))
    scale[place] = max(_OF_CHANGE * abs(change.change_s) / (NORMAL_95 * std), 1.0)
    return replace(solution, covariance=solution.covariance * np.outer(scale, scale))


def _delay_margin(selected: SelectedModel, identifiable: Identifiability) -> float:
    """Return the gap in rad that a delay within its bound looks like.

    It is zero for a delay that is fitted, given or excluded.
    """
    delay = selected.delay
    if delay.state != "open" or delay.forced:
        return 0.0
    return _gap_like(identifiable, delay.within_s)


def _delay_error(selected: SelectedModel, identifiable: Identifiability) -> float:
    """Return the gap in rad that the error of an insignificant delay looks like at one speed."""
    delay = selected.delay
    if delay.state != "insignificant":
        return 0.0
    if not one_speed([s for own in identifiable.segments for s in own]):
        return 0.0
    return _gap_like(identifiable, NORMAL_95 * delay.std_s)


def _gap_like(identifiable: Identifiability, delay_s: float) -> float:
    """Return the gap in rad that a delay looks like: 2 i |ω₁| times the delay."""
    speeds = [abs(s.speed) for own in identifiable.segments for s in own]
    if len(identifiable.flanks) < 2 or not speeds:
        return 0.0
    return 2 * float(identifiable.terms.ratio) * max(speeds) * delay_s


def _relation(
    summary: HarmonicSummary,
    pair: GearPair | Drive,
    identifiable: Identifiability,
    split: bool,
    settings: FitSettings,
) -> ForwardModel:
    """Return the forward model; `split` separates gear eccentricities from encoder errors."""
    return relation_of(
        pair,
        identifiable.terms,
        summary.columns,
        identifiable.flanks,
        encoder_terms=split,
        gear_terms=not settings.perfect_gears,
    )


def _evidence(
    selected: SelectedModel,
    solution: Solution,
    noise: NoiseModel,
    split: bool,
    settings: FitSettings,
) -> Evidence:
    """Return the compressed logs and the solution for the posterior."""
    linear = selected.linear
    return Evidence(
        lifted(selected.summary, linear.levels),
        split,
        not settings.perfect_gears,
        tuple(n for n, good in zip(solution.names, solution.determined, strict=True) if good),
        solution.jacobian,
        noise.partial,
        selected.weights.variance_factor,
        linear.channels[0].delay_s,
    )


def _lines(
    linear: LinearFit, weights: list[Weights], noise: NoiseModel
) -> Callable[[], list[ResidualLine]]:
    """Return the function that searches the residual for lines, for a later call.

    It keeps the block rows but not the samples. A log without noise is not searched.
    """
    if noise.is_rounding:
        return list
    rows, terms, same_zero = linear.rows, linear.model.terms, linear.model.same_zero
    return lambda: lines_left(rows, weights, terms, same_zero=same_zero)


def _with_blocks(
    linear: LinearFit,
    summary: HarmonicSummary,
    noise: NoiseModel,
    whitened: tuple[WhitenedFlank, ...],
    solution: Solution,
    few_turns: bool,
) -> tuple[Solution, Whiteness | None]:
    """Replace the standard errors by those from the log itself if the noise model may be wrong.

    On few turns cosines of the scores decide. Otherwise a test of the whitened residual decides
    whether blocks of the log do. Both are omitted if the residual is rounding, which
    follows the digits of the readings and no noise model.

    **Returns** the solution, and the record of the test or None.
    """
    if noise.is_rounding:
        return solution, None
    coefficients = flank_coefficients(whitened, solution)
    curves, residuals = curves_and_residuals(linear, weights_of_logs(summary, coefficients))
    noises = [noise.at(curve.mean_speed) for curve in curves]
    white = whiteness(residuals, [curve.time for curve in curves], noises)
    if few_turns:
        estimate = widened_on_few_turns
    elif white is None or white.probability >= REMEMBERS:
        return solution, white
    else:
        estimate = widened
    widening = estimate(linear, summary, noise, whitened, solution, coefficients)
    covariance = solution.covariance * np.outer(widening, widening)
    if white is not None:
        white = msgspec.structs.replace(white, widening=float(widening.max()))
    return replace(solution, covariance=covariance), white


def _with_readings(
    readings: BacklashReadings | None,
    pair: GearPair | Drive,
    linear: LinearFit,
    summary: HarmonicSummary,
    whitened: tuple[WhitenedFlank, ...],
    solution: Solution,
    as_data: bool,
) -> tuple[Solution, ReadingsComparison | None]:
    """Compare backlash readings with the fitted backlash.

    **Returns** the solution and the record of the comparison, None without readings. If `as_data`,
    the readings are further data of the solution.
    """
    if readings is None:
        return solution, None
    flanks = [flank.flank for flank in summary.flanks]
    require_gap(pair, flanks, as_data, readings.source)
    driving = readings.driving_angle
    if len(flanks) == 2:
        coefficients = flank_coefficients(whitened, solution)
        model = fitted_model(summary, coefficients, linear.levels[0])
        gap = gap_of_both_flanks(driving, model, summary, whitened, solution, coefficients)
    else:
        assert isinstance(pair, GearPair)  # checked by `require_gap`
        solution = with_constant_backlash(solution)
        gap = gap_of_one_flank(driving, pair, solution, summary.flanks[0].flank)
    compared = comparison(readings, gap, solution, used=as_data)
    if len(flanks) == 2:
        compared = judged(compared, gap)
    return (updated(solution, gap, readings) if as_data else solution), compared
