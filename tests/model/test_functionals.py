"""Numbers of a fit against draws of the whole posterior, of θ and of the coefficients."""

import emcee
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.special import stdtrit
from scipy.stats import norm

from tests.model.small import drawn
from vttig_jax.model import (
    DELAY,
    LAGS,
    ColumnName,
    Posterior,
    Readings,
    RowName,
    largest,
    log_density,
    normal,
)

FIRST = ColumnName(RowName("a"))
WALKERS, STEPS = 64, 800


def fitted(seed: int, lengths: tuple[tuple[int, int], ...]) -> Posterior:
    problem = drawn(seed, lengths).problem
    found = largest(problem.compressed)
    return Posterior(problem, np.asarray(found.value), found.aux)


@pytest.fixture(scope="module")
def posterior() -> Posterior:
    return fitted(1, ((300, 250), (400, 350)))


def draws_of(posterior: Posterior, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean and standard deviation of `rows` @ coefficients at θ drawn by emcee."""
    problem, size = posterior.problem, len(posterior.problem.columns)
    on = np.concatenate([np.ones(LAGS + 1), np.asarray(problem.compressed.on)]) > 0
    functionals = np.zeros((len(rows), len(posterior.at.beta)))
    functionals[:, :size] = rows @ problem.natural

    def at(point):
        theta = jnp.asarray(posterior.theta).at[np.flatnonzero(on)].set(point)
        one = normal(theta, problem.compressed)
        half = jax.scipy.linalg.solve_triangular(
            one.factor, one.scale[:, None] * functionals.T, lower=True
        )
        density = log_density(theta, problem.compressed, one)
        return density, functionals @ one.solved(one.half), jnp.sum(half**2, axis=0)

    several = jax.jit(jax.vmap(at))
    log_prob = lambda points: np.nan_to_num(several(points)[0], nan=-np.inf)  # noqa: E731
    random = np.random.RandomState(0)
    root = np.linalg.cholesky(posterior.theta_spread[np.ix_(on, on)])
    start = posterior.theta[on] + 0.5 * random.normal(size=(WALKERS, on.sum())) @ root.T
    sampler = emcee.EnsembleSampler(WALKERS, on.sum(), log_prob, vectorize=True)
    sampler.random_state = random.get_state()
    sampler.run_mcmc(start, STEPS)
    points = sampler.get_chain(discard=STEPS // 4, thin=10, flat=True)
    _, mean, variance = map(np.asarray, jax.lax.map(at, jnp.asarray(points), batch_size=64))
    unit = problem.unit
    return unit * mean + rows @ problem.natural @ problem.start, unit * np.sqrt(variance)


def quantiles(mean: np.ndarray, std: np.ndarray) -> np.ndarray:
    """Quantiles 2.5 and 97.5 % of a mixture of normals."""
    grid = np.linspace((mean - 4 * std).min(), (mean + 4 * std).max(), 2001)
    below = norm.cdf((grid[:, None] - mean) / std).mean(axis=1)
    return np.interp([0.025, 0.975], below, grid)


def test_means_are_those_of_the_coefficients_and_covariances_positive(posterior):
    rows = np.random.default_rng(1).normal(size=(8, len(posterior.problem.columns)))
    mean, covariance, freedom = posterior.told(rows)
    np.testing.assert_allclose(mean, rows @ posterior.coefficients, rtol=1e-10)
    assert posterior.one(rows[2]).value == pytest.approx(mean[2])
    np.testing.assert_allclose(covariance, covariance.T, rtol=1e-9)
    assert np.linalg.eigvalsh(covariance).min() > 0 and freedom.min() > 4


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.slow)])
def test_intervals_are_those_of_the_whole_posterior(seed):
    """On short logs, where the posterior of the noise is wide and skew."""
    posterior = fitted(seed, ((80, 75), (70, 85)))
    rows = np.eye(len(posterior.problem.columns))
    exact = np.array(
        [quantiles(*one) for one in zip(*(d.T for d in draws_of(posterior, rows)), strict=True)]
    )
    half, middle = np.diff(exact)[:, 0] / 2, exact.mean(axis=1)
    value, covariance, freedom = posterior.told(rows)
    found = stdtrit(freedom, 0.975) * np.sqrt(np.diag(covariance))
    assert np.median(found / half) == pytest.approx(1, abs=0.1)
    assert np.quantile(np.abs(found / half - 1), 0.9) < 0.25
    assert np.abs(value - middle).max() < 0.3 * half.max()
    narrow = 1.96 * np.sqrt(np.diag(posterior.given_noise(rows)[1]))
    assert np.median(narrow / half) < 0.92  # one θ alone is too sure


def test_long_logs_tell_the_noise_and_moved_rows_leave_the_fixed_part(posterior):
    """A coefficient that hangs on no prior scale: one θ is as good as all."""
    row = posterior.row(FIRST)[None]
    _, covariance, freedom = posterior.told(row)
    total = covariance * freedom / (freedom - 2)
    np.testing.assert_allclose(total, posterior.given_noise(row)[1], rtol=0.06)
    assert freedom.min() > 30
    row = posterior.row(DELAY)
    raw, moved = posterior.one(row), posterior.one(row, moved=True)
    share = posterior.problem.natural / np.diag(posterior.problem.natural)
    coefficients = np.linalg.solve(share, posterior.coefficients)
    assert moved.value == pytest.approx(coefficients[posterior.problem.index[DELAY]])
    assert raw.value != pytest.approx(moved.value, rel=1e-6)
    assert moved.std < raw.std


def test_readings_of_a_coefficient_narrow_it(posterior):
    """A reading as exact as the fit: the mean goes half of the way, the variance to a half."""
    row = posterior.row(FIRST)[None]
    problem = posterior.problem
    mean, covariance = posterior.given_noise(row)
    acts = np.zeros((1, len(posterior.at.beta)))
    acts[:, : len(problem.columns)] = row @ problem.natural
    start = row @ problem.natural @ problem.start
    far = mean + 2 * np.sqrt(covariance[0])
    variance = covariance[0, 0] / problem.unit**2
    after = posterior.with_readings(Readings(acts, (far - start) / problem.unit, variance))
    moved, narrower = after.given_noise(row)
    assert moved[0] == pytest.approx(0.5 * (mean[0] + far[0]))
    assert narrower[0, 0] == pytest.approx(0.5 * covariance[0, 0])
    before, now = posterior.one(row[0]), after.one(row[0])
    assert now.std == pytest.approx(before.std / np.sqrt(2), rel=0.05)
