"""Expected standard errors of a run that is not yet recorded, and the shortest run for them.

They are those of the expected fit of the run, by the density of every fit.
"""

import math
from bisect import bisect_left
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ...base.errors import LogError, NoAnswerError
from ...base.runtime import require_x64
from ...base.threads import one_blas_thread
from ...base.units import ARCSEC, DEG
from ...identify.fit_settings import LONGEST_DELAY_S, FitSettings
from ...identify.identification import assumptions_of, conditions_of, outcome_of, told_by
from ...logs.motion.segments import find_segments
from ...model.columns import DELAY, ColumnName, Design, design_of, embedding
from ...model.density import LAGS, Compressed, Solved, solved
from ...model.functionals import Posterior
from ...model.gears import relation_of
from ...model.mixed_fit import MixedFit, largest
from ...model.parameters import FULL_TURN
from ...model.problem import index_of, problem_of
from ...model.rows import SHAFTS, S, Shafts
from ...model.runs import shafts_of
from ...model.scope import scope_of
from ...pair.gear_pair import Drive, Eccentricities, GearPair
from ...pair.schema import Flank, HarmonicOrders
from .noise import PlannedNoise, counting_std
from .result import Plan, notes, planned_parameter
from .run import MOST_SAMPLES, Directions, PlannedRun, speeds_of

DelayChoice = Literal["auto", "off"] | float
"""Values of the setting `delay` of a fit: "auto", "off", or a number of seconds."""

MOST_TURNS = 1000.0  # default of the largest number of turns of a pass (chosen)

BESIDE = ("gap_over_angles_covered", "backlash_plus_delay_deg")
"""Parameters of a fit that depend on the angles of its log; a plan leaves them out."""


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

    The rows of the planned motion go through the model of `vttig_jax.fit`. Its density is taken at
    the expected products of their columns and readings, and the standard errors are those of its
    posterior there: the expected information. Drift, a delay that changes and a gap that changes
    with the speed are part of the model as in a fit, at the smallest size that such a log allows.

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
    - `delay`: as in the fit. "auto" fits a delay, which half a sampling interval bounds unless
      several speeds or the ramps tell it; "off" fits none, and a number of seconds is a known one.

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
    values = assumed_values(pair, eccentricities, assumed)
    settings = FitSettings(perfect_encoders=perfect_encoders, delay=delay)
    if settings.delay != "auto" and "delay_s" in values:
        raise ValueError(
            'Argument `assumed` must hold a delay_s only if `delay` is "auto", but'
            f" `delay` is {delay!r}, so that no delay is fitted."
        )
    run = PlannedRun(turns, speeds_of(speed_rpm), rate_hz, directions, passes, dwell_s, ramp_s)
    counting = counting_std(pair)
    if not (noise.std_deg or noise.white_std_deg or counting):
        raise ValueError(
            "Argument `noise` must not be zero if the pair file gives no counts of the encoders,"
            " but it is: every standard error would be zero."
        )
    orders = orders or pair.fit
    fit, steady = expected_fit(run, pair, orders, noise, values, settings)
    fitted = told_by(fit, pair, settings, "planned run")[1]
    fitted = {name: p for name, p in fitted.items() if name not in BESIDE}
    outcome = outcome_of(fitted)
    if outcome == "not_determined":
        raise too_short(run)
    (rows,) = fit.rows
    size = rows.samples.shape[1]
    return Plan(
        pair=pair,
        parameters={name: planned_parameter(p, values.get(name)) for name, p in fitted.items()},
        run=run,
        used=rows.samples.size,
        noise=noise,
        counting_std_deg=counting / DEG,
        row_s=size / rate_hz,
        row_std_deg=math.sqrt(noise.autocovariance(size, rate_hz, 1, counting)[0]) / DEG,
        flanks=fit.scope.flanks,
        conditional_on=conditions_of(fit, pair, settings, fitted),
        outcome=outcome,
        short=tuple(shaft for shaft, turned in fit.scope.turns.items() if turned < FULL_TURN),
        notes=notes(pair, run, orders, noise, fit, steady),
    )


