"""Expected fit of a run that is not yet recorded, by the density of every fit."""

from collections.abc import Mapping
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ...base.errors import LogError, NoAnswerError
from ...identify.fit_settings import FitSettings
from ...identify.identification import assumptions_of, known_delay
from ...logs.motion.segments import find_segments
from ...model.columns import columns_of, embedding
from ...model.density import LAGS, Compressed, Solved, solved
from ...model.functionals import Posterior
from ...model.gears import relation_of
from ...model.mixed_fit import Design, MixedFit, design_of, largest
from ...model.problem import problem_of
from ...model.rows import Shafts
from ...model.runs import shafts_of
from ...model.scope import scope_of
from ...pair.gear_pair import Drive, GearPair
from ...pair.schema import HarmonicOrders
from .assumptions import DELAY, cartesian
from .noise import PlannedNoise, counting_std
from .run import PlannedRun

_STEPS = 30
"""Steps towards the expected widths (chosen); each takes off half of what is left, or more."""

_solved = jax.jit(solved)


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
    delay_s = values.get(DELAY, 0.0) if settings.delay == "auto" else known_delay(settings)
    design = design_of([shafts], pair, orders, assumed=assumed)
    side = 0 if any(flank > 0 for _, _, flank in shafts.runs) else 1
    coefficients = _coefficients(
        design, pair, values, side=side, encoders=not settings.perfect_encoders
    )
    (rows,) = design.rows([shafts], 0.0)
    if not len(rows.table):
        raise NoAnswerError(
            f"the {len(shafts.time)} samples are too few for rows of the orders in [fit]; plan more"
            " turns or a higher rate, or list fewer orders.",
            where="planned run",
        )
    table = rows.table.copy()
    for side in (1, -1):
        link = embedding(design.columns, rows.names, 0, side)[:, :-1]
        own = rows.flank * side < 0
        table[own, -1] = rows.table[own] @ (link @ coefficients)
    rows = replace(rows, table=table)
    size = rows.samples.shape[1]
    covariance = noise.autocovariance(size, run.rate_hz, LAGS, counting_std(pair))
    usual = max(float(np.std(table[:, -1])), float(np.sqrt(covariance[0])))
    shape = replace(design.shape, usual=usual)
    width = max(0.5 * shape.interval_s, abs(delay_s))
    columns = tuple(
        replace(column, width=width) if column.name == ("delay",) else column
        for column in columns_of(design.waves, shape, assumed)
    )
    problem = problem_of(
        columns,
        [rows],
        None,
        centres={("delay",): delay_s},
        usual=replace(design, shape=shape).scales(float(np.sqrt(covariance[0])), len(rows.table)),
        noise=covariance,
        memory=design.memory,
    )
    found = largest(problem.compressed)
    theta, at = expected_widths(np.asarray(found.value), problem.compressed)
    posterior = Posterior(problem, theta, at)
    steps = int(found.stats["num_steps"])
    fit = MixedFit(
        (shafts,),
        (rows,),
        design.waves,
        posterior,
        delay_s,
        design.bends,
        0.0,
        1,
        steps,
        usual,
        None,
        scope_of([shafts], [rows]),
        orders,
    )
    return fit, passes


def expected_widths(
    theta: Float[np.ndarray, " p"], logs: Compressed
) -> tuple[Float[np.ndarray, " p"], Solved]:
    """Return θ with the widths τ that have the largest expected density, and the density there.

    Where the coefficients of a group are zero, their estimates are those of the noise alone, with
    covariance W − W D W for W = M⁻¹. The expected slope of −2 ln L by ln τ is then 2 Σ_j (1 − 2
    d_j W_jj + d_j (W D W)_jj), and that of the prior of τ 8 r²/(1 + r²) − 2 with r = τ/u.
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
        balance = told + 4 * ratio / (1 + ratio)  # 1 at the zero
        theta[LAGS + 1 :] -= np.where(on, 0.25 * np.log(np.maximum(balance, 1e-6)), 0.0)
        at = _solved(jnp.asarray(theta), logs)
    return theta, at


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
        raise NoAnswerError(
            f"no shaft makes a full revolution at a steady speed in passes of {run.turns:g} turns;"
            " plan more turns.",
            where="planned run",
        )
    shafts = shafts_of(log, segments)
    every = tuple(sorted((*shafts.runs, *shafts.ramps)))
    return replace(shafts, runs=every, ramps=()), len(segments.segments)


def _coefficients(
    design: Design,
    pair: GearPair | Drive,
    values: Mapping[str, float],
    *,
    side: int,
    encoders: bool,
) -> np.ndarray:
    """Return the coefficients of the columns that the assumed values give; others are 0."""
    index = {column.name: place for place, column in enumerate(design.columns)}
    found = np.zeros(len(index))
    if isinstance(pair, Drive):
        names = tuple(f"{w.shaft}_{axis}" for w in design.waves if w.is_first for axis in "xy")
        for name, value in zip(names, cartesian(names, values), strict=True):
            shaft, axis = name.split("_")
            found[index[shaft, 1, "sin" if axis == "x" else "cos", False, 0]] = value
        return found
    relation = relation_of(pair, design.waves, both=design.shape.both, side=side, encoders=encoders)
    if relation is not None:
        tied = relation.coefficients(jnp.asarray(cartesian(relation.names, values)))
        places = relation.places(index)
        found[places] = np.asarray(tied)[: len(places)]
    return found
