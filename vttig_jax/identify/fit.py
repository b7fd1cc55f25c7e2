"""From a log to parameters: the main job, in one function."""

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from ..base.errors import NoAnswerError
from ..base.precision import require_x64
from ..base.units import ARCSEC, DEG
from ..logs.encoder_log import EncoderLog
from ..logs.ratio import check_ratio
from ..logs.segments import Segments, find_segments
from ..pair.gears import Drive, Flank, GearPair
from ..pair.spec import FitOptions
from .checks import closure, reversal_jumps
from .drift import AUTOMATIC_DRIFT, HIGHEST_DRIFT, choose_drift, with_drift
from .noise import whiten
from .order_table import fitted_model, order_table
from .parameters import Parameter
from .relation import drive_relation, pair_relation
from .reporting import outcome_of, parameters_of, variable_backlash_deg
from .residual import curve_residuals, sample_residual_rms
from .result import Fit
from .scope import Scope, find_scope
from .solve import solve
from .summary import HarmonicSummary, compress


def fit(
    log: EncoderLog,
    pair: GearPair | Drive,
    *,
    options: FitOptions | None = None,
    flank: Flank | None = None,
    encoder_terms: bool = True,
    drift_order: int | None = None,
) -> Fit:
    """Identify eccentricities, encoder errors and constant backlash from a log.

    The transmission error of each flank is a linear model in the harmonics of both shafts. Its
    first orders follow from the parameters through the exact relation of the pair,

        r_b2 φ₂ = r_b1 φ₁ − (r_b1 + r_b2)(δ ± Δinv) (+ r_b2 j_c on flank B),

    plus + E₂ sin(φ₂ + ε₂) − i E₁ sin(φ₁ + ε₁) on both flanks; the other orders are free on each
    flank. The log is compressed once, its noise is autoregressive, and Levenberg–Marquardt works on
    the compressed log.

    **Arguments**
    - `log`: the encoder log or transmission-error curve.
    - `pair`: the gear pair, or a drive without geometry.
    - `options`: orders to model; those of the pair file by default.
    - `flank`: use this flank only, as the paper does.
    - `encoder_terms`: False takes the encoders to be perfect; with one flank they have to be.
    - `drift_order`: highest power of time (0 … 6); chosen among 0, 1 and 2 by BIC when None.

    **Returns** a `Fit`.

    **Raises** `LogError` for a log that contradicts the pair, `NoAnswerError` for one that is too
    short to say anything, `ValueError` without 64-bit floats.

    **Example**
    ```python
    >>> import vttig_jax
    >>> from vttig_jax.rig.paper import paper_rig
    >>> vttig_jax.enable_x64()
    >>> rig = paper_rig()
    >>> result = vttig_jax.fit(rig.log(), rig.pair)
    >>> round(result.parameters["driving_eccentricity_mm"].value, 3)
    0.023

    ```
    """
    require_x64("fit")
    if flank not in (None, "A", "B"):
        raise ValueError(f'Argument `flank` must be "A", "B" or None, but is {flank!r}.')
    if drift_order is not None and not 0 <= drift_order <= HIGHEST_DRIFT:
        raise ValueError(
            f"Argument `drift_order` must be 0 … {HIGHEST_DRIFT}, but is {drift_order!r}."
        )
    check_ratio(log)
    found = find_segments(log)
    scope = find_scope(log, found.segments, pair, options or pair.fit, flank)
    correction = _axial_correction(log, pair)
    highest = AUTOMATIC_DRIFT if drift_order is None else drift_order
    summary = compress(log, scope.segments, scope.terms, highest, correction)
    _require_rows(summary, log)
    scope = replace(scope, flanks=tuple(f.flank for f in summary.flanks))
    if drift_order is None:
        summary = with_drift(summary, choose_drift(summary))
    return _solved(log, pair, scope, summary, encoder_terms, correction, found)


