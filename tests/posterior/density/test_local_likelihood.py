"""Likelihood near the fit: equal to the exact one within its box, and nowhere used where not."""

from dataclasses import replace

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from tests.posterior import quick_fits
from vttig_jax.posterior.density import density as densities
from vttig_jax.posterior.density import local_likelihood as module
from vttig_jax.posterior.density.density import FitTarget, fit_target
from vttig_jax.posterior.density.local_likelihood import LocalLikelihood, local_likelihood
from vttig_jax.posterior.density.orthogonal_columns import orthogonal_columns
from vttig_jax.posterior.density.prior import SHAFTS, Prior

FITS = {
    "plain": quick_fits.plain,
    "one flank": quick_fits.one_flank,
    "not all determined": quick_fits.short,
    "perfect gears": quick_fits.perfect_gears,
    "two logs, two speeds": quick_fits.two_speeds,
    "robust loss": quick_fits.robust,
}


@pytest.fixture(scope="module")
def target() -> FitTarget:
    return fit_target(quick_fits.plain())


def near(target: FitTarget) -> LocalLikelihood:
    local = target._local
    assert local is not None
    return local


def spread_points(target: FitTarget, spread: float, count: int = 96) -> np.ndarray:
    """Draws of the Laplace approximation, spread out and kept inside the box."""
    reach = 0.999 * np.asarray(near(target).half_width)
    away = target.starts(count, np.random.default_rng(7)) - target.centre
    return target.centre + np.clip(spread * away, -reach, reach)


@pytest.mark.parametrize("name", FITS)
def test_it_is_the_exact_density_to_1e_8(name):
    target = fit_target(FITS[name]())
    for spread in (1.0, 3.0):
        points = spread_points(target, spread)
        wrong = target.log_density(points) - target.exact_log_density(points)
        assert near(target).holds(points).all()
        assert np.abs(wrong).max() < 2e-8


def test_it_is_the_exact_density_at_the_corners_of_the_box_and_of_the_prior(target):
    """A prior that is narrower than the box; outside it both are zero."""
    box = near(target)
    planes = [[target.names.index(f"{gear}_{axis}") for axis in "xy"] for gear in SHAFTS]
    largest = max(float(np.hypot(*target.centre[plane])) for plane in planes)
    narrow = fit_target(quick_fits.plain(), Prior(eccentricity_mm=1.001 * largest))
    signs = np.sign(np.random.default_rng(3).standard_normal((64, len(target.centre))))
    reach = np.where(np.isfinite(box.half_width), box.half_width, 0.05)
    points = target.centre + 0.999 * signs * reach
    for density in (target, narrow):
        found, wanted = density.log_density(points), density.exact_log_density(points)
        inside = np.isfinite(wanted)
        assert np.array_equal(inside, np.isfinite(found))
        np.testing.assert_allclose(found[inside], wanted[inside], rtol=1e-8)
    assert not inside.all()


def test_a_point_outside_the_box_gets_the_exact_density_and_its_neighbours_do_not_change(target):
    box = near(target)
    points = target.starts(5, np.random.default_rng(1))
    far = points.copy()
    far[2, -1] = box.centre[-1] + 1.5 * box.half_width[-1]
    assert box.holds(far).tolist() == [True, True, False, True, True]
    found = target.log_density(far)
    assert found[2] == target.exact_log_density(far[2:3])[0]
    assert np.array_equal(np.delete(found, 2), np.delete(target.log_density(points), 2))
    prior = eqx.filter_jit(target.density.log_prior)(jnp.asarray(far[2]))
    own = eqx.filter_jit(box)(jnp.asarray(far[2:3]))
    assert abs(float(own[0] + prior) - found[2]) > 1e-6  # the polynomial does not hold there


@pytest.mark.parametrize("count", [1, 31, 32, 33, 64, 130])
def test_every_number_of_points_gives_the_same_values(target, count):
    points = target.starts(130, np.random.default_rng(2))
    np.testing.assert_allclose(
        target.log_density(points[:count]), target.log_density(points)[:count], atol=1e-9
    )


def test_a_wrong_likelihood_is_not_used(target, monkeypatch):
    """Its check at the probes compares it with the exact density."""

    def wrong(*arguments):
        found = local_likelihood(*arguments)
        assert found is not None
        return eqx.tree_at(lambda one: one.diagonal, found, found.diagonal * (1 + 1e-8))

    monkeypatch.setattr(densities, "local_likelihood", wrong)
    refused = replace(target)
    assert refused._local is None
    points = target.starts(40, np.random.default_rng(4))
    assert np.array_equal(refused.log_density(points), refused.exact_log_density(points))


def test_a_wide_posterior_needs_higher_degrees_and_too_high_ones_are_refused(target, monkeypatch):
    likelihood, centre, covariance = target.density.likelihood, target.centre, target.covariance
    degrees = [
        local_likelihood(likelihood, centre, factor * covariance).degrees  # pyright: ignore
        for factor in (0.01, 1.0)
    ]
    assert degrees[0][1] < degrees[1][1] and degrees[0][0] <= degrees[1][0]
    monkeypatch.setattr(module, "_MOST_TERMS", 3)
    assert local_likelihood(likelihood, centre, covariance) is None


def test_a_posterior_with_many_noise_parameters_stays_exact():
    """Eight partial autocorrelations in a short log need too many polynomials."""
    target = fit_target(quick_fits.drive())
    assert len(target.partial) > 4 and target._local is None
    points = target.starts(3, np.random.default_rng(5))
    assert np.array_equal(target.log_density(points), target.exact_log_density(points))


def test_columns_that_depend_on_each_other_leave_the_exact_density(target):
    likelihood = target.density.likelihood
    twice = np.repeat(np.asarray(likelihood.spread), 2, axis=0)
    double = eqx.tree_at(lambda one: one.spread, likelihood, twice)
    assert local_likelihood(double, target.centre, target.covariance) is None


def test_at_the_noise_of_the_fit_the_gram_matrix_is_the_identity(target):
    likelihood, partial = target.density.likelihood, target.partial
    tied = np.zeros((2, likelihood.spread.shape[-1]))
    columns = orthogonal_columns(likelihood, partial, tied)
    first = columns.eliminated
    gram = np.tensordot(likelihood.kind.product_weights(partial), columns.gram, 1)
    np.testing.assert_allclose(gram[:first, :first], np.eye(first), atol=1e-11)
    np.testing.assert_allclose(gram[:first, first:], 0, atol=1e-9)
    small = columns.small_parts(likelihood.kind.product_weights(partial)[None])
    np.testing.assert_allclose(small, 0, atol=1e-12)
    moved = columns.small_parts(likelihood.kind.product_weights(partial + 0.02)[None])
    assert np.abs(moved).max() > 1e-9
