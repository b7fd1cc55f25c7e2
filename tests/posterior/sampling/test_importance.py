"""Importance sampling: weights, the check of their tail, starts of walkers, files."""

import numpy as np
import pytest
from scipy import stats

from tests.posterior import quick_fits
from tests.posterior.densities import Gaussian
from vttig_jax.base.errors import UsageError
from vttig_jax.posterior import sampler
from vttig_jax.posterior.density.density import FitTarget, fit_target
from vttig_jax.posterior.sampler import read_posterior, sample
from vttig_jax.posterior.sampling.ensembles import run_ensembles
from vttig_jax.posterior.sampling.importance import PosteriorStarts, weighted_draws
from vttig_jax.posterior.sampling.importance_run import run_importance
from vttig_jax.posterior.sampling.pareto import fitted_pareto, smoothed_log_weights

COVARIANCE = np.array([[1.0, 0.6], [0.6, 2.0]])


class Approximated(Gaussian):
    """Normal density whose Laplace approximation has `factor` times its covariance."""

    factor = 1.0

    @property
    def centre(self) -> np.ndarray:
        return self.mean

    def starts(self, count: int, generator: np.random.Generator) -> np.ndarray:
        return self.mean + np.sqrt(self.factor) * (super().starts(count, generator) - self.mean)


def approximated(factor: float = 1.0) -> Approximated:
    made = Approximated(np.array([1.0, -2.0]), COVARIANCE)
    made.factor = factor
    made.covariance = factor * COVARIANCE  # the density keeps its own factor
    return made


@pytest.fixture(scope="module")
def target() -> FitTarget:
    return fit_target(quick_fits.plain())


@pytest.mark.parametrize("shape", [-0.3, 0.2, 0.5, 0.9])
def test_the_shape_of_a_pareto_tail_is_found(shape):
    """Maximum likelihood by scipy is the oracle."""
    values = np.sort(stats.genpareto.rvs(shape, scale=2.5, size=4000, random_state=1))
    found, scale = fitted_pareto(values)
    wanted, _, size = stats.genpareto.fit(values, floc=0)
    assert found == pytest.approx(wanted, abs=0.03)
    assert scale == pytest.approx(size, rel=0.05)
    assert found == pytest.approx(shape, abs=0.08)


@pytest.mark.parametrize(("shape", "trusted"), [(0.3, True), (0.5, True), (0.9, False)])
def test_weights_with_a_known_tail(shape, trusted):
    weights = np.asarray(stats.genpareto.rvs(shape, size=200_000, random_state=2))
    smooth, found = smoothed_log_weights(np.log(weights))
    assert found == pytest.approx(shape, abs=0.12) and (found <= 0.7) == trusted
    assert np.exp(smooth).sum() == pytest.approx(1.0)
    assert np.array_equal(np.argsort(smooth)[:190_000], np.argsort(weights)[:190_000])
    assert smooth.max() - smooth.min() <= np.log(weights.max() / weights.min()) + 1e-9


def test_weights_of_zero_stay_zero_and_too_few_are_never_trusted():
    values = np.random.default_rng(0).standard_normal(400)
    values[:100] = -np.inf
    smooth, shape = smoothed_log_weights(values)
    assert (smooth[:100] == -np.inf).all() and np.isfinite(shape)
    assert smoothed_log_weights(np.zeros(10))[1] == np.inf
    assert smoothed_log_weights(np.full(400, -np.inf))[1] == np.inf
    assert smoothed_log_weights(np.zeros(400))[1] == -np.inf
    assert smoothed_log_weights(np.append(np.full(399, -np.inf), 0.0))[1] == np.inf
    few, shape = smoothed_log_weights(np.array([0.0, np.log(3.0), -np.inf, np.log(4.0)]))
    np.testing.assert_allclose(np.exp(few), [0.125, 0.375, 0.0, 0.5], rtol=1e-12)
    assert shape == np.inf


def test_weighted_draws_have_the_moments_of_the_density():
    draws = weighted_draws(approximated(1.3), 40_000, np.random.default_rng(0))
    mean = draws.weights @ draws.points
    away = draws.points - mean
    assert draws.reliable and draws.effective > 20_000
    np.testing.assert_allclose(mean, [1.0, -2.0], atol=0.03)
    np.testing.assert_allclose((draws.weights * away.T) @ away, COVARIANCE, atol=0.05)
    plain = np.cov(draws.points.T)  # negative control: without the weights it is another one
    assert np.abs(plain - COVARIANCE).max() > 0.3


def test_an_approximation_that_is_far_too_narrow_is_not_trusted():
    assert not weighted_draws(approximated(0.02), 4000, np.random.default_rng(0)).reliable


