"""The density that is sampled, against dense covariance matrices of all rows of a short log."""

from functools import cache

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.signal import lfilter

from tests.posterior.made import drive_fit, quick_fit
from vttig_jax.identify.result import Fit
from vttig_jax.model.columns import embedding
from vttig_jax.model.density import LAGS, log_density, normal, whitening
from vttig_jax.model.rows import S
from vttig_jax.posterior.rig_draws import rig_draws, target_of, tie_of
from vttig_jax.posterior.target import FitTarget, joint_density

KINDS = {"gears": quick_fit, "a drive": drive_fit}
EACH = [pytest.param("gears", marks=pytest.mark.slow), "a drive"]


def covariance_of(theta: np.ndarray, count: int) -> np.ndarray:
    """Covariance of an autoregression from its impulse response."""
    taps = np.asarray(whitening(jnp.asarray(0.9999 * np.tanh(theta[:LAGS]))))
    response = np.exp(theta[LAGS]) * lfilter([1.0], taps, np.eye(1, 6000)[0])
    own = np.correlate(response, response, "full")[5999 : 5999 + count]
    return own[np.abs(np.subtract.outer(np.arange(count), np.arange(count)))]


@cache
def rows_of(kind: str) -> tuple[np.ndarray, np.ndarray, list[int]]:
    """Scaled columns, readings less the centre, and the rows of every run."""
    core = KINDS[kind]().core
    problem, (rows,) = core.posterior.problem, core.rows
    assert core.weights is None
    on_a, on_b = (rows.table @ embedding(problem.columns, rows.names, 0, one) for one in S)
    whole = np.where(rows.flank[:, None] == "A", on_a, on_b)
    x = whole[:, :-1] @ problem.natural
    y = (whole[:, -1] - x @ problem.start) / problem.unit
    return x, y, (rows.last - rows.first + 1).tolist()


