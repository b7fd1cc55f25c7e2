import numpy as np
import pytest
from emcee.autocorr import integrated_time
from hypothesis import given
from hypothesis import strategies as st

from tests.posterior.densities import ar1
from vttig_jax.posterior.convergence import autocorrelation_time


@pytest.mark.parametrize("rho", [0.0, 0.5, 0.9, 0.98])
def test_the_time_of_an_ar1_is_known_and_that_of_emcee(rho):
    draws = ar1(rho, (20_000, 64, 2), seed=1)
    found = autocorrelation_time(draws)
    np.testing.assert_allclose(found, (1 + rho) / (1 - rho), rtol=0.05)
    np.testing.assert_allclose(found, integrated_time(draws, tol=0), rtol=0.03)


@pytest.mark.parametrize(("walkers", "least"), [(32, 500), (8, 400)])
def test_walkers_that_never_meet_are_seen_where_emcee_sees_none(walkers, least):
    draws = ar1(0.5, (2000, 64, 1), seed=3)
    draws[:, :walkers] += 20.0  # two islands, no walker ever crosses
    assert autocorrelation_time(draws)[0] > least
    assert integrated_time(draws, tol=0)[0] < 4  # about the mean of each walker: blind


def test_a_coordinate_that_does_not_move_has_the_length_of_the_chain():
    draws = ar1(0.5, (300, 8, 2), seed=4)
    draws[:, :, 1] = 0.1
    found = autocorrelation_time(draws)
    assert found[0] < 5 and found[1] >= 150
    assert autocorrelation_time(np.zeros((300, 8, 1))).tolist() == [300.0]


@given(shift=st.floats(-1e3, 1e3), scale=st.floats(1e-6, 1e6))
def test_unit_and_zero_do_not_matter(shift, scale):
    draws = ar1(0.8, (500, 8, 1), seed=5)
    np.testing.assert_allclose(
        autocorrelation_time(shift * scale + scale * draws), autocorrelation_time(draws), rtol=1e-6
    )
