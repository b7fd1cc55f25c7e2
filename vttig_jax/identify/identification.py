"""Identification of a rig from its logs: checks at the door, the mixed model, and its result.

The logs of one fit must be of one pair, distinct and long enough.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from ..base.errors import LogError, NoAnswerError, UsageError
from ..base.runtime import require_x64
from ..base.threads import one_blas_thread
from ..base.units import ARCSEC, DEG
from ..logs.checks.ratio import check_ratio
from ..logs.checks.slip import refuse_slip
from ..logs.encoder_log import EncoderLog
from ..logs.lines.search import Line
from ..logs.motion.flank_assignment import assigned_segments
from ..logs.readers.backlash_readings import BacklashReadings
from ..model.columns import DELAY, RATIO, Assumptions, ColumnName, row_duration, waves_of
from ..model.density import LAGS
from ..model.gears import KINDS
from ..model.lines import found_lines, refined, short_lines
from ..model.mixed_fit import MixedFit, mixed_fit
from ..model.parameter import Parameter
from ..model.parameters import (
    FULL_TURN,
    LEFT_OUT,
    SIGNIFICANT,
    TOLD,
    Quantities,
    parameters_of,
    quantities_of,
)
from ..model.rows import SHAFTS, RowName, Run, Shafts, Wave
from ..model.runs import shafts_of
from ..pair.gear_pair import Drive, GearPair, pair_from_spec
from ..pair.schema import Flank, HarmonicOrders
from .checking import Identified, checks_of, curves_of, noise_of
from .findings import contradicts, findings_of
from .fit_settings import FitSettings, from_keywords, takes_settings
from .given import (
    GIVEN_INSTEAD,
    GivenModel,
    fitted_given,
    fitted_model,
    given_parameters,
    given_quantities,
    prepared,
    searched,
)
from .orders import order_model, order_table
from .readings import compared, updated
from .records import Outcome
from .result import Fit, FitRequest
from .starts import OWN, Turns, log_records, require_one_rig, start_of, with_starts


@takes_settings
@one_blas_thread
def fit(
    log: EncoderLog | Sequence[EncoderLog],
    pair: GearPair | Drive | None = None,
    *,
    settings: FitSettings | None = None,
    orders: HarmonicOrders | None = None,
    readings: BacklashReadings | None = None,
    model: Any = None,
    **changes: Any,
) -> Fit:
    """Identify eccentricities, encoder errors and backlash from the logs of one rig.

    The transmission error of both flanks is one linear mixed model: harmonics of both shafts with
    their difference between the flanks, gap, delay, torque, drift, a delay that moves and a gap
    that depends on the speed, each with a Gaussian prior, in noise with memory. The widths of the
    priors and the noise have the largest restricted likelihood; every number is a functional of
    this posterior. For gears the first orders follow from the parameters through the exact relation

        r_b2 φ₂ = r_b1 φ₁ − (r_b1 + r_b2)(δ ± Δinv) (+ r_b2 j_c on flank B),

    plus + E₂ sin(φ₂ + ε₂) − i E₁ sin(φ₁ + ε₁) on both flanks. `docs/claims.md` has the equations.

    **Arguments**
    - `log`: an encoder log or transmission-error curve, or several of one rig. They share
      eccentricities, orders, constant backlash and delay; offset and drift are each log's own.
      Without a common zero (`same_zero`) the start angles of each further log are found by its
      orders. Amplitudes are then those of all logs, and phases those of the first. Lines, and
      orders whose start nothing tells, are each log's own.
    - `pair`: the gear pair, or a drive without geometry; by default the drive that the first log
      was read with, `read_log(path, ratio="64:23")`.
    - `settings`: delay, ratio, lines and all other choices; see `FitSettings`. Every field of it is
      a keyword of its own as well, `fit(log, pair, delay="off")`.
    - `orders`: harmonic orders to model, a `vttig_jax.pair.HarmonicOrders`; those of the pair by
      default.
    - `readings`: backlash read at single angles of the first log, to check the fit against, or to
      join it with `use_readings=True`.
    - `model`: flank model of your own that takes the place of the exact relation: a pytree with
      `transmission_error(angle, flank)`, rad of the driven gear, for driving angles in rad. Its
      leaves that are arrays of floating-point numbers are parameters, with their values as the
      start; they are found under "model" and their path, `fit.parameters["model.tilt"]`. Offset of
      each log, constant backlash, delay and drift are fitted beside them, and `orders` are none by
      default; those given are free on each flank.

    **Returns** a `Fit`.

    **Raises** `UsageError` for a `model` that is no flank model, and for settings that contradict
    it; `LogError` for a log that contradicts the pair or the first orders of another log,
    `NoAnswerError` for logs that are too short to say anything, `ValueError` for wrong arguments
    and without 64-bit floats, `TypeError` for a keyword that is no setting.

    **Example**
    ```python
    >>> import vttig_jax
    >>> from vttig_jax.rig import paper_rig
    >>> vttig_jax.enable_x64()
    >>> rig = paper_rig()
    >>> result = vttig_jax.fit(rig.log(), rig.pair)
    >>> round(result.parameters["driving_eccentricity_mm"].value, 3)
    0.023

    ```
    """
    require_x64("fit")
    settings = from_keywords(settings, changes)
    if settings.use_readings and readings is None:
        raise ValueError("Argument `readings` must be given to be used, but is None.")
    logs = (log,) if isinstance(log, EncoderLog) else tuple(log)
    if not logs:
        raise ValueError("Argument `log` must hold at least one log, but is empty.")
    require_distinct(logs)
    if pair is None:  # the gears or the drive that the options of the log state
        if logs[0].spec is None:
            raise ValueError(
                "Argument `pair` must be given for a log that was read with a pair, but is None."
            )
        pair = pair_from_spec(logs[0].spec)
    if orders is not None and not isinstance(orders, HarmonicOrders):
        raise ValueError(
            "Argument `orders` must be `vttig_jax.pair.HarmonicOrders(driving_orders=(1,),"
            f" driven_orders=(), mesh_orders=0)` or the like, but is {orders!r}."
        )
    wanted = orders or (pair.fit if model is None else HarmonicOrders((), (), 0))
    found = identified(logs, pair, settings, wanted, model)
    first, *others = (one.keywords for one in logs)
    common = {k: value for k, value in first.items() if all(o.get(k) == value for o in others)}
    paths = tuple(one.path for one in logs)
    return result_of(found, pair, FitRequest(settings, wanted, common, paths), readings)


def identified(
    logs: Sequence[EncoderLog],
    pair: GearPair | Drive,
    settings: FitSettings,
    orders: HarmonicOrders,
    model: Any = None,
) -> Identified:
    """Check logs at the door, and fit the mixed model: the way of one log and of each of many.

    **Raises** `LogError` for a log that contradicts the pair or has a slip, `NoAnswerError` for
    logs that are too short to say anything.
    """
    segments, ratios = [], []
    for one in logs:
        require_pair(one, pair)
        ratios.append(check_ratio(one))
        segments.append(assigned_segments(one, still=settings.standstill))
        refuse_slip(one, segments[-1])
    where = ", ".join(one.source for one in logs)
    shafts = [
        on_flank(without_axial(shafts_of(log, own), pair), settings.flank)
        for log, own in zip(logs, segments, strict=True)
    ]
    shafts, short = usable(shafts, waves_of(pair, orders), where)
    one_zero = len(logs) == 1 or all(one.zero == "reading" for one in logs)
    one_zero = one_zero if settings.same_zero is None else settings.same_zero
    if not one_zero:
        shafts = [shafts[0], *(replace(one, start=OWN) for one in shafts[1:])]
    given = None
    if model is not None:
        given = prepared(model, shafts, settings, one_zero=one_zero, where=where)
    core, lines, given = fitted(shafts, pair, orders, settings, given=given)
    require_one_rig(core, [one.source for one in logs])
    if given is None:
        lines = [*lines, *short_lines(core)]
    return Identified(logs, core, lines, segments, ratios, short, given)


def require_pair(log: EncoderLog, pair: GearPair | Drive) -> None:
    """Refuse a log that was read with another ratio than that of the pair."""
    if log.ratio != pair.ratio:
        raise LogError(
            f"this log was read with the ratio {log.ratio}, but the pair has {pair.ratio}; read it"
            " with the pair that it is fitted with.",
            where=log.source,
        )


def require_distinct(logs: Sequence[EncoderLog]) -> None:
    """Refuse a log that is given twice."""
    for number, log in enumerate(logs):
        for other in logs[:number]:
            if log is other or (log.sha256 and log.sha256 == other.sha256):
                same = log.source == other.source
                seen = "given twice" if same else f"the same data as {other.source}"
                raise UsageError(f"{seen}; give every log once.", where=log.source)


def usable(
    shafts: Sequence[Shafts], waves: Sequence[Wave], where: str
) -> tuple[tuple[Shafts, ...], tuple[Flank, ...]]:
    """Return the logs without the runs of a flank on which all runs are too short for rows.

    The second result names these flanks.

    **Raises** `NoAnswerError` if no run is left.
    """
    highest = max((wave.cycles(shafts[0].ratio) for wave in waves), default=1.0)
    found = [one for one in shafts if one.runs]
    row_s = row_duration(found, highest) if found else 0.0
    long = {
        run.flank
        for one in found
        for run in one.runs
        if (run.stop - run.start) // max(1, round(row_s / one.interval_s)) > LAGS + 1
    }
    if not long:
        raise NoAnswerError(
            f"no flank has {LAGS + 2} readings of this table; read more places, or every place"
            " several times."
            if any(one.still for one in found)
            else f"no stretch of certain contact on one flank holds {LAGS + 2} averaged samples;"
            " record longer strokes at a steady speed.",
            where=where,
        )
    seen: set[Flank] = {run.flank for one in found for run in one.runs}
    kept = [replace(one, runs=tuple(r for r in one.runs if r.flank in long)) for one in shafts]
    return tuple(kept), tuple(seen - long)


def told_by(
    core: MixedFit,
    pair: GearPair | Drive,
    settings: FitSettings,
    where: str,
    given: GivenModel | None = None,
) -> tuple[Quantities, dict[str, Parameter]]:
    """Return the quantities of a fit, and its parameters by name.

    **Raises** `NoAnswerError` if they are no finite numbers.
    """
    kinds, told = settings.kinds, None
    relation = pair if given is None else Drive(pair.ratio)
    apart = len(core.scope.flanks) == 2 or isinstance(relation, Drive)
    if np.all(np.isfinite(core.posterior.at.hessian)):
        fitted_kinds = kinds if apart else [k for k in kinds if k == KINDS[0]]
        told = quantities_of(core, relation, fitted_kinds)
        told = told if given is None else given_quantities(core, told, given)
    if told is None or not np.all(np.isfinite(told.covariance)):
        raise NoAnswerError(
            "the fit found no largest density, so that it has no numbers; list fewer orders in"
            " [fit], or record more turns.",
            where=where,
        )
    parameters = parameters_of(core, relation, told, kinds)
    return told, parameters if given is None else given_parameters(parameters, told, pair, given)


def on_flank(shafts: Shafts, flank: Flank | None) -> Shafts:
    """Return the log with its runs on one flank only, or on both for None."""

    def kept(runs: Sequence[Run]) -> tuple[Run, ...]:
        return tuple(run for run in runs if flank in (None, run.flank))

    return replace(shafts, runs=kept(shafts.runs), ramps=kept(shafts.ramps))


def without_axial(shafts: Shafts, pair: GearPair | Drive) -> Shafts:
    """Return the log without the transmission error that a logged axial position s causes.

    It is + s tan β_L/R₂ on flank A and − s tan β_R/R₂ on flank B.
    """
    if shafts.axial_mm is None or isinstance(pair, Drive):
        return shafts
    error, radius = shafts.error.copy(), float(pair.reference_radii[1])
    slope = {"A": float(pair.taper[0]) / radius, "B": -float(pair.taper[1]) / radius}
    for start, stop, flank in (*shafts.runs, *shafts.ramps):
        error[start:stop] -= slope[flank] * shafts.axial_mm[start:stop]
    return replace(shafts, error=error)


def assumptions_of(settings: FitSettings) -> Assumptions:
    """Return what the settings assume before the logs are read."""
    within_ms = settings.delay_within_ms
    known_s = 0.0 if isinstance(settings.delay, str) else float(settings.delay)
    return Assumptions(
        delay_s=None if settings.delay == "auto" else known_s,
        delay_within_s=None if within_ms is None else 1e-3 * within_ms,
        ratio=float(settings.ratio_within),
        orders=float(settings.orders_within),
        widths=float(settings.widths_within),
    )


def fitted(
    shafts: Sequence[Shafts],
    pair: GearPair | Drive,
    orders: HarmonicOrders,
    settings: FitSettings,
    *,
    given: GivenModel | None = None,
) -> tuple[MixedFit, list[Line], GivenModel | None]:
    """Fit the mixed model, and once more with the lines that the residual has."""
    assumed = assumptions_of(settings)
    if all(one.still for one in shafts):
        assumed = replace(assumed, delay_s=0.0)
    if given is not None:
        if not isinstance(pair, Drive):
            mesh = (k * pair.driving.teeth for k in range(1, orders.mesh_orders + 1))
            driving = (*orders.driving_orders, *mesh)
            orders = HarmonicOrders(driving, orders.driven_orders, 0)
            assumed = replace(assumed, ratio=0.0)
        pair = Drive(pair.ratio)  # the flank model takes the place of the gears
        given = searched(given, shafts, pair, orders, assumed)
    fit = partial(mixed_fit, pair=pair, orders=orders, assumed=assumed)
    turns = None
    if given is None:
        core, turns = with_starts(
            fit(shafts), lambda shafts, turns, after: fit(shafts, given=turns, after=after)
        )
    else:
        core, given = fitted_given(given, shafts, fit)
    first, lines = core, found_lines(core)
    if not lines or settings.lines != "join":
        return core, lines, given
    cycles = [one.cycles_per_rev for one in lines]
    if given is not None:
        core, given = fitted_given(given, core.shafts, partial(fit, lines=cycles), core)
    elif any(any(one.start.spread) for one in shafts):
        # A line has a phase of its own in a log whose whole turns since the first one are unknown.
        shafts = [replace(one, start=start_of(core, log)) for log, one in enumerate(core.shafts)]
        core = fit(shafts, lines=cycles, given=turns and Turns.of(core), after=core)
    else:
        core, lines = refined(
            lines,
            core.scope.turns["driving"],
            lambda at, shifts: fit(first.shafts, lines=at, given=shifts, after=first),
        )
    return core, lines, given


def result_of(
    found: Identified,
    pair: GearPair | Drive,
    request: FitRequest,
    readings: BacklashReadings | None,
) -> Fit:
    """Return the result of a fit of the mixed model."""
    core, logs, given, settings = found.core, found.logs, found.given, request.settings
    source = ", ".join(one.source for one in logs)
    compared_with = None if readings is None else compared(core, readings, settings)
    if readings is not None and settings.use_readings:
        core = updated(core, readings)
        found = replace(found, core=core)
    told, parameters = told_by(core, pair, settings, source, given)
    model = order_model(core)
    whole = None if given is None else fitted_model(told, given, model)
    curves, residuals = curves_of(core)
    checks = checks_of(found, pair, parameters, curves, whole or model, compared_with)
    if parameters["constant_backlash_deg"].determined:
        parameters.pop("gap_over_angles_covered", None)
    records = log_records(core, logs)
    fit = Fit(
        pair=pair,
        source=source,
        sha256=logs[0].sha256,
        outcome="ok",
        flanks=core.scope.flanks,
        samples={key: sum(one.samples[key] for one in records) for key in records[0].samples},
        zero=logs[0].zero,
        zero_readings=records[0].zero_readings,
        conditional_on=conditions_of(core, pair, settings, parameters, given=given is not None),
        parameters=parameters,
        orders=order_table(core),
        model=model,
        noise=noise_of(core),
        residual_rms_deg=float(np.sqrt(np.mean(np.concatenate(residuals) ** 2))) / DEG,
        curves=curves,
        residuals=residuals,
        covariance=told.covariance,
        covariance_names=told.names,
        values=told.mean,
        checks=checks,
        findings=(),
        regressors=regressors_of(core, told),
        logs=records,
        core=core,
        given=whole,
        request=request,
    )
    findings = findings_of(fit, found)
    outcome = "contradicts" if contradicts(fit, findings) else outcome_of(parameters)
    return replace(fit, findings=findings, outcome=outcome)


def regressors_of(core: MixedFit, told: Quantities) -> tuple[Parameter, ...]:
    """Return the coefficient of the torque and the ratio of a drive, as far as the logs tell them.

    A ratio is significant if it is not the given one.
    """
    found = []
    if "torque" in told.names:
        name, unit = "torque_arcsec_per_unit", "arcsec/unit of torque"
        found.append(told.scalar("torque", unit, ARCSEC, label=name))
    if "ratio" in told.names:
        index, turns, given = core.posterior.problem.index, core.scope.turns, core.scope.ratio
        width, std = core.posterior.problem.columns[index[RATIO]].width, told.std("ratio")
        firsts = {shaft: ColumnName(RowName(shaft, 1, "cos"), 0) for shaft in SHAFTS}
        slopes = [s for s in SHAFTS if turns[s] < FULL_TURN and firsts[s] not in index]
        one = Parameter("ratio", "1")
        if slopes:
            reason = f"over {turns[slopes[0]]:.2g} turns the first order of the {slopes[0]} shaft,"
            reason += " which is not in the model, is a slope too"
        elif std > TOLD * width:
            share = width / abs(given)
            reason = f"the log does not tell it: within ± {share:.2g} of the ratio as assumed"
        else:
            one = told.scalar("ratio", "1")
            off = abs(float(told.mean[told.names.index("ratio")]) - given)
            one = replace(one, significant=off >= SIGNIFICANT * std)
            reason = None if one.significant else f"within {SIGNIFICANT:g} standard errors as given"
        found.append(replace(one, reason=reason))
    return tuple(found)


def outcome_of(parameters: Mapping[str, Parameter]) -> Outcome:
    """Return the outcome of a fit; parameters that the settings exclude do not count.

    A delay that the log shows is an answer, but a log that does not tell it may be complete.
    """
    asked = [
        p
        for p in parameters.values()
        if p.name not in ("delay_s", "backlash_plus_delay_deg", "gap_over_angles_covered")
        and p.reason not in (*LEFT_OUT, GIVEN_INSTEAD)
    ]
    if not (any(p.determined for p in asked) or parameters["delay_s"].significant):
        return "not_determined"
    return "ok" if all(p.determined for p in asked) else "partly_determined"


def conditions_of(
    core: MixedFit,
    pair: GearPair | Drive,
    settings: FitSettings,
    parameters: Mapping[str, Parameter],
    *,
    given: bool = False,
) -> tuple[str, ...]:
    """Return the names of the assumptions under which the numbers of the fit are valid."""
    conditions: tuple[str, ...] = ()
    both = len(core.scope.flanks) == 2
    if given:
        conditions = ("flank_model",)
    elif settings.perfect_gears:
        conditions = ("perfect_gears",)
    elif isinstance(pair, GearPair) and (settings.perfect_encoders or not both):
        conditions = ("perfect_encoders",)
    elif not both:
        conditions = (f"flank_{core.scope.flanks[0]}_only",)
    index = core.posterior.problem.index
    if isinstance(pair, Drive) and RATIO not in index and settings.ratio_within != 0:
        conditions += ("the_stated_ratio",)
    if DELAY not in index:
        return (*conditions, "no_delay" if core.delay_s == 0 else "given_delay")
    if not parameters["delay_s"].determined and core.settled and both:
        width_ms = 1e3 * core.posterior.problem.columns[index[DELAY]].width
        return (*conditions, f"delay_within_{width_ms:.3g}_ms")
    return conditions