def dense(kind: str, theta: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
    """ln of the restricted likelihood, and mean and covariance of the scaled coefficients."""
    logs = target_of(KINDS[kind]()).logs
    x, y, lengths = rows_of(kind)
    precision = np.asarray(logs.precision) + np.asarray(logs.member) @ (
        np.asarray(logs.on) * np.exp(-2 * theta[LAGS + 1 :])
    )
    noise = np.zeros((len(y), len(y)))
    ends = np.cumsum(lengths)
    for end, length in zip(ends, lengths, strict=True):
        noise[end - length : end, end - length : end] = covariance_of(theta, length)
    flat = precision == 0
    random = x[:, ~flat]
    centred = y + random @ np.asarray(logs.centre)[~flat]
    whole = noise + (random / precision[~flat]) @ random.T
    inverse = np.linalg.inv(whole)
    information = x[:, flat].T @ inverse @ x[:, flat]
    right = x[:, flat].T @ inverse @ centred
    quadratic = centred @ inverse @ centred - right @ np.linalg.solve(information, right)
    determinants = np.linalg.slogdet(whole)[1] + np.linalg.slogdet(information)[1]
    weight = np.linalg.inv(noise)
    spread = np.linalg.inv(x.T @ weight @ x + np.diag(precision))
    mean = spread @ (x.T @ weight @ y - precision * np.asarray(logs.centre))
    return -0.5 * (determinants + quadratic), mean, spread


def prior(target: FitTarget, theta: np.ndarray) -> float:
    """ln of the prior of θ, as `docs/claims.md` has it."""
    widths = np.array([2.5, 0.7, 0.7, 0.4, 0.4, 0.4, 0.4, 0.4])
    ratio = np.exp(theta[LAGS + 1 :]) / np.asarray(target.logs.usual)
    on = np.asarray(target.logs.on) > 0
    return float(
        -0.5 * np.sum((theta[:LAGS] / widths) ** 2)
        + np.sum(np.log(ratio / (1 + ratio**2))[on])
        - 0.5 * np.sum(np.log(ratio[~on]) ** 2)
    )


@pytest.mark.parametrize("kind", EACH)
def test_it_is_the_dense_restricted_likelihood_up_to_one_constant(kind):
    target = target_of(KINDS[kind]())
    random = np.random.default_rng(0)
    best = target.posterior.theta[list(target.free)]
    points = best + 0.3 * random.standard_normal((4, len(best)))
    found = target.log_density(points)
    known = [dense(kind, theta)[0] + prior(target, theta) for theta in target.thetas(points)]
    assert np.ptp(found) > 50  # the agreement is not that of equal numbers
    np.testing.assert_allclose(found - found[0], np.array(known) - known[0], atol=1e-4)


@pytest.mark.parametrize("kind", EACH)
def test_coefficients_given_theta_have_the_exact_moments(kind):
    fit = KINDS[kind]()
    target = target_of(fit)
    theta = target.posterior.theta
    point = np.repeat(theta[list(target.free)][None], 4000, axis=0)
    values, *_ = rig_draws(fit, target, point, np.random.RandomState(0))
    _, mean, spread = dense(kind, theta)
    problem = target.posterior.problem
    told, to = target.told, np.diag(problem.natural)
    rows = told.rows * to * problem.unit
    exact = told.rows @ (to * problem.start) + rows @ mean + told.shift
    std = np.sqrt(np.einsum("fi,ij,fj->f", rows, spread, rows))
    off = np.abs(values.mean(0) - exact) / std
    assert off.max() < 0.1, dict(zip(told.names, off, strict=True))
    np.testing.assert_allclose(values.std(0), std, rtol=0.05)


def one_flank() -> Fit:
    return quick_fit(flank="A")


@pytest.mark.slow
def test_tied_coefficients_add_their_normal_density():
    """On one flank the encoders are perfect: p is sampled, and c_T = h(p) exactly."""
    fit = one_flank()
    target = target_of(fit)
    tie = target.tie
    assert tie is not None and target.names[-len(tie.units) :] == tie.relation.names
    best = np.concatenate([target.posterior.theta[list(target.free)], tie.values])
    random = np.random.default_rng(1)
    scale = np.concatenate([np.full(len(target.free), 0.1), np.sqrt(np.diag(tie.spread))])
    points = best + scale * random.standard_normal((5, len(best)))
    alone = FitTarget(target.posterior, target.told, target.data)
    for point in points:
        theta = target.thetas(point[None])[0]
        one = normal(jnp.asarray(theta), target.logs)
        low = np.linalg.inv(np.asarray(one.factor)) * np.asarray(one.scale)
        spread = low.T @ low
        rows = np.asarray(tie.rows)
        mean = np.asarray(tie.start) + rows @ (low.T @ np.asarray(one.half))
        covariance = rows @ spread @ rows.T
        off = np.asarray(tie.tied(jnp.asarray(point[len(target.free) :]))) - mean
        known = alone.log_density(point[None, : len(target.free)])[0] - 0.5 * (
            off @ np.linalg.solve(covariance, off) + np.linalg.slogdet(covariance)[1]
        )
        assert target.log_density(point[None])[0] == pytest.approx(known, abs=1e-4)


def test_coefficients_of_sampled_eccentricities_are_those_that_they_tie():
    fit = one_flank()
    target = target_of(fit)
    tie = target.tie
    assert tie is not None
    best = np.concatenate([target.posterior.theta[list(target.free)], tie.values])
    points = np.repeat(best[None], 50, axis=0)
    _, _, cosine, _ = rig_draws(fit, target, points, np.random.RandomState(0))
    known = np.asarray(tie.relation.coefficients(tie.values))
    place = list(fit.model.terms).index((1, 0))
    np.testing.assert_allclose(cosine[:, 0, place], known[0], rtol=1e-6, atol=1e-12)
    free = list(fit.model.terms).index((2, 0))
    assert cosine[:, 0, free].std() > 1e-9


@pytest.mark.slow
def test_a_density_of_nothing_new_is_that_of_the_model():
    """The sampled density at the optimum of the fit is the value that the fit reports."""
    fit = quick_fit()
    target = target_of(fit)
    padded = target.posterior.problem.compressed
    theta = target.posterior.theta
    value = joint_density(
        jnp.asarray(theta[list(target.free)]), target.logs, jnp.asarray(theta), target.free, None
    )
    assert float(value) == pytest.approx(float(log_density(jnp.asarray(theta), padded)), abs=1e-6)
    assert float(value) == pytest.approx(-float(target.posterior.at.value), abs=1e-6)
    moved = theta[list(target.free)].copy()
    moved[0] += 0.5
    assert (
        float(joint_density(jnp.asarray(moved), target.logs, jnp.asarray(theta), target.free, None))
        < float(value) - 1
    )
    assert tie_of(fit, target.told) is not None and target.tie is None
