"""Slope of a density near its fit, by an imaginary step, against the exact density."""

import numpy as np
import pytest

from tests.posterior import quick_fits
from vttig_jax.posterior.density.density import fit_target
from vttig_jax.posterior.density.evaluation import exact_value_and_gradient
from vttig_jax.posterior.density.prior import Prior

FITS = {"plain": quick_fits.plain, "robust loss": quick_fits.robust}


@pytest.mark.parametrize("name", FITS)
@pytest.mark.parametrize("flat_in", ["plane", "amplitude"])
def test_value_and_slope_near_the_fit_are_those_of_the_exact_density(name, flat_in):
    target = fit_target(FITS[name](), Prior(flat_in=flat_in))
    assert target._local is not None
    size = np.sqrt(np.diag(target.covariance))
    for point in target.starts(3, np.random.default_rng(0)):
        value, slope = target.value_and_gradient(point)
        wanted, expected = exact_value_and_gradient(target.density, point)
        assert value == pytest.approx(wanted, abs=1e-7)
        np.testing.assert_allclose(slope * size, expected * size, atol=1e-6)


def test_a_point_far_from_the_fit_has_the_slope_of_the_exact_density():
    target = fit_target(quick_fits.plain())
    far = target.centre + 20 * np.sqrt(np.diag(target.covariance)) * (target.centre > 0)
    value, slope = target.value_and_gradient(far)
    wanted, expected = exact_value_and_gradient(target.density, far)
    assert value == wanted
    np.testing.assert_array_equal(slope, expected)


def test_outside_the_prior_the_density_is_zero():
    target = fit_target(quick_fits.plain(), Prior(eccentricity_mm=0.1))
    outside = target.centre.copy()
    outside[target.names.index("driving_x")] = 0.2
    assert target.value_and_gradient(outside)[0] == -np.inf
