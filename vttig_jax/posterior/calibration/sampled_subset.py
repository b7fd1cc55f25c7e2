"""Coverage of sampled posteriors: some rigs of a case are sampled, with one ensemble per rig."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...identify.compress.harmonic_summary import HarmonicSummary
from ...identify.compress.lagged_flank import LaggedFlank
from ...identify.model.forward_model import ForwardModel
from ..density.density import NOISE_STD, FitTarget
from ..density.evaluation import Density
from ..density.likelihood import likelihood_of
from ..density.prior import Prior, StatedPrior, state_prior
from ..sampling.convergence import autocorrelation_time
from ..sampling.importance import POOL, PosteriorStarts, weighted_draws
from ..sampling.joint_moves import Walkers, step_together
from ..sampling.laplace_move import moves_with, share_around_fit
from ..sampling.target import CheckedDensity, starting_points
from .case_result import Sampled
from .compressed import Compressed
from .program import Batch, Program
from .scenarios import judged_parameters, terms_of

WALKERS, BURN_IN, STEPS = 64, 500, 1500
"""Size of an ensemble (chosen). The burn-in, about ten autocorrelation times, is made only if
importance sampling gives no reliable start points."""

_FEWER = 4
"""Divisor of the number of steps where half of the proposals are made around the fit (chosen); the
draws are then seven times less correlated."""


@dataclass(frozen=True, eq=False)
class RigEvidence:
    """Compressed log, fit and true parameters of one rig, from which its posterior is sampled.

    **Arguments**
    - `log`: products of the rows of the log.
    - `values`, `covariance`: fitted parameters, mm and rad, and their covariance.
    - `innovation_std`, `partial`: fitted noise: standard deviation of its innovations, rad, and its
      partial autocorrelations.
    - `truth`: true values of the parameters, mm and rad.
    """

    log: Compressed
    values: Float[np.ndarray, " p"]
    covariance: Float[np.ndarray, "p p"]
    innovation_std: float
    partial: Float[np.ndarray, " highest"]
    truth: Float[np.ndarray, " p"]


def sampled_coverage(
    program: Program,
    batches: Sequence[Batch],
    rigs: int,
    seed: int,
    progress: Callable[[str, int], None] = lambda case, rigs: None,
    steps: int = STEPS,
    burn_in: int = BURN_IN,
) -> Sampled:
    """Sample the posteriors of the first `rigs` rigs, and return the ranks of their true values.

    Each rig has one ensemble of at least 64 walkers. All rigs are sampled with the same order of
    the noise, which is the highest order among them, so that the density is compiled only once.
    """
    evidence = [_evidence(batch, k) for batch in batches for k in range(len(batch.truth))][:rigs]
    order = max(int(np.count_nonzero(rig.partial)) for rig in evidence)
    indices = judged_parameters(program.relation.names)
    ranks, tau = np.empty((len(evidence), len(indices))), np.empty(len(evidence))
    fewest = steps
    for number, rig in enumerate(evidence):
        target = rig_target(program, rig, order)
        generator = np.random.default_rng([seed, number])
        draws = _draws(target, generator, burn_in, steps)
        fewest = min(fewest, len(draws))
        tau[number] = autocorrelation_time(draws).max()
        flat = draws[:, :, : len(indices)].reshape(-1, len(indices))
        ranks[number] = np.mean(flat < rig.truth[list(indices)], axis=0)
        progress(program.scenario.case, 1)
    return Sampled(ranks, fewest, burn_in, WALKERS, tau)


def rig_target(program: Program, rig: RigEvidence, order: int) -> FitTarget:
    """Return the posterior of one rig, with noise of the given order.

    It is the density of `vttig sample`, built from the batched fit of the rig.
    """
    relation, scenario = program.relation, program.scenario
    summary = _summary(program, rig.log)
    indices = list(judged_parameters(relation.names))
    sampled = tuple(relation.names[k] for k in indices)
    jacobian = np.asarray(_jacobian(relation, jnp.asarray(rig.values)))
    likelihood = likelihood_of(
        summary,
        relation=relation,
        jacobian=jacobian,
        values=rig.values,
        sampled=sampled,
        order=order,
    )
    names = (*sampled, NOISE_STD, *(f"partial_{k}" for k in range(1, order + 1)))
    prior = state_prior(Prior(), scenario.pair, sampled, 0.0)
    partial = rig.partial[:order]
    rows = float(likelihood.rows) - likelihood.coefficients
    covariance = np.diag(
        np.concatenate([np.ones(len(sampled)), [0.5 / rows], (1 - partial**2) / rows])
    )
    covariance[: len(sampled), : len(sampled)] = rig.covariance[np.ix_(indices, indices)]
    return FitTarget(
        names=names,
        units=("",) * len(names),
        density=_density(likelihood, prior, names),
        prior=prior,
        centre=np.concatenate([rig.values[indices], [np.log(rig.innovation_std)], partial]),
        covariance=covariance,
        identity={},
    )


def _evidence(batch: Batch, place: int) -> RigEvidence:
    log, modelled, partial = jax.tree.map(
        lambda part: np.asarray(part[place]),
        (batch.logs, batch.fitted.modelled, batch.fitted.partial),
    )
    std = float(modelled.innovation_std)
    return RigEvidence(
        log=log,
        values=modelled.values,
        covariance=modelled.covariance,
        innovation_std=std,
        partial=partial,
        truth=np.asarray(batch.truth[place]),
    )


def _summary(program: Program, log: Compressed) -> HarmonicSummary:
    products = log.products
    flanks = tuple(
        LaggedFlank(
            flank,
            triangle=np.asarray(products.triangle[k]),
            lag_products=np.asarray(products.lag_products[k]),
            heads=np.asarray(products.ends[k, :1]),
            tails=np.asarray(products.ends[k, 1:, ::-1]),
            rows=program.rows,
        )
        for k, flank in enumerate(program.scenario.flanks)
    )
    row_s = program.size / program.scenario.rate_hz
    return HarmonicSummary(flanks, terms_of(program.scenario), program.columns, row_s)


def _density(likelihood, prior: StatedPrior, names: Sequence[str]) -> Density:
    bound = [
        1.0 if name.startswith("partial_") else prior.bounds.get(name, np.inf) for name in names
    ]
    return Density(
        likelihood=likelihood,
        bound=np.array(bound),
        planes=tuple((names.index(f"{d.name}_x"), names.index(f"{d.name}_y")) for d in prior.discs),
        plane_bound=np.array([disc.bound for disc in prior.discs]),
        plane_std=np.array([disc.std for disc in prior.discs]),
        flat_in_amplitude=tuple(disc.flat_in_amplitude for disc in prior.discs),
        centre=np.zeros(len(bound)),
        widening=np.ones(len(bound)),
    )


def _draws(
    target: FitTarget, generator: np.random.Generator, burn_in: int, steps: int
) -> Float[np.ndarray, "steps walkers d"]:
    walkers = max(WALKERS, 2 * len(target.names))
    pool = weighted_draws(target, POOL, generator)
    share, reliable = share_around_fit(pool), pool.reliable
    moves, steps = moves_with(target, share), steps // _FEWER if share else steps
    place = PosteriorStarts(target) if reliable else target
    points, values = starting_points(CheckedDensity(place), walkers, generator)
    ensemble = Walkers(points, values, np.random.RandomState(generator.integers(2**32)))
    for _ in range(0 if reliable else burn_in):
        step_together([ensemble], target.log_density, moves)
    draws = np.empty((steps, *points.shape))
    for step in range(steps):
        step_together([ensemble], target.log_density, moves)
        draws[step] = ensemble.points
    return draws


@eqx.filter_jit
def _jacobian(relation: ForwardModel, values: Float[Array, " p"]) -> Float[Array, "flanks tied p"]:
    return jax.jacfwd(lambda p: relation.coefficients(p))(values)
