"""The density, its derivatives and its largest value, against independent computations."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from tests.model.small import Small, dense, dense_density, drawn, rows_with, theta_near
from vttig_jax import model
from vttig_jax.model import GROUPS, LAGS, Column, RowName, first_theta, largest, maximise

solved, log_density = jax.jit(model.solved), jax.jit(model.log_density)

LENGTHS = [((14, 11), (12, 17)), ((10, 10, 10, 10),), ((30,), (25, 9)), ((60, 40),)]


@pytest.mark.parametrize(("seed", "lengths"), list(enumerate(LENGTHS)))
def test_the_density_is_that_of_dense_matrices(seed, lengths):
    small = drawn(seed, lengths)
    problem = small.problem
    found, expected = [], []
    for number in range(5):
        theta = theta_near(100 * seed + number, problem)
        found.append(float(log_density(jnp.asarray(theta), problem.compressed)))
        expected.append(dense_density(small, theta))
    np.testing.assert_allclose(found, expected, rtol=2e-6)
    assert np.ptp(found) > 1


def test_little_noise_under_wide_priors_costs_no_digits():
    """The marginal covariance is solved in 50 digits: its condition number is 1e10 here."""
    small = drawn(3, ((22, 19),), noise=1e-2)
    problem = small.problem
    theta = theta_near(2, problem, 0.1)
    theta[LAGS] = -1.0
    found, other = (
        float(log_density(jnp.asarray(one), problem.compressed)) for one in (theta, theta + 1e-3)
    )
    assert found == pytest.approx(dense_density(small, theta, 50), rel=1e-6)
    assert other != pytest.approx(found, rel=1e-6)


@pytest.mark.parametrize("seed", range(3))
def test_derivatives_are_those_of_the_density(seed):
    problem = drawn(seed).problem
    theta = jnp.asarray(theta_near(seed, problem))
    negative = lambda t: -log_density(t, problem.compressed)  # noqa: E731
    told = solved(theta, problem.compressed)
    assert float(told.value) == pytest.approx(float(negative(theta)), rel=1e-10)
    gradient, hessian = jax.grad(negative)(theta), jax.hessian(negative)(theta)
    np.testing.assert_allclose(told.gradient, gradient, atol=1e-6)
    np.testing.assert_allclose(told.hessian, hessian, atol=1e-5)
    near = solved(theta + 1e-3, problem.compressed)
    assert np.abs(np.asarray(told.hessian - near.hessian)).max() > 1e-4


def test_coefficients_are_generalised_least_squares():
    small = drawn(5)
    problem, theta = small.problem, theta_near(5, small.problem)
    told, size = solved(jnp.asarray(theta), problem.compressed), len(small.columns)
    x, y, noise, width, mean = dense(small, theta)
    weight = np.linalg.inv(noise.astype(float))
    whole = x.T @ weight @ x + np.diag(width**-2)
    expected = np.linalg.solve(whole, x.T @ weight @ y + width**-2 * mean)
    found = np.asarray(told.beta)[:size] + problem.start / problem.unit
    np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-7)
    spread = np.asarray(told.spread)[:size, :size]
    np.testing.assert_allclose(spread, np.linalg.inv(whole), rtol=1e-5, atol=1e-9)


def _far(start: np.ndarray, seed: int) -> jnp.ndarray:
    rng = np.random.default_rng([3, seed])
    far = np.array([1.0] + [0.4] * (LAGS - 1) + [2.0] + [2.5] * len(GROUPS))
    return jnp.asarray(start + far * rng.normal(size=len(start)))


@pytest.mark.parametrize("seed", range(4))
def test_far_starts_end_in_one_optimum(seed):
    problem = drawn(seed, ((60, 45), (50, 70))).problem
    start = first_theta(problem.compressed)
    best = maximise(problem.compressed)
    told = best.aux
    step = np.linalg.solve(told.hessian, told.gradient)
    assert told.gradient @ step < 1e-8
    assert np.linalg.eigvalsh(told.hessian)[0] > 0
    for number in range(5):
        other = maximise(problem.compressed, _far(start, number))
        assert float(other.aux.value) == pytest.approx(float(told.value), abs=1e-6)
    assert float(-log_density(_far(start, 0), problem.compressed)) > float(told.value) + 1


def _sine_beside_noise(share: float) -> Small:
    """Five cycles of a sine over 160 rows: the order of a group, or noise with a resonance."""
    rng = np.random.default_rng(0)
    count = 160
    phase = 2 * np.pi * 5 * np.arange(count) / count
    noise = np.zeros(count + 50)
    for k in range(2, count + 50):
        noise[k] = 1.9 * np.cos(phase[1]) * noise[k - 1] - 0.9025 * noise[k - 2] + rng.normal()
    noise = noise[50:]
    y = share * noise.std() * np.sin(phase + 0.4) + noise
    table = np.c_[np.ones(count), np.cos(phase), np.sin(phase), y]
    one, c, s = names = [RowName(kind) for kind in ("one", "c", "s")]
    columns = Column(one, (0,)), Column(c, prior="driving"), Column(s, prior="driving")
    rows = rows_with(names, table, [count], ["A"])
    return Small(columns, (rows,), {}, dict.fromkeys(GROUPS, 0.05))


@pytest.mark.parametrize("share", [0.0, 1.0, 3.0])
def test_the_better_of_two_modes_is_taken(share):
    """The largest density is at least as good as twenty searches from far starts."""
    problem = _sine_beside_noise(share).problem
    start = first_theta(problem.compressed)
    values = [float(maximise(problem.compressed, _far(start, k)).aux.value) for k in range(20)]
    found = largest(problem.compressed)
    assert float(found.aux.value) < min(values) + 1e-6
