"""From the compressed logs to the result: solve, name, check."""

from dataclasses import replace
from pathlib import PurePath

import numpy as np

from ..base.units import ARCSEC, DEG
from ..logs.encoder_log import EncoderLog
from ..logs.ratio import seen_ratio
from ..logs.readings import BacklashReadings
from ..pair.gears import Drive, GearPair
from .agreement import disagreements, refuse_different_rigs
from .alone import differences, log_alone
from .channels import is_shared
from .checks import closure, reversal_jumps
from .choices import Choices
from .delay import one_speed
from .diagnostics import lines_left, whiteness
from .gather import Gathered
from .noise import WhitenedFlank, whiten
from .order_table import fitted_model, order_table
from .parameters import Parameter
from .readings import (
    comparison,
    gap_of_both_flanks,
    gap_of_one_flank,
    require_gap,
    require_plausible,
    updated,
    with_constant_backlash,
)
from .relation import drive_relation, encoder_relation, pair_relation
from .repeatability import halves, passes
from .reporting import (
    apparent_gap,
    outcome_of,
    parameters_of,
    regressors_of,
    variable_backlash_deg,
)
from .residual import (
    curves_and_residuals,
    flank_coefficients,
    sample_residual_rms,
    weights_of_logs,
)
from .result import Fit
from .sandwich import widened
from .scope import Scope
from .solve import Solution, solve
from .starts import SHAFTS, START
from .summary import HarmonicSummary
from .view import View

_CORRELATED = 0.9
REMEMBERS = 1e-3
"""Ljung–Box probability below which standard errors are taken from blocks."""


def assembled(
    gathered: Gathered,
    pair: GearPair | Drive,
    scope: Scope,
    choices: Choices,
    readings: BacklashReadings | None,
) -> Fit:
    """Solve for the parameters and gather everything a reader wants to see beside them."""
    summary, view = gathered.summary, gathered.view
    split = choices.encoder_terms and choices.gear_terms and len(scope.flanks) == 2
    columns, flanks = summary.columns, scope.flanks
    if not choices.gear_terms:
        relation = encoder_relation(scope.terms, columns, flanks, float(pair.ratio))
    elif isinstance(pair, Drive):
        relation = drive_relation(scope.terms, columns, flanks)
    else:
        relation = pair_relation(pair, scope.terms, columns, flanks, encoder_terms=split)
    agreement = _agreement(view)
    noise, whitened = whiten(summary, gathered.weights.variance_factor)
    solution = solve(relation, whitened)
    coefficients = flank_coefficients(whitened, solution)
    _, residuals = curves_and_residuals(view, weights_of_logs(summary, coefficients))
    white = whiteness(residuals, noise)
    widening = np.ones(len(solution.names))
    if white is not None and white["probability"] < REMEMBERS:
        widening = widened(view, summary, noise, whitened, solution, coefficients)
        spread = solution.covariance * np.outer(widening, widening)
        solution = replace(solution, covariance=spread)
    compared = None
    if readings is not None:
        solution, compared = _with_readings(
            readings, pair, summary, whitened, solution, choices.use_readings
        )
        coefficients = flank_coefficients(whitened, solution)
    weights = weights_of_logs(summary, coefficients)
    parameters = parameters_of(pair, scope, solution, choices, gathered.delay)
    regressors = regressors_of(solution, view.inputs[0].log)
    orders = order_table(summary, whitened, solution, coefficients)
    curves, residuals = curves_and_residuals(view, weights)
    first = view.inputs[0].log
    alone = [log_alone(view, log) for log in range(len(view.inputs))]
    records = [_record(view, solution, log) for log in range(len(view.inputs))]
    return Fit(
        pair=pair,
        source=", ".join(one.log.source for one in view.inputs),
        sha256=" ".join(one.log.sha256 for one in view.inputs),
        outcome=outcome_of(parameters, solution.converged, choices),
        flanks=scope.flanks,
        samples={key: sum(r["samples"][key] for r in records) for key in records[0]["samples"]},
        zero=first.zero,
        zero_readings=records[0]["zero_readings"],
        conditional_on=_conditions(pair, split, choices, gathered),
        parameters=parameters,
        orders=orders,
        model=fitted_model(summary, coefficients),
        noise=noise,
        residual_rms_deg=sample_residual_rms(view, weights) / DEG,
        curves=curves,
        residuals=residuals,
        covariance=solution.covariance,
        covariance_names=solution.names,
        values=solution.values,
        regressors=regressors,
        checks={
            "order_spectrum": [o.to_json() for o in orders if o.order == 1 and o.shaft != "mesh"],
            "closure": closure(curves, pair),
            "passes": [
                {"log": number, **one}
                for number, rows in enumerate(view.rows, 1)
                for one in passes([run.curve for run in rows.runs])
            ],
            "halves": [
                {"log": number, **one}
                for number, rows in enumerate(view.rows, 1)
                for one in halves(rows, scope.terms)
            ],
            "whiteness": None if white is None else white | {"widening": float(widening.max())},
            "lines": lines_left(view.rows, weights, same_zero=view.model.same_zero),
            "reversals": [
                jump
                for log in range(len(view.inputs))
                for jump in _reversals(view, log, solution, pair, parameters)
            ],
            "drawing_backlash_deg": _drawing_backlash_deg(pair),
            "ratio": [_ratio(one.log) for one in view.inputs],
            "agreement": agreement,
            "apparent_gap": apparent_gap(solution),
            "readings": compared,
            **_drift(gathered, solution),
            "outliers": [found.to_json() for found in gathered.weights.outliers],
            "weakest_direction": solution.weakest.to_json() if solution.weakest else None,
            "solver_steps": solution.steps,
        },
        notes=(
            *_notes(gathered, scope),
            *_delay_notes(gathered, scope, solution),
            *_ratio_notes(regressors, first),
            *differences(alone),
        ),
        logs=tuple(record | {"alone": one} for record, one in zip(records, alone, strict=True)),
    )


