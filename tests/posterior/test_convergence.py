"""Autocorrelation time, R-hat, and the diagnosis of both."""

import json

import numpy as np
import pytest
from emcee.autocorr import integrated_time
from hypothesis import given
from hypothesis import strategies as st

from tests.posterior.densities import ar1
from vttig_jax.base.files.json_io import dumps
from vttig_jax.posterior import Until, autocorrelation_time, r_hat
from vttig_jax.posterior.convergence import BURN_IN, Diagnosis, diagnose


@pytest.mark.parametrize("rho", [0.0, 0.5, 0.9, 0.98])
def test_the_time_of_an_ar1_is_known_and_that_of_emcee(rho):
    draws = ar1(rho, (20_000, 64, 2), seed=1)
    found = autocorrelation_time(draws)
    np.testing.assert_allclose(found, (1 + rho) / (1 - rho), rtol=0.05)
    if rho < 0.95:
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


pytestmark = pytest.mark.smoke


def ensembles(rho: float, steps: int = 500, walkers: int = 16, seed: int = 1) -> np.ndarray:
    """Four ensembles that agree, of AR(1) chains."""
    return np.moveaxis(ar1(rho, (steps, 4, walkers, 1), seed), 0, 1)


def test_it_is_that_of_arviz():
    arviz = pytest.importorskip("arviz")
    normal = np.random.default_rng(7).standard_normal((4, 50, 8, 1))
    one = np.array([1.0, 0.0, 0.0, 0.0])[:, None, None, None]
    cauchy = np.random.default_rng(7).standard_cauchy(normal.shape)
    for draws in (normal, cauchy, normal + 0.5 * one, normal * (1 + 2 * one), np.round(normal)):
        flattened = draws.reshape(len(draws), -1)  # one chain an ensemble, as arviz counts them
        expected = arviz.rhat(flattened, method="rank")
        np.testing.assert_allclose(r_hat(draws), float(expected), rtol=1e-12)


def test_each_coordinate_has_its_own_and_drifts_and_widths_are_seen():
    drifting = ensembles(0.9, 1500) + np.linspace(0, 1.5, 1500)[:, None, None]
    assert r_hat(drifting)[0] > 1.01
    mixed = np.concatenate([drifting[:, ::2], drifting[:, 1::2]], axis=1)
    assert r_hat(mixed)[0] < 1.01  # not seen unless halves in time are compared
    wide = ensembles(0.9, 1500)
    wide[0] *= 2.0
    assert r_hat(wide)[0] > 1.01
    draws = np.concatenate([ensembles(0.9, 1500, seed=seed) for seed in (1, 2, 3)], axis=3)
    draws[0, :, :, 1] += 2.0
    draws[2:, :, :, 2] += 6.0  # two modes; each ensemble sees one
    found = r_hat(draws)
    assert 0.999 < found[0] < 1.005 < 1.1 < found[1] and found[2] > 1.5


def test_constants_agree_or_do_not_and_a_middle_step_left_over_is_dropped():
    same = np.zeros((4, 10, 4, 1))
    assert r_hat(same).tolist() == [1.0]
    assert r_hat(same + np.arange(4.0)[:, None, None, None]).tolist() == [np.inf]
    draws = np.random.default_rng(3).standard_normal((4, 11, 4, 1))
    changed = draws.copy()
    changed[:, 5] = 1e6
    np.testing.assert_array_equal(r_hat(draws), r_hat(changed))


def made(effective: float = 1200.0, r_hat: float = 1.0021) -> Diagnosis:
    tau, both = np.array([10.0, 5.0]), np.array([effective, 2 * effective])
    return Diagnosis(("a", "b"), tau, np.array([1.0, r_hat]), both, 0.412, 1000, Until())


def judged(draws: np.ndarray) -> Diagnosis:
    return diagnose(draws, ("a",), steps=draws.shape[1] * 5, acceptance=0.4, until=Until())


def test_what_is_not_enough_is_named_with_the_steps_that_cure():
    assert made().converged and made().warning == ""
    few, apart = made(effective=400.0), made(r_hat=1.25)
    assert few.agreed and not few.long_enough and "`a`" in str(few) and "2500" in few.warning
    assert apart.long_enough and not apart.agreed and "`b`" in str(apart)
    assert "2000" in apart.warning and not (few.converged or apart.converged)
    # What fails by a hair does not read as passed.
    assert "1.011" in str(made(r_hat=1.01001)) and "∞" in str(made(r_hat=np.inf))
    found = json.loads(dumps(made(r_hat=np.inf).to_json()))
    assert found["converged"] is False
    assert found["autocorrelation_steps"] == {"a": 10.0, "b": 5.0}
    assert found["r_hat"] == {"a": 1.0, "b": None}
    assert found["asked"] == {"effective_draws": 1000.0, "r_hat": 1.01}


@pytest.mark.parametrize("steps", [700, 3000])
def test_time_and_effective_draws_are_in_steps_of_the_sampler(steps):
    rho, thin = 0.9, 5  # of the stored steps
    found = judged(ensembles(rho, steps, walkers=8))
    assert found.tau[0] == pytest.approx(thin * (1 + rho) / (1 - rho), rel=0.3)  # of every third
    whole = 4 * 8 * (1 - BURN_IN) * steps * thin
    assert found.effective[0] == pytest.approx(whole / found.tau[0], rel=1e-2)


def test_the_burn_in_is_left_out_and_draws_are_not_counted_twice():
    draws = ensembles(0.5)
    draws[:, :100] += 100.0
    assert judged(draws).converged
    draws[:, 100:160] += 100.0  # negative control: after it
    assert not judged(draws).converged
    found = judged(ensembles(-0.5))  # antithetic: τ below one stored step
    assert found.tau[0] == 5.0 and found.effective[0] == 4 * 16 * 400


def test_half_stuck_ensembles_and_islands_in_every_ensemble_have_not_converged():
    stuck, islands = ensembles(0.5), ensembles(0.5)
    stuck[:2] += 8.0
    islands[:, :, ::2] += 8.0  # R-hat is content, τ is not
    assert (judged(stuck).long_enough, judged(stuck).agreed) == (True, False)
    assert (judged(islands).long_enough, judged(islands).agreed) == (False, True)
