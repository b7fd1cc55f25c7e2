"""Reduced rows as polynomials of the noise: equal to the elimination within the box."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from tests.posterior import quick_fits
from tests.posterior.density.test_likelihood import case
from vttig_jax.posterior.density import interpolated_rows as module
from vttig_jax.posterior.density.density import FitTarget, fit_target
from vttig_jax.posterior.density.interpolated_rows import InterpolatedRows, interpolated_rows
from vttig_jax.posterior.density.likelihood import Likelihood

CENTRE = np.array([0.6, -0.2, 0.1, 0.05, -0.05, 0.02])
STD = 0.01


@pytest.fixture(scope="module")
def target() -> FitTarget:
    return fit_target(quick_fits.plain())


def rows_of(order: int, std: float = STD) -> tuple[Likelihood, InterpolatedRows | None]:
    likelihood = case().likelihood(order)
    return likelihood, interpolated_rows(likelihood, CENTRE[:order], np.full(order, std))


@eqx.filter_jit
def both_densities(likelihood, rows, sampled, point):
    """Log-densities by elimination and by the polynomials."""
    exact = likelihood(sampled, point, jnp.log(3e-5))
    return exact, likelihood(sampled, point, jnp.log(3e-5), rows(point))


@pytest.mark.parametrize("order", [0, 1, 2, 3])
def test_the_log_likelihood_is_that_of_the_elimination(order):
    likelihood, rows = rows_of(order)
    assert rows is not None
    generator = np.random.default_rng(order)
    sampled = 1e-5 * generator.standard_normal(len(likelihood.sampled_indices))
    corners = np.sign(generator.standard_normal((6, order)))
    inside = generator.uniform(-1, 1, (6, order))
    points = np.asarray(rows.centre + rows.half_width * np.concatenate([corners, inside]))
    assert rows.holds(points)
    for point in points:
        exact, quick = both_densities(likelihood, rows, sampled, point)
        assert float(quick) == pytest.approx(float(exact), rel=1e-8)


def test_a_wide_posterior_needs_more_terms_and_too_many_are_refused():
    narrow, wide = rows_of(2, 0.001)[1], rows_of(2)[1]
    assert narrow is not None and wide is not None
    assert len(narrow.degrees) < len(wide.degrees) <= module._MOST_TERMS
    assert rows_of(6)[1] is None


def test_at_the_bound_of_stationarity_there_is_no_box():
    likelihood = case().likelihood(1)
    assert interpolated_rows(likelihood, np.array([0.999]), np.array([0.01])) is None


def test_the_error_sees_a_wrong_coefficient():
    likelihood, rows = rows_of(1)
    assert rows is not None
    generator = np.random.default_rng(0)
    scaled = generator.uniform(-1, 1, (module._BATCH, 1))
    wanted = module._reduced(likelihood, np.asarray(rows.centre + rows.half_width * scaled))
    terms = module._terms(scaled, np.array(rows.degrees))
    count = float(likelihood.rows)
    assert module._error(terms @ rows.coefficients, wanted, rows.shape, count) <= 1e-6
    wrong = np.array(rows.coefficients)
    wrong[1] *= 1 + 1e-4
    assert module._error(terms @ wrong, wanted, rows.shape, count) > 1e-5


def test_outside_the_box_the_elimination_decides(target, monkeypatch):
    rows = target._rows
    assert rows is not None
    points = target.starts(5, np.random.default_rng(1))
    far = points.copy()
    far[2, -1] = rows.centre[-1] + 1.5 * rows.half_width[-1]
    density = jax.jit(jax.vmap(target.density))
    exact = np.asarray(density(far))
    np.testing.assert_allclose(target.log_density(far), exact, atol=1e-9)
    np.testing.assert_allclose(target.log_density(points), np.asarray(density(points)), atol=1e-6)


@pytest.mark.parametrize("count", [1, 31, 32, 33, 64, 130])
def test_every_number_of_points_gives_the_same_values(target, count):
    points = target.starts(130, np.random.default_rng(2))
    np.testing.assert_allclose(
        target.log_density(points[:count]), target.log_density(points)[:count], atol=1e-7
    )


@pytest.mark.parametrize("limit", ["_MOST_TERMS", "_MOST_NODES"])
def test_as_many_terms_and_nodes_as_the_most_are_allowed(monkeypatch, limit):
    """One correlation has as many nodes as terms."""
    whole = rows_of(1)[1]
    assert whole is not None
    monkeypatch.setattr(module, limit, len(whole.degrees))
    again = rows_of(1)[1]
    assert again is not None and len(again.degrees) == len(whole.degrees)
    monkeypatch.setattr(module, limit, len(whole.degrees) - 1)
    assert rows_of(1)[1] is None