def _with_readings(
    readings: BacklashReadings,
    pair: GearPair | Drive,
    summary: HarmonicSummary,
    whitened: tuple[WhitenedFlank, ...],
    solution: Solution,
    as_data: bool,
) -> tuple[Solution, dict]:
    """Compare readings with the gap the fit expects and, on request, let them join it."""
    flanks = [flank.flank for flank in summary.flanks]
    require_gap(pair, flanks, as_data, readings.source)
    driving = readings.driving_angle
    if len(flanks) == 2:
        coefficients = flank_coefficients(whitened, solution)
        model = fitted_model(summary, coefficients)
        gap = gap_of_both_flanks(driving, model, summary, whitened, solution, coefficients)
    else:
        assert isinstance(pair, GearPair)  # held by `require_gap`
        solution = with_constant_backlash(solution)
        gap = gap_of_one_flank(driving, pair, solution)
    compared = comparison(readings, gap, solution) | {"used": as_data}
    if len(flanks) == 2:
        require_plausible(readings, gap, compared, as_data)
    return (updated(solution, gap, readings) if as_data else solution), compared


def _notes(gathered: Gathered, scope: Scope) -> tuple[str, ...]:
    """What was seen in the logs; a note that all of them have stands once."""
    inputs = gathered.view.inputs
    own = [[*one.log.notes, *one.found.notes] for one in inputs]
    for notes, outliers in zip(own, gathered.weights.outliers, strict=False):
        notes.append(outliers.sentence)
    shared = [note for note in own[0] if all(note in notes for notes in own)]
    notes = list(shared)
    for one, each in zip(inputs, own, strict=True):
        front = f"{PurePath(one.log.source).name}: " if len(inputs) > 1 else ""
        notes += [front + note for note in each if note not in shared]
    return (*notes, *scope.notes, *gathered.notes)


def _delay_notes(gathered: Gathered, scope: Scope, solution: Solution) -> list[str]:
    """What a delay and the constant backlash do to each other."""
    state = gathered.delay.state
    if state == "open" and len(scope.flanks) == 2 and not gathered.delay.forced:
        speeds = [abs(s.speed) for own in scope.segments for s in own]
        shift = 2 * float(scope.terms.ratio) * max(speeds) * 1e-6 / DEG
        return [
            f"no delay is assumed: every microsecond of it would pass for {shift:.2g}° of constant"
            " backlash, and the speed is too steady to tell; log a second speed"
        ]
    steady = one_speed([s for own in scope.segments for s in own])
    if state == "fitted" and {"delay", "constant_backlash"} <= set(solution.names):
        pair = [solution.names.index(name) for name in ("delay", "constant_backlash")]
        spread = solution.covariance[np.ix_(pair, pair)]
        correlation = spread[0, 1] / np.sqrt(spread[0, 0] * spread[1, 1])
        if abs(correlation) > _CORRELATED:
            return [
                "delay and constant backlash are hardly told apart (correlation"
                f" {correlation:+.3f}); their standard errors hold that"
                + (", and a second speed would separate them" if steady else "")
            ]
    return []


