"""Ensembles of emcee on densities with known answers, and the stop rule."""

from typing import Any

import numpy as np
import pytest

from tests.posterior.densities import Gaussian, plain, same, sample
from vttig_jax.base import NoAnswerError
from vttig_jax.posterior import Until, run_ensembles
from vttig_jax.posterior.chains import THIN
from vttig_jax.posterior.proposal import Proposal

COVARIANCE = np.array([[1.0, 0.9, 0.0], [0.9, 1.0, 0.3], [0.0, 0.3, 4.0]])


def test_moments_are_those_of_the_density_although_the_start_is_not():
    target = Gaussian(np.array([1.0, -2.0, 30.0]), COVARIANCE, spread=1.6, off=0.5)
    chains = run_ensembles(target, until=Until(effective=4000.0))
    flat = chains.draws.reshape(-1, 3)
    assert chains.diagnosis.converged
    np.testing.assert_allclose(flat.mean(0), target.mean, atol=0.06 * 2)
    np.testing.assert_allclose(np.cov(flat.T), COVARIANCE, atol=0.25)
    inside = np.mean(np.abs(flat[:, 2] - 30) < 1.96 * 2)
    assert inside == pytest.approx(0.95, abs=0.01)


class TwoModes(Gaussian):
    """Two modes, far apart; half of the ensembles begin in the second one."""

    def log_density(self, points: np.ndarray) -> np.ndarray:
        far = points - [12.0, 0.0]
        return np.logaddexp(super().log_density(points), -0.5 * (far**2).sum(axis=1))

    def around(self) -> Proposal:
        class Split(Proposal):
            def starts(self, count: int, random: np.random.RandomState) -> np.ndarray:
                found = super().starts(count, random)
                found[np.arange(count) % 4 < 2, 0] += 12.0
                return found

        return Split(**vars(super().around()))


def test_ensembles_in_different_modes_have_not_converged():
    found = sample(None, TwoModes(np.zeros(2), np.eye(2)), steps=300).diagnosis
    assert found.r_hat[0] > 1.5 and not found.agreed and not found.converged
    assert found.r_hat[1] < 1.05
    assert sample(None, plain(), steps=300).diagnosis.agreed


def test_a_proposal_is_the_density_that_it_says_and_weighted_draws_that_of_the_target():
    """Its draws, weighted by the inverse of their density, are uniform: ∫ q = 1."""
    wide = Proposal.of(np.array([1.0, 2.0]), COVARIANCE[:2, :2], np.array([False, True]))
    draws = wide.draw(200_000, np.random.RandomState(0))
    box = np.all(np.abs(draws - [1.0, 2.0]) < 1.0, axis=1)
    volume = np.sum(box / np.exp(wide.log_density(draws))) / len(draws)
    assert volume == pytest.approx(4.0, rel=0.02)
    found = Gaussian(np.zeros(3), COVARIANCE, spread=1.5, off=0.4).around()
    assert 0.3 < found.weights.sum() ** 2 / np.sum(found.weights**2) / len(found.weights) <= 1.0
    np.testing.assert_allclose(found.mean, 0.0, atol=0.15)
    starts = found.starts(512, np.random.RandomState(1))
    np.testing.assert_allclose(np.cov(starts.T), COVARIANCE, atol=0.5)
    assert len(np.unique(starts, axis=0)) == 512


def test_the_rule_stops_at_the_first_look_that_is_enough():
    rules = Until(effective=500.0), Until(effective=3000.0), Until(1e9, most_steps=150)
    found, longer, never = (sample(None, steps=None, until=rule).diagnosis for rule in rules)
    assert found.converged and found.effective.min() >= 500 and longer.steps > found.steps
    assert never.steps == 150 and not never.converged


def test_equal_seeds_are_equal_and_steps_are_exact_with_progress_after_every_block():
    first, again, other = (sample(None, seed=seed) for seed in (3, 3, 4))
    assert same(first, again) and not np.array_equal(first.draws, other.draws)
    assert first.record.draws.shape == (4, 100 // THIN, 16, 2)
    assert sample(None, steps=43).diagnosis.steps == 45
    seen = []
    found = sample(None, steps=120, progress=seen.append)
    assert [one.steps for one in seen] == [50, 100, 120] and seen[-1].remaining_s == 0
    assert 0.3 < found.diagnosis.acceptance < 0.95


class Nowhere(Gaussian):
    def around(self) -> Proposal:
        start = Proposal.of(self.mean, self.covariance, np.zeros(len(self.mean), bool))
        return start.improved(lambda x: np.full(len(x), -np.inf))


WRONG = [
    ("ensembles", 3),
    ("walkers", 15),
    ("walkers", 2),
    ("walkers", 4000),
    ("seed", -1),
    ("steps", 39),
    ("until", Until()),
]


def test_arguments_and_densities_that_make_no_sense_are_refused():
    for name, value in WRONG:
        with pytest.raises(ValueError, match=f"`{name}`"):
            sample(None, **{name: value})
    with pytest.raises(ValueError, match="`checkpoint`"):
        sample(None, resume=True)
    rules: list[dict[str, Any]] = [{"effective": 0.0}, {"r_hat": 1.0}, {"most_steps": 5}]
    for rule in rules:
        with pytest.raises(ValueError, match=f"`{next(iter(rule))}`"):
            Until(**rule)
    with pytest.raises(NoAnswerError):
        sample(None, Nowhere(np.zeros(2), np.eye(2)))