def test_resampled_draws_have_their_weights_and_starts_differ():
    draws = weighted_draws(approximated(1.5), 4000, np.random.default_rng(0))
    often = draws.resampled(40_000, np.random.default_rng(1), replace=True)
    share = np.bincount(often, minlength=4000) / 40_000
    assert np.abs(share - draws.weights).max() <= 1 / 40_000
    once = draws.resampled(64, np.random.default_rng(2), replace=False)
    assert len(set(once.tolist())) == 64


def test_walkers_that_start_in_the_posterior_need_no_burn_in():
    """They have the spread of the density; those of a narrow approximation have not."""
    narrow = approximated(0.3)
    spreads = []
    for target in (PosteriorStarts(narrow), narrow):
        starts = np.concatenate([target.starts(64, np.random.default_rng(k)) for k in range(60)])
        spreads.append(np.cov(starts.T))
    assert np.abs(spreads[0] / COVARIANCE - 1).max() < 0.15
    assert np.abs(spreads[1] / COVARIANCE - 1).max() > 0.5
    chains = run_ensembles(PosteriorStarts(narrow), steps=400, burn_in=0.0)
    assert chains.discarded == 0 and chains.kept.shape[1] == 80
    assert run_ensembles(narrow, steps=400).discarded == 100


def test_a_fit_starts_in_its_posterior_only_where_the_weights_are_trusted(
    target, tmp_path, monkeypatch
):
    chains = sample(quick_fits.plain(), steps=200, checkpoint=tmp_path / "p.h5").chains
    assert chains is not None and chains.discarded == 0
    again = read_posterior(tmp_path / "p.h5", quick_fits.plain())
    assert again.draws.shape == chains.kept.shape
    monkeypatch.setattr(sampler, "POOL", 20)  # too few weights for a tail
    assert sample(quick_fits.plain(), steps=100).draws.shape[1] == 15  # 20 kept, 5 discarded


def test_importance_sampling_alone_is_the_posterior_of_the_ensembles(target, tmp_path):
    place = tmp_path / "posterior.h5"
    weighted = sample(quick_fits.plain(), method="importance", seed=3, checkpoint=place)
    chained = sample(quick_fits.plain(), seed=3, steps=1600)
    assert weighted.diagnosis.converged and weighted.draws.shape == (4, 4096, 1, 11)
    std = np.sqrt(np.diag(target.covariance))
    drawn = [run.diagnosis.effective.min() for run in (weighted, chained)]
    error = np.sqrt(sum(1 / effective for effective in drawn))  # both means have one
    assert np.abs((weighted.mean - chained.mean) / std).max() < 5 * error
    widths = np.sqrt(np.diag(weighted.covariance) / np.diag(chained.covariance))
    assert np.abs(np.log(widths)).max() < 5 * error / np.sqrt(2)
    record = weighted.to_json()["diagnosis"]
    assert record["sampler"] == "importance" and record["pareto_k"] < 0.7 and record["converged"]
    again = read_posterior(place, quick_fits.plain())
    assert np.array_equal(again.draws, weighted.draws)
    assert again.to_json()["diagnosis"] == record
    with pytest.raises(UsageError, match="overwrite"):
        sample(quick_fits.plain(), method="importance", checkpoint=place)
    other = sample(
        quick_fits.plain(),
        method="importance",
        seed=4,
        steps=500,
        ensembles=5,
        checkpoint=place,
        overwrite=True,
    )
    assert other.draws.shape[:2] == (5, 500) and not np.array_equal(other.mean, weighted.mean)


def test_weights_that_are_not_trusted_have_not_converged():
    chains = run_importance(approximated(0.02))
    assert not chains.diagnosis.converged
    assert "--method emcee" in str(chains.diagnosis)
    few = run_importance(approximated(), draws=200)
    assert "--steps 800" in str(few.diagnosis) and not few.diagnosis.converged


@pytest.mark.parametrize("arguments", [{"resume": True}, {"walkers": 64}])
def test_arguments_of_chains_are_refused(arguments, tmp_path, unchecked):
    with pytest.raises(ValueError, match=next(iter(arguments))):
        sample(quick_fits.plain(), method="importance", checkpoint=tmp_path / "p.h5", **arguments)
    with pytest.raises(ValueError, match="method"):
        sample(quick_fits.plain(), method="nuts")  # pyright: ignore[reportArgumentType]


@pytest.mark.parametrize("arguments", [{"draws": 39}, {"ensembles": 3}, {"seed": -1}])
def test_wrong_sizes_are_named(arguments):
    with pytest.raises(ValueError, match=next(iter(arguments))):
        run_importance(approximated(), **arguments)