def _ratio_notes(regressors: tuple[Parameter, ...], log: EncoderLog) -> list[str]:
    """Say so where a free ratio comes out otherwise than given."""
    for one in regressors:
        if one.name == "ratio" and one.significant and one.value is not None:
            off, std = (1e6 * part / float(log.ratio) for part in (one.value, one.std or 0.0))
            return [
                f"the ratio comes out {off - 1e6:+.0f} ± {std:.0f} ppm off {log.ratio} as given;"
                " over a fraction of a turn a slow error or wind-up looks the same"
            ]
    return []


def _conditions(
    pair: GearPair | Drive, split: bool, choices: Choices, gathered: Gathered
) -> tuple[str, ...]:
    conditions: tuple[str, ...] = ()
    if not choices.gear_terms:
        conditions = ("perfect_gears",)
    elif not (isinstance(pair, Drive) or split):
        conditions = ("perfect_encoders",)
    if gathered.delay.state == "given":
        conditions += ("given_delay",)
    unsure = gathered.delay.state == "open" and not gathered.delay.forced
    if unsure and len(gathered.summary.flanks) == 2:
        conditions += ("no_delay",)
    return conditions


def _drift(gathered: Gathered, solution: Solution) -> dict:
    drift = gathered.drift
    longest = max(float(c.time[-1] - c.time[0]) for c in gathered.view.channels)
    return {
        "drift_order": drift.order,
        "drift_knots_s": drift.knots_s or None,
        "drift_stiffness_s": drift.stiffness_s(longest),
        "drift_arcsec": [
            float(value) / ARCSEC
            for name, value in zip(solution.names, solution.values, strict=True)
            if name.startswith(("drift_", "spline_"))
        ],
    }


def _reversals(
    view: View,
    log: int,
    solution: Solution,
    pair: GearPair | Drive,
    parameters: dict[str, Parameter],
) -> list[dict]:
    """The paper's way to the constant backlash: the jump at a reversal less j_v there."""
    channels, one = view.channels[log], view.inputs[log].log
    error = one.transmission_error + float(one.ratio) * (one.driving_angle - channels.driving)
    for name, values in channels.own.items():
        if is_shared(name) and name in solution.names:
            error -= solution.values[solution.names.index(name)] * values
    jumps = reversal_jumps(channels.driving, error, view.inputs[log].found.segments)
    if isinstance(pair, GearPair):
        for jump in jumps:
            variable = variable_backlash_deg(pair, parameters, jump["driving_deg"])
            jump["variable_backlash_deg"] = variable
            jump["constant_backlash_deg"] = jump["jump_deg"] - variable
    return [{"log": log + 1, **jump} for jump in jumps]


def _ratio(log: EncoderLog) -> dict:
    ratio = seen_ratio(log)
    return {
        "given": f"{ratio.given}",
        "seen": ratio.seen,
        "std": ratio.std,
        "verdict": ratio.verdict,
    }


def _agreement(view: View) -> list[dict]:
    """First orders of every log against the first log's; refuses logs of different rigs."""
    if len(view.rows) == 1:
        return []
    found = disagreements(view.rows, view.model.terms, view.starts, same_zero=view.model.same_zero)
    refuse_different_rigs(found, [one.log.source for one in view.inputs])
    return found


def _start(view: View, solution: Solution, log: int) -> dict[str, float | None]:
    """Angles of a log at its zero in the angles of the first, degrees, with standard errors."""
    found: dict[str, float | None] = {}
    for shaft in SHAFTS:
        value, std = getattr(view.starts[log], shaft), 0.0
        name = f"{START[shaft]}_of_{log + 1}"
        if name in solution.names:
            place = solution.names.index(name)
            value += float(solution.values[place])
            std = float(np.sqrt(solution.covariance[place, place]))
        found |= {f"{shaft}_deg": value / DEG % 360, f"{shaft}_std_deg": std / DEG}
    return found


def _record(view: View, solution: Solution, log: int) -> dict:
    """What one log brought: file, samples by flank, where its angles are zero."""
    one, rows = view.inputs[log].log, view.rows[log]
    used = dict.fromkeys("AB", 0)
    for run in rows.runs:
        used[run.segment.flank] += rows.size * len(run.rows)
    total = sum(used.values())
    return {
        "source": one.source,
        "sha256": one.sha256,
        "zero": one.zero,
        "start": _start(view, solution, log),
        "zero_readings": {
            "driving": one.driving.reading[0].item(),
            "driven": None if one.driven is None else one.driven.reading[0].item(),
        },
        "samples": {
            "read": len(one),
            "used": total,
            "forward": used["A"],
            "backward": used["B"],
            "masked": len(one) - total,
        },
    }


def _drawing_backlash_deg(pair: GearPair | Drive) -> float | None:
    return None if isinstance(pair, Drive) else float(pair.drawing_backlash) / DEG
