"""Expected fit of a run that is not yet recorded, by the density of every fit."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ...base.errors import LogError, NoAnswerError
from ...base.units import ARCSEC, DEG
from ...identify.fit_settings import LONGEST_DELAY_S, FitSettings
from ...identify.identification import assumptions_of, known_delay
from ...logs.motion.segments import find_segments
from ...model.columns import DELAY, ColumnName, Design, design_of, embedding
from ...model.density import LAGS, Compressed, Solved, solved
from ...model.functionals import Posterior
from ...model.gears import relation_of
from ...model.mixed_fit import MixedFit, largest
from ...model.problem import index_of, problem_of
from ...model.rows import SHAFTS, RowName, S, Shafts
from ...model.runs import shafts_of
from ...model.scope import scope_of
from ...pair.gear_pair import Drive, Eccentricities, GearPair
from ...pair.schema import Flank, HarmonicOrders
from .noise import PlannedNoise, counting_std
from .run import PlannedRun

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
    delay_s = values.get("delay_s", 0.0) if settings.delay == "auto" else known_delay(settings)
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
        names = tuple(f"{w.shaft}_{axis}" for w in design.waves if w.is_first for axis in "xy")
        for name, value in zip(names, cartesian(names, values), strict=True):
            shaft, axis = name.split("_")
            part = "sin" if axis == "x" else "cos"
            found[index[ColumnName(RowName(shaft, 1, part), 0)]] = value
        return found
    relation = relation_of(pair, design.waves, both=design.both, flank=flank, kinds=kinds)
    if relation is not None:
        tied = relation.coefficients(jnp.asarray(cartesian(relation.names, values)))
        places = relation.tied_columns(index)
        found[places] = np.asarray(tied)[: len(places)]
    return found