def shortest_run(
    pair: GearPair | Drive,
    target: Mapping[str, float],
    *,
    most_turns: float = MOST_TURNS,
    **planned: Any,
) -> Plan:
    """Return the plan with the fewest turns per pass that reaches the wanted standard errors.

    The number of driving turns per pass is whole. More turns never give less information once every
    first order has enough turns. Therefore the run is first doubled until it reaches the target,
    and then the number of turns is found by bisection.

    **Arguments**
    - `target`: name of a parameter → wanted standard error in its unit, for example
      `{"driving_eccentricity_mm": 1e-4}`.
    - `most_turns`: largest number of turns per pass, 1000 by default. A run of more than ten
      million samples is never tried.
    - `planned`: the other arguments of `plan`.

    **Raises** `NoAnswerError` with the reason if no run of this kind reaches the target.

    **Example**
    ```python
    >>> import vttig_jax
    >>> from vttig_jax.posterior import PlannedNoise
    >>> from vttig_jax.posterior import shortest_run
    >>> from vttig_jax.rig import paper_pair
    >>> vttig_jax.enable_x64()
    >>> noise = PlannedNoise(std_deg=0.002, correlation_s=0.00475)
    >>> wanted = {"driving_eccentricity_mm": 2e-4}
    >>> shortest_run(paper_pair(), wanted, rate_hz=1987.0, noise=noise).run.turns
    16.0

    ```
    """
    require_x64("shortest_run")
    if not target:
        raise ValueError("Argument `target` must name at least one parameter, but is empty.")
    for name, value in target.items():
        if not 0 < value < math.inf:
            raise ValueError(
                f"Argument `target` must hold positive standard errors, but {name} is {value!r}."
            )
    own = {name: planned[name] for name in PlannedRun.__dataclass_fields__ if name in planned}
    longest = PlannedRun(most_turns, speeds_of(planned.get("speed_rpm", 60.0)), **own)
    samples = sum(60 / speed for speed in longest.speeds_rpm) * longest.pass_count * longest.rate_hz
    most = max(1, math.floor(min(most_turns, 0.95 * MOST_SAMPLES / samples)))
    least = max(1, math.ceil(longest.least_turns))
    attempt = cache(lambda turns: _attempt(pair, turns, target, planned))
    few, many = least - 1, min(least, most)
    while not _reaches_target(attempt(many), target):
        if many == most:
            raise _unreachable(attempt(many), target, longest, most)
        if isinstance(best := attempt(many), Plan):
            _require_possible(best, target)
        few, many = many, min(2 * many, most)
    turns = range(few + 1, many + 1)
    enough = bisect_left(turns, True, key=lambda k: _reaches_target(attempt(k), target))
    best = attempt(turns[enough])
    assert isinstance(best, Plan)  # because it reaches the target
    own = {name: replace(p, wanted=target.get(name)) for name, p in best.parameters.items()}
    return replace(best, parameters=own)


def _attempt(
    pair: GearPair | Drive, turns: int, target: Mapping[str, float], planned: dict[str, Any]
) -> Plan | NoAnswerError:
    """Return the plan with these turns per pass, or why it has no answer."""
    try:
        result = plan(pair, turns=float(turns), **planned)
    except NoAnswerError as error:
        return error
    for name in target:
        if name not in result.parameters:
            known = ", ".join(result.parameters)
            raise ValueError(f"Argument `target` must hold names of {known}, but holds {name!r}.")
    return result


def _reaches_target(result: Plan | NoAnswerError, target: Mapping[str, float]) -> bool:
    return isinstance(result, Plan) and all(result.std(n) <= wanted for n, wanted in target.items())


def _require_possible(result: Plan, target: Mapping[str, float]) -> None:
    """Raise `NoAnswerError` if both shafts turn enough, but a wanted parameter is undetermined."""
    for name in () if result.short else target:
        if not result.parameters[name].determined:
            reason = result.parameters[name].reason
            raise NoAnswerError(f"no number of turns fixes {name}: {reason}.", where="planned run")


def _unreachable(
    result: Plan | NoAnswerError, target: Mapping[str, float], longest: PlannedRun, most: int
) -> NoAnswerError:
    if isinstance(result, NoAnswerError):
        return result
    _require_possible(result, target)
    limit = "as asked" if most == math.floor(longest.turns) else "the most that fit in memory"
    missed = []
    for name, wanted in target.items():
        p = result.parameters[name]
        if result.std(name) > wanted:
            reached = f"{p.std:.2g}" if p.std is not None else f"none ({p.reason})"
            missed.append(f"{name} {reached} instead of {wanted:g} {p.unit}")
    cures = "allow more turns, less noise or more passes"
    if "constant_backlash_deg" in target and len(longest.speeds_rpm) == 1:
        cures += ", or plan a second speed, which tells a delay from the constant backlash"
    return NoAnswerError(
        f"{most} turns a pass, {limit}, are too few: {'; '.join(missed)}; {cures}.",
        where="planned run",
    )


_STEPS = 30
"""Steps towards the expected widths (chosen); each takes off half of what is left, or more."""

ECCENTRICITY_MM = 0.02  # default eccentricity of a gear (chosen)
ENCODER_ARCSEC = 10.0  # default encoder error (chosen)
AMPLITUDE_ARCSEC = 60.0  # default first order of a drive (chosen)

_SIZES = {"_eccentricity_mm": 1.0, "_amplitude_arcsec": ARCSEC, "_arcsec": ARCSEC}
"""Ending of the name of an amplitude → its unit, mm or rad."""

