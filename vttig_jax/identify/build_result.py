"""Construction of the result of a fit from the compressed logs."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

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
from .preliminary.linear_fit import LinearFit
from .preliminary.model_selection import SelectedModel
from .report.backlash_readings import (
    comparison,
    gap_of_both_flanks,
    gap_of_one_flank,
    require_gap,
    require_plausible,
    updated,
    with_constant_backlash,
)
from .report.check_records import checks_of, log_record, repetitions_of
from .report.closure import closure
from .report.lazy_checks import Checks
from .report.notes import conditions_of, notes_of
from .report.order_table import Order, fitted_model, order_table
from .report.parameters import outcome_of, parameters_of, regressors_of
from .report.per_log import fit_log_alone
from .report.residual_tests import lines_left, whiteness
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
from .solve.sandwich import widened

REMEMBERS = 1e-3
"""Ljung–Box probability below which standard errors are estimated from blocks; chosen value."""


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
    solution, white = _with_blocks(linear, summary, noise, whitened, solution)
    solution, compared = _with_readings(
        readings, pair, linear, summary, whitened, solution, settings.use_readings
    )
    coefficients = flank_coefficients(whitened, solution)
    weights = weights_of_logs(summary, coefficients)
    parameters = parameters_of(pair, identifiable, solution, settings, selected.delay)
    regressors = regressors_of(solution, linear.inputs[0].log)
    orders = order_table(summary, whitened, solution, coefficients)
    curves, residuals = curves_and_residuals(linear, weights)
    alone = [fit_log_alone(linear, log) for log in range(len(linear.inputs))]
    records = [log_record(linear, solution, log) for log in range(len(linear.inputs))]
    return Fit(
        pair=pair,
        source=", ".join(one.log.source for one in linear.inputs),
        sha256=" ".join(one.log.sha256 for one in linear.inputs),
        outcome=outcome_of(parameters, solution.converged, settings),
        flanks=identifiable.flanks,
        samples={key: sum(r["samples"][key] for r in records) for key in records[0]["samples"]},
        zero=records[0]["zero"],
        zero_readings=records[0]["zero_readings"],
        conditional_on=conditions_of(pair, split, settings, selected),
        parameters=parameters,
        orders=orders,
        model=fitted_model(summary, coefficients, linear.levels[0]),
        noise=noise,
        residual_rms_deg=sample_residual_rms(linear, weights) / DEG,
        curves=curves,
        residuals=residuals,
        covariance=solution.covariance,
        covariance_names=solution.names,
        values=solution.values,
        regressors=regressors,
        checks=Checks(
            {
                "order_spectrum": _first_orders(orders),
                "closure": closure(curves, pair),
                "whiteness": white,
                "readings": compared,
                **checks_of(selected, solution, pair, parameters),
            },
            repetitions_of(linear) | {"lines": _lines(linear, weights, noise)},
        ),
        notes=notes_of(selected, identifiable, solution, noise, regressors, alone),
        logs=tuple(record | {"alone": one} for record, one in zip(records, alone, strict=True)),
        evidence=_evidence(selected, solution, noise, split, settings),
    )


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


def _first_orders(orders: tuple[Order, ...]) -> list[dict[str, Any]]:
    return [order.to_json() for order in orders if order.order == 1 and order.shaft != "mesh"]


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
) -> Callable[[], list[dict[str, Any]]]:
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
) -> tuple[Solution, dict | None]:
    """Replace the standard errors by those from blocks of the log if the noise model is wrong.

    A test of the whitened residual decides. It is omitted if the residual is rounding, which
    follows the digits of the readings and no noise model.

    **Returns** the solution, and the record of the test or None.
    """
    if noise.is_rounding:
        return solution, None
    coefficients = flank_coefficients(whitened, solution)
    curves, residuals = curves_and_residuals(linear, weights_of_logs(summary, coefficients))
    noises = [noise.at(curve.mean_speed) for curve in curves]
    white = whiteness(residuals, [curve.time for curve in curves], noises)
    if white is None or white["probability"] >= REMEMBERS:
        return solution, None if white is None else white | {"widening": 1.0}
    widening = widened(linear, summary, noise, whitened, solution, coefficients)
    covariance = solution.covariance * np.outer(widening, widening)
    return replace(solution, covariance=covariance), white | {"widening": float(widening.max())}


def _with_readings(
    readings: BacklashReadings | None,
    pair: GearPair | Drive,
    linear: LinearFit,
    summary: HarmonicSummary,
    whitened: tuple[WhitenedFlank, ...],
    solution: Solution,
    as_data: bool,
) -> tuple[Solution, dict | None]:
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
    compared = comparison(readings, gap, solution) | {"used": as_data}
    if len(flanks) == 2:
        require_plausible(readings, gap, compared, as_data)
    return (updated(solution, gap, readings) if as_data else solution), compared
