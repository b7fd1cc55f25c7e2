"""Numbers of a fit against draws of its posterior."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.special import stdtrit

from tests.model.small import drawn
from vttig_jax.model import Posterior, largest, solved


@pytest.fixture(scope="module")
def posterior() -> Posterior:
    problem = drawn(1, ((300, 250), (400, 350))).problem
    found = largest(problem.compressed)
    return Posterior(problem, np.asarray(found.value), found.aux)


@pytest.fixture(scope="module")
def draws(posterior):
    """Coefficient means, their covariances and θ at θ drawn from its normal approximation."""
    rng = np.random.default_rng(0)
    spread = 0.01**2 * posterior.theta_spread
    theta = rng.multivariate_normal(posterior.theta, spread, 600)
    told = jax.lax.map(
        lambda t: (lambda s: (s.beta, s.spread))(solved(t, posterior.problem.compressed)),
        jnp.asarray(theta),
    )
    return [np.asarray(part) for part in (*told, theta)]


def test_means_are_those_of_the_coefficients(posterior):
    rows = np.random.default_rng(1).normal(size=(5, len(posterior.problem.columns)))
    mean, _, _ = posterior.told(rows)
    np.testing.assert_allclose(mean, rows @ posterior.coefficients, rtol=1e-10)
    one = posterior.one(rows[2])
    assert one.value == pytest.approx(mean[2])
    assert one.half == pytest.approx(stdtrit(one.freedom, 0.975) * one.std)


def test_covariance_is_conditional_plus_that_of_theta(posterior, draws):
    """θ is drawn at a hundredth of its width, where means are linear in it, and scaled back."""
    beta, _, _ = draws
    problem, size = posterior.problem, len(posterior.problem.columns)
    means = problem.unit * beta[:, :size] @ problem.natural.T
    _, covariance, _ = posterior.told(np.eye(size))
    given = problem.natural @ np.asarray(posterior.at.spread)[:size, :size] @ problem.natural.T
    moved = covariance - problem.unit**2 * given
    drawn_part = 1e4 * np.diag(np.cov(means.T))
    told = np.diag(moved)
    large = told > 1e-6 * np.diag(covariance)
    assert large.sum() > 5
    np.testing.assert_allclose(told[large], drawn_part[large], rtol=0.35)
    assert np.median(told[large] / drawn_part[large]) == pytest.approx(1, abs=0.1)


def test_freedom_is_that_of_the_variance(posterior, draws):
    """A variance with ν degrees of freedom has a log variance of 2/ν."""
    _, spread, _ = draws
    size = len(posterior.problem.columns)
    natural = posterior.problem.natural
    variances = np.einsum("fi,dij,fj->df", natural, spread[:, :size, :size], natural)
    expected = 2 / (1e4 * np.var(np.log(variances), axis=0))
    _, _, freedom = posterior.told(np.eye(size))
    inside = (freedom > 4) & (freedom < 1e4)
    assert inside.sum() > 5
    np.testing.assert_allclose(freedom[inside], expected[inside], rtol=0.35)
    assert freedom.min() >= 4
    assert freedom[~inside & (expected < 3)].max(initial=4) == 4


def test_moved_rows_leave_the_fixed_part(posterior):
    """On orthogonal coefficients, delay is the mean of the log; on raw ones it is its level."""
    row = posterior.row(("delay",))
    raw, moved = posterior.one(row), posterior.one(row, moved=True)
    share = posterior.problem.natural / np.diag(posterior.problem.natural)
    coefficients = np.linalg.solve(share, posterior.coefficients)
    assert moved.value == pytest.approx(coefficients[posterior.problem.index["delay",]])
    assert raw.value != pytest.approx(moved.value, rel=1e-6)
    assert moved.std < raw.std