_solved = jax.jit(solved)


def assumed_values(
    pair: GearPair | Drive,
    eccentricities: Eccentricities | None,
    given: Mapping[str, float] | None,
) -> dict[str, float]:
    """Return parameter name of a fit → assumed value, for amplitudes, phases and the delay.

    The defaults are 0.02 mm for an eccentricity, the accuracy of the encoder (10″ if it is unknown)
    for an encoder error, 60″ for the amplitude of a drive, and zero for a phase. `given` replaces
    defaults. The delay `delay_s` has no default.

    **Raises** `ValueError` for other names and for invalid numbers.
    """
    values: dict[str, float] = {}
    drive = isinstance(pair, Drive)
    name, size = "eccentricity_mm", ECCENTRICITY_MM
    if drive:
        name, size = "amplitude_arcsec", AMPLITUDE_ARCSEC
    for shaft in SHAFTS:
        values |= {f"{shaft}_{name}": size, f"{shaft}_phase_deg": 0.0}
    for shaft in () if drive else SHAFTS:
        accuracy = getattr(pair, shaft).encoder.accuracy_arcsec
        values |= {
            f"{shaft}_encoder_arcsec": ENCODER_ARCSEC if accuracy is None else float(accuracy),
            f"{shaft}_encoder_phase_deg": 0.0,
        }
    if eccentricities is not None:
        if drive:
            raise ValueError(
                "Argument `eccentricities` must be None for a drive, which has no gear geometry;"
                " give amplitudes in `assumed`."
            )
        for shaft in SHAFTS:
            values[f"{shaft}_eccentricity_mm"] = float(getattr(eccentricities, f"{shaft}_mm"))
            values[f"{shaft}_phase_deg"] = float(getattr(eccentricities, f"{shaft}_phase_deg"))
    known = (*values, "delay_s")
    for name, value in (given or {}).items():
        if name not in known:
            raise ValueError(
                f"Argument `assumed` must hold names of {', '.join(known)}, but holds {name!r}."
            )
        if name == "delay_s" and not abs(value) <= LONGEST_DELAY_S:
            raise ValueError(
                f"Argument `assumed` must hold a delay_s within ±{LONGEST_DELAY_S:g} s, but it"
                f" is {value!r}."
            )
        signed = name == "delay_s" or "phase" in name
        if not math.isfinite(value) or (value < 0 and not signed):
            raise ValueError(
                f"Argument `assumed` must hold finite amplitudes that are not negative, but"
                f" {name} is {value!r}."
            )
        values[name] = float(value)
    return values


def cartesian(names: Sequence[str], values: Mapping[str, float]) -> Float[np.ndarray, " p"]:
    """Return the components `names`, such as driving_x, in mm and rad, from amplitudes and phases.

    x + jy = amplitude · exp(j phase).
    """
    found = []
    for name in names:
        source, _, axis = name.rpartition("_")
        end = next(one for one in _SIZES if source + one in values)
        angle = values[f"{source}_phase_deg"] * DEG
        part = math.cos(angle) if axis == "x" else math.sin(angle)
        found.append(values[source + end] * _SIZES[end] * part)
    return np.array(found)


def expected_fit(
    run: PlannedRun,
    pair: GearPair | Drive,
    orders: HarmonicOrders,
    noise: PlannedNoise,
    values: Mapping[str, float],
    settings: FitSettings,
) -> tuple[MixedFit, int]:
    """Return the fit that the log of a run is expected to get, and its number of steady passes.

    The rows are those of the ideal motion, and their readings are the columns times the
    coefficients of the assumed `values`. The products of the noise with itself are added in
    expectation; its products with the columns vanish. The density of these products has its largest
    value at the assumed coefficients and the noise; the widths of the priors are those of the
    largest expected density. The curvature there is the expected information.

    **Raises** `NoAnswerError` for a run without a steady pass of one turn.
    """
    shafts, passes = _shafts(run, pair)
    assumed = assumptions_of(settings)
    delay_s = values.get("delay_s", 0.0) if assumed.delay_s is None else assumed.delay_s
    design = design_of([shafts], pair, orders, assumed=assumed)
    flank: Flank = "A" if any(run.flank == "A" for run in shafts.runs) else "B"
    coefficients = _coefficients(design, pair, values, flank, settings.kinds)
    (rows,) = design.rows([shafts])
    if not len(rows.table):
        raise NoAnswerError(
            f"the {len(shafts.time)} samples are too few for rows of the orders in [fit]; plan more"
            " turns or a higher rate, or list fewer orders.",
            where="planned run",
        )
    table = rows.table.copy()
    for flank in S:
        link = embedding(design.columns, rows.names, 0, flank)[:, :-1]
        own = rows.flank == flank
        table[own, -1] = rows.table[own] @ (link @ coefficients)
    rows = replace(rows, table=table)
    size = rows.samples.shape[1]
    covariance = noise.autocovariance(size, run.rate_hz, LAGS, counting_std(pair))
    usual = max(float(np.std(table[:, -1])), float(np.sqrt(covariance[0])))
    design = replace(design, usual=usual, delay_s=delay_s)
    problem = problem_of(
        design.columns,
        [rows],
        None,
        centres={DELAY: delay_s},
        usual=design.scales(float(np.sqrt(covariance[0])), len(rows.table)),
        noise=covariance,
        memory=design.memory,
    )
    found = largest(problem.compressed)
    theta, at = expected_widths(np.asarray(found.value), problem.compressed)
    fit = MixedFit(
        shafts=(shafts,),
        rows=(rows,),
        waves=design.waves,
        posterior=Posterior(problem, theta, at),
        delay_s=delay_s,
        bends=design.bends,
        passes=1,
        steps=int(found.stats["num_steps"]),
        usual=usual,
        weights=None,
        scope=scope_of([shafts], [rows], design.waves),
        orders=orders,
    )
    return fit, passes


