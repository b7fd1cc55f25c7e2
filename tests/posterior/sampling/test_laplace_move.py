"""Proposals around the fit: the draws of emcee, of the right width, and kept by a checkpoint."""

from dataclasses import dataclass, replace

import emcee
import numpy as np
import pytest

from tests.posterior.densities import Gaussian, plain
from tests.posterior.runs import same, sample
from vttig_jax.posterior.sampling import ensemble_blocks as blocks
from vttig_jax.posterior.sampling.checkpoint import read
from vttig_jax.posterior.sampling.ensemble_blocks import Ensembles, start
from vttig_jax.posterior.sampling.ensembles import run_ensembles
from vttig_jax.posterior.sampling.importance import LaplaceTarget, weighted_draws
from vttig_jax.posterior.sampling.joint_moves import MOVES
from vttig_jax.posterior.sampling.laplace_move import SHARE, moves_with, share_around_fit
from vttig_jax.posterior.sampling.target import CheckedDensity


@dataclass
class Approximated(Gaussian):
    """Normal with an approximation that is `wider` than it and lies `off` its mean."""

    wider: float = 1.0
    off: float = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        self.covariance = self.wider**2 * self.covariance

    @property
    def centre(self) -> np.ndarray:
        return self.mean + self.off


def approximated(d: int = 6, wider: float = 1.3, off: float = 0.4) -> Approximated:
    return Approximated(np.zeros(d), np.eye(d), wider=wider, off=off)


def test_the_draws_are_those_of_emcee():
    target = approximated(2)
    moves = moves_with(target, SHARE)
    density = CheckedDensity(target)
    begun = start(density, np.random.SeedSequence(3).spawn(4), 16, 3)
    ensembles = Ensembles(density, begun, moves)
    ensembles.advance(50)
    ensembles.advance(70)
    for index in range(4):
        sampler = emcee.EnsembleSampler(
            16, 2, target.log_density, moves=list(moves), vectorize=True
        )
        own = blocks._walkers(begun, index)
        state = emcee.State(
            own.points, log_prob=own.log_density, random_state=own.random.get_state()
        )
        sampler.run_mcmc(state, 120)
        chain = sampler.get_chain()
        assert chain is not None
        np.testing.assert_array_equal(ensembles.record.draws[index], chain[2::3])


@pytest.mark.parametrize(("wider", "off"), [(1.3, 0.4), (0.8, 0.0)])
def test_the_draws_are_those_of_the_density_and_not_of_its_approximation(wider, off):
    target = approximated(wider=wider, off=off)
    chains = sample(None, target, steps=3000, walkers=64, laplace_share=SHARE)
    draws = chains.flat()
    assert np.abs(draws.mean(axis=0)).max() < 0.03
    assert np.abs(draws.var(axis=0) - 1).max() < 0.04
    assert chains.diagnosis.tau.max() < 0.5 * sample(None, target, steps=3000).diagnosis.tau.max()


def test_a_checkpoint_keeps_its_share(tmp_path):
    target, share = approximated(2), {"laplace_share": SHARE}
    whole = sample(None, target, steps=400, **share)
    sample(tmp_path / "a.h5", target, steps=200, **share)
    assert read(tmp_path / "a.h5")[0].laplace_share == SHARE
    again = sample(tmp_path / "a.h5", target, steps=400, resume=True)
    assert same(again, whole)
    sample(tmp_path / "b.h5", target, steps=200)  # as a file without the share would be
    plain_moves = sample(tmp_path / "b.h5", target, steps=400, resume=True, **share)
    assert same(plain_moves, sample(None, target, steps=400))
    assert not same(plain_moves, whole)


def test_only_good_weights_give_proposals_around_the_fit():
    pool = weighted_draws(approximated(), 2000, np.random.default_rng(0))
    assert isinstance(approximated(), LaplaceTarget)
    assert share_around_fit(pool) == SHARE
    assert share_around_fit(replace(pool, k_hat=0.8)) == 0.0
    few = np.zeros(2000)
    few[:150] = 1 / 150
    assert share_around_fit(replace(pool, weights=few)) == 0.0


def test_wrong_shares_and_targets_are_refused():
    assert moves_with(plain(), 0.0) is MOVES
    assert sum(weight for _, weight in moves_with(approximated(), 0.3)) == pytest.approx(1.0)
    with pytest.raises(ValueError, match=r"must be from 0 to below 1, but is 1\.0"):
        moves_with(approximated(), 1.0)
    with pytest.raises(ValueError, match="without `centre` and `covariance`"):
        run_ensembles(_Bare(), laplace_share=SHARE)


class _Bare:
    names, units, identity = ("x",), ("mm",), {}

    def log_density(self, points: np.ndarray) -> np.ndarray:
        return -0.5 * (points**2).sum(axis=1)

    def starts(self, count: int, generator: np.random.Generator) -> np.ndarray:
        return generator.standard_normal((count, 1))