def _solved(
    log: EncoderLog,
    pair: GearPair | Drive,
    scope: Scope,
    summary: HarmonicSummary,
    encoder_terms: bool,
    correction: dict[str, Float[np.ndarray, " n"]],
    found: Segments,
) -> Fit:
    """Everything after the one pass over the log."""
    drift_order = summary.plan.drift_order
    split = encoder_terms and len(scope.flanks) == 2
    if isinstance(pair, Drive):
        relation = drive_relation(scope.terms, scope.flanks, drift_order)
    else:
        relation = pair_relation(pair, scope.terms, scope.flanks, drift_order, encoder_terms=split)
    noise, whitened = whiten(summary)
    solution = solve(relation, whitened)
    model = fitted_model(summary, whitened, solution)
    parameters = parameters_of(pair, scope, solution, encoder_terms)
    drift = [
        float(value)
        for name, value in zip(solution.names, solution.values, strict=True)
        if name.startswith("drift_")
    ]
    error = {flank: log.transmission_error - correction.get(flank, 0.0) for flank in scope.flanks}
    segments = summary.segments
    rms = sample_residual_rms(summary, log, segments, error, model, drift)
    orders = order_table(summary, whitened, solution)
    return Fit(
        pair=pair,
        source=log.source,
        sha256=log.sha256,
        outcome=outcome_of(parameters, solution.converged, encoder_terms),
        flanks=scope.flanks,
        samples=_samples(log, summary),
        zero=log.zero,
        zero_readings=_zero_readings(log),
        conditional_on=() if isinstance(pair, Drive) or split else ("perfect_encoders",),
        parameters=parameters,
        orders=orders,
        model=model,
        noise=noise,
        residual_rms_deg=rms / DEG,
        curves=summary.curves,
        residuals=curve_residuals(summary, log, segments, model, drift),
        covariance=solution.covariance,
        covariance_names=solution.names,
        values=solution.values,
        checks={
            "order_spectrum": [o.to_json() for o in orders if o.order == 1 and o.shaft != "mesh"],
            "closure": closure(summary.curves, pair),
            "reversals": _reversals(log, found, pair, parameters),
            "drawing_backlash_deg": _drawing_backlash_deg(pair),
            "drift_order": drift_order,
            "drift_arcsec": [value / ARCSEC for value in drift],
            "solver_steps": solution.steps,
        },
        notes=(*log.notes, *found.notes, *scope.notes),
    )


def _reversals(
    log: EncoderLog, found: Segments, pair: GearPair | Drive, parameters: dict[str, Parameter]
) -> list[dict]:
    """The paper's way to the constant backlash: the jump at a reversal less j_v there."""
    jumps = reversal_jumps(log, found.segments)
    if isinstance(pair, GearPair):
        for jump in jumps:
            variable = variable_backlash_deg(pair, parameters, jump["driving_deg"])
            jump["variable_backlash_deg"] = variable
            jump["constant_backlash_deg"] = jump["jump_deg"] - variable
    return jumps


def _axial_correction(
    log: EncoderLog, pair: GearPair | Drive
) -> dict[str, Float[np.ndarray, " n"]]:
    """What a logged axial position s adds to each flank: + s tan β_L/R₂ and − s tan β_R/R₂."""
    if log.axial_mm is None or isinstance(pair, Drive):
        return {}
    (left, right), radius = pair.taper, pair.reference_radii[1]
    return {"A": log.axial_mm * left / radius, "B": -log.axial_mm * right / radius}


def _require_rows(summary: HarmonicSummary, log: EncoderLog) -> None:
    columns = summary.plan.width - 1
    for flank in ("A", "B"):
        found = [f for f in summary.flanks if f.flank == flank]
        rows = sum(f.rows for f in found)
        usable = sum(f.whitened_rows(f.heads.shape[1]) for f in found)
        if (found and usable <= columns) or not summary.flanks:
            raise NoAnswerError(
                f"{rows} averaged samples on flank {flank} are too few for {columns} coefficients"
                " and their noise; record more turns, or list fewer orders in [fit].",
                where=log.source,
            )


def _samples(log: EncoderLog, summary: HarmonicSummary) -> dict[str, int]:
    counts = summary.samples_used
    used = sum(counts.values())
    return {
        "read": len(log),
        "used": used,
        "forward": counts["A"],
        "backward": counts["B"],
        "masked": len(log) - used,
    }


def _zero_readings(log: EncoderLog) -> dict[str, float | int | None]:
    return {
        "driving": log.driving.reading[0].item(),
        "driven": None if log.driven is None else log.driven.reading[0].item(),
    }


def _drawing_backlash_deg(pair: GearPair | Drive) -> float | None:
    return None if isinstance(pair, Drive) else float(pair.drawing_backlash) / DEG
