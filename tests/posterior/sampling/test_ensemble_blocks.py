import dataclasses

import emcee
import numpy as np
import pytest
from emcee.moves import DEMove, DESnookerMove

from tests.posterior.densities import Gaussian, plain
from vttig_jax.base.errors import InputError
from vttig_jax.posterior.sampling import ensemble_blocks as blocks
from vttig_jax.posterior.sampling.ensemble_blocks import (
    Ensembles,
    Record,
    check_same_density,
    start,
    warm_up,
)
from vttig_jax.posterior.sampling.joint_moves import MOVES, Walkers
from vttig_jax.posterior.sampling.target import CheckedDensity


def begun(target: Gaussian, walkers: int = 16, thin: int = 5) -> Ensembles:
    density = CheckedDensity(target)
    seeds = np.random.SeedSequence(3).spawn(4)
    return Ensembles(density, start(density, seeds, walkers, thin))


def equal(one: Record, other: Record) -> bool:
    return all(np.array_equal(getattr(one, name), getattr(other, name)) for name in vars(one))


def test_the_draws_are_those_of_emcee():
    ensembles = begun(plain(), thin=3)
    first = ensembles.record
    for steps in (50, 190):
        ensembles.advance(steps)
    found = ensembles.record
    for index in range(4):
        sampler = emcee.EnsembleSampler(
            16, 2, plain().log_density, moves=list(MOVES), vectorize=True
        )
        own = blocks._walkers(first, index)
        state = emcee.State(
            own.points, log_prob=own.log_density, random_state=own.random.get_state()
        )
        sampler.run_mcmc(state, 240)
        chain, values = sampler.get_chain(), sampler.get_log_prob()
        assert chain is not None and values is not None
        np.testing.assert_array_equal(found.draws[index], chain[2::3])
        np.testing.assert_array_equal(found.log_density[index], values[2::3])
        assert found.accepted[index] == sampler.backend.accepted.sum()


@pytest.mark.parametrize("parts", [[60], [1] * 10 + [50], [7, 20, 33]])
def test_the_parts_a_run_is_made_of_do_not_matter(parts):
    whole, pieces = begun(plain()), begun(plain())
    whole.advance(60)
    for part in parts:
        pieces.advance(part)
    assert equal(whole.record, pieces.record)
    assert whole.record.draws.shape == (4, 12, 16, 2)


def test_the_state_of_a_twister_is_kept_with_half_a_pair_of_normal_numbers(unchecked):
    twister = np.random.RandomState(8)
    twister.standard_normal(3)
    own = Walkers(np.zeros((4, 2)), np.zeros(4), twister)
    record = dataclasses.replace(begun(plain()).record, **blocks._end_state([own]))
    again = blocks._walkers(record, 0).random
    assert record.rest[0, 1] == 1.0
    assert again.standard_normal(5).tolist() == twister.standard_normal(5).tolist()


def test_seeds_start_and_move_ensembles_apart():
    ensembles = begun(plain())
    ensembles.advance(5)
    record = ensembles.record
    assert len(np.unique(record.draws)) > 0.9 * record.draws.size
    assert len(np.unique(record.keys, axis=0)) == 4


@pytest.mark.parametrize("interruption", [KeyboardInterrupt, SystemExit])
def test_an_interrupt_inside_a_block_leaves_the_block_before(interruption, capsys):
    class Interrupted(Gaussian):
        left = 4 + 2 * 80 + 25

        def log_density(self, points: np.ndarray) -> np.ndarray:
            self.left -= 1
            if self.left == 0:
                raise interruption
            return super().log_density(points)

    ensembles = begun(Interrupted(np.zeros(2), np.eye(2)))
    ensembles.advance(40)
    ensembles.advance(40)
    before, copy = ensembles.record, ensembles.record.draws.copy()
    with pytest.raises(interruption):
        ensembles.advance(40)
    assert ensembles.record is before
    np.testing.assert_array_equal(before.draws, copy)
    ensembles.advance(40)  # goes on as if nothing had been
    whole = begun(plain())
    whole.advance(before.steps + 40)
    assert equal(ensembles.record, whole.record)
    assert capsys.readouterr() == ("", "")  # emcee prints the exceptions of a density


@pytest.mark.parametrize("walkers", [6, 64, 66])
def test_every_shape_is_known_before_the_first_step(walkers):
    target = plain(3)
    ensembles = begun(target, walkers)
    warm_up(CheckedDensity(target), ensembles.record.points)
    warm = set(target.sizes)
    target.sizes.clear()
    ensembles.advance(60)
    assert set(target.sizes) <= warm
    assert walkers not in target.sizes and len(target.sizes) == 60 * 2


def test_another_density_is_refused_by_a_point():
    target = plain()
    record = begun(target).record
    check_same_density(CheckedDensity(target), record, blocks.Path("p.h5"))
    other = Gaussian(np.full(2, 1e-3), np.eye(2))
    with pytest.raises(InputError, match=r"another density: at x0 = .* expected; replace it"):
        check_same_density(CheckedDensity(other), record, blocks.Path("p.h5"))


def variance(moves: list) -> float:
    """Variance found of a normal of six coordinates; 1 is right, the standard error is 0.006."""
    target = plain(6)
    sampler = emcee.EnsembleSampler(64, 6, target.log_density, moves=moves, vectorize=True)
    start = target.starts(64, np.random.default_rng(1))
    twister = np.random.RandomState(5).get_state()
    sampler.run_mcmc(emcee.State(start, random_state=twister), 3000)
    return float(np.var(np.asarray(sampler.get_chain(discard=300))))


def test_the_moves_draw_the_right_width():
    assert variance(list(MOVES)) == pytest.approx(1.0, abs=0.03)


def test_the_snooker_move_that_is_not_used_draws_too_narrow():
    if emcee.__version__ != "3.1.6":
        pytest.skip("the move was put right after emcee 3.1.6")
    assert variance([(DEMove(), 0.8), (DESnookerMove(), 0.2)]) < 0.95
