"""The density that is sampled is that of the model, and of coefficients that a relation ties."""

import jax.numpy as jnp
import numpy as np
import pytest

from tests.posterior.made import drive_fit, quick_fit
from vttig_jax.model import log_density, normal
from vttig_jax.posterior.rig_draws import rig_draws, target_of
from vttig_jax.posterior.target import FitTarget

KINDS = {"gears": quick_fit, "a drive": drive_fit}
each_kind = pytest.mark.parametrize(
    "kind", [pytest.param("gears", marks=pytest.mark.slow), "a drive"]
)


def optimum(target: FitTarget) -> np.ndarray:
    """The point of the largest density."""
    own = target.posterior.theta[list(target.free)]
    return own if target.tie is None else np.append(own, target.tie.values)


@each_kind
def test_it_is_the_density_of_the_model(kind):
    """That one is compared with dense matrices of all rows in tests/model."""
    target = target_of(KINDS[kind]())
    assert target.tie is None
    best = optimum(target)
    points = best + 0.3 * np.outer(range(4), np.random.default_rng(0).standard_normal(len(best)))
    found, logs = target.log_density(points), target.posterior.problem.compressed
    known = [float(log_density(jnp.asarray(theta), logs)) for theta in target.thetas(points)]
    np.testing.assert_allclose(found, known, atol=1e-6)
    assert found[0] == pytest.approx(-float(target.posterior.at.value), abs=1e-6)
    assert np.all(found[1:] < found[0] - 1)


@each_kind
def test_coefficients_given_theta_have_the_moments_of_the_model(kind):
    fit = KINDS[kind]()
    target = target_of(fit)
    points = np.repeat(optimum(target)[None], 4000, axis=0)
    values, *_ = rig_draws(fit, target, points, np.random.RandomState(0))
    mean, covariance = target.posterior.given_noise(target.told.rows, moved=True)
    std = np.sqrt(np.diag(covariance))
    off = np.abs(values.mean(0) - mean - target.told.shift) / std
    assert off.max() < 0.1, dict(zip(target.told.names, off, strict=True))
    np.testing.assert_allclose(values.std(0), std, rtol=0.05)


@pytest.mark.slow
def test_tied_coefficients_add_their_normal_density():
    """On one flank the encoders are perfect: p is sampled, and c_T = h(p) exactly."""
    target = target_of(quick_fit(flank="A"))
    tie, best = target.tie, optimum(target)
    assert tie is not None and target.names[-len(tie.units) :] == tie.relation.names
    scale = np.concatenate([np.full(len(target.free), 0.1), np.sqrt(np.diag(tie.spread))])
    alone = FitTarget(target.posterior, target.told, target.data)
    for point in best + scale * np.random.default_rng(1).standard_normal((5, len(best))):
        one = normal(jnp.asarray(target.thetas(point[None])[0]), target.logs)
        low = np.linalg.inv(np.asarray(one.factor)) * np.asarray(one.scale)
        rows = np.asarray(tie.rows)
        mean = np.asarray(tie.start) + rows @ (low.T @ np.asarray(one.half))
        covariance = rows @ low.T @ low @ rows.T
        off = np.asarray(tie.tied(jnp.asarray(point[len(target.free) :]))) - mean
        known = alone.log_density(point[None, : len(target.free)])[0] - 0.5 * (
            off @ np.linalg.solve(covariance, off) + np.linalg.slogdet(covariance)[1]
        )
        assert target.log_density(point[None])[0] == pytest.approx(known, abs=1e-4)


def test_coefficients_of_sampled_eccentricities_are_those_that_they_tie():
    fit = quick_fit(flank="A")
    target = target_of(fit)
    assert target.tie is not None
    points = np.repeat(optimum(target)[None], 50, axis=0)
    _, _, cosine, _ = rig_draws(fit, target, points, np.random.RandomState(0))
    known = np.asarray(target.tie.relation.coefficients(target.tie.values))
    tied, free = (list(fit.model.terms).index((order, 0)) for order in (1, 2))
    np.testing.assert_allclose(cosine[:, 0, tied], known[0], rtol=1e-6, atol=1e-12)
    assert cosine[:, 0, free].std() > 1e-9