def expected_widths(
    theta: Float[np.ndarray, " p"], logs: Compressed
) -> tuple[Float[np.ndarray, " p"], Solved]:
    """Return θ with the widths τ that have the largest expected density, and the density there.

    Where the coefficients of a group are zero, their estimates are those of the noise alone, with
    covariance W − W D W for W = M⁻¹. The expected slope of −2 ln L by ln τ is then 2 Σ_j (1 − 2
    d_j W_jj + d_j (W D W)_jj), and that of the half-Cauchy prior 4 r²/(1 + r²) − 2 with r = τ/u.
    Their sum grows with τ from −2, so that it has one zero.
    """
    theta, at = theta.copy(), _solved(jnp.asarray(theta), logs)
    member, usual = np.asarray(logs.member), np.asarray(logs.usual)
    on = np.asarray(logs.on) > 0
    for _ in range(_STEPS):
        tau = np.exp(theta[LAGS + 1 :])
        prior = member / tau**2
        spread = np.asarray(at.spread)
        whole = np.asarray(logs.precision) + prior.sum(1)
        bent = np.einsum("ij,j,ji->i", spread, whole, spread)
        told = (member > 0).sum(0) - (2 * np.diag(spread) - bent) @ prior
        ratio = (tau / usual) ** 2
        balance = told + 2 * ratio / (1 + ratio)  # 1 at the zero
        theta[LAGS + 1 :] -= np.where(on, 0.25 * np.log(np.maximum(balance, 1e-6)), 0.0)
        at = _solved(jnp.asarray(theta), logs)
    return theta, at


def too_short(run: PlannedRun) -> NoAnswerError:
    """Return the refusal of a run that determines nothing."""
    return NoAnswerError(
        f"no shaft makes a full revolution at a steady speed in passes of {run.turns:g} turns; plan"
        " more turns.",
        where="planned run",
    )


def _shafts(run: PlannedRun, pair: GearPair | Drive) -> tuple[Shafts, int]:
    """Return the shafts of the ideal log of a run, and the number of its steady passes."""
    try:
        log = run.log(pair)
    except LogError:
        raise NoAnswerError(
            f"passes of {run.turns:g} turns at {run.rate_hz:g} Hz make no log that can be fitted;"
            " plan more turns or a higher rate.",
            where="planned run",
        ) from None
    segments = find_segments(log)
    if not segments.segments:
        raise too_short(run)
    shafts = shafts_of(log, segments, planned=True)
    every = tuple(sorted((*shafts.runs, *shafts.ramps)))
    return replace(shafts, runs=every, ramps=()), len(segments.segments)


def _coefficients(
    design: Design,
    pair: GearPair | Drive,
    values: Mapping[str, float],
    flank: Flank,
    kinds: tuple[str, ...],
) -> np.ndarray:
    """Return the coefficients of the columns that the assumed values give; others are 0."""
    index, found = index_of(design.columns), np.zeros(len(design.columns))
    if isinstance(pair, Drive):
        for wave in (one for one in design.waves if one.is_first):
            places = [index[ColumnName(wave.row(part), 0)] for part in ("sin", "cos")]
            found[places] = cartesian([f"{wave.shaft}_{axis}" for axis in "xy"], values)
        return found
    relation = relation_of(pair, design.waves, both=design.both, flank=flank, kinds=kinds)
    if relation is not None:
        tied = relation.coefficients(jnp.asarray(cartesian(relation.names, values)))
        places = relation.tied_columns(index)
        found[places] = np.asarray(tied)[: len(places)]
    return found
