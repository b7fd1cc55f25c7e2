import json

import numpy as np
import pytest

from tests.posterior.densities import ar1
from vttig_jax.base.files.json_io import dumps
from vttig_jax.posterior.convergence import BURN_IN, Diagnosis, diagnose
from vttig_jax.posterior.until import Until


def made(effective: float = 1200.0, r_hat: float = 1.0021) -> Diagnosis:
    tau, both = np.array([10.0, 5.0]), np.array([effective, 2 * effective])
    return Diagnosis(("a", "b"), tau, np.array([1.0, r_hat]), both, 0.412, 1000, Until())


def judged(draws: np.ndarray) -> Diagnosis:
    return diagnose(draws, ("a",), steps=draws.shape[1] * 5, acceptance=0.4, until=Until())


def ensembles(rho: float, steps: int = 500, walkers: int = 16) -> np.ndarray:
    return np.moveaxis(ar1(rho, (steps, 4, walkers, 1), seed=1), 0, 1)


def test_too_few_draws_and_ensembles_that_disagree_are_named_with_the_steps_that_cure():
    assert made().converged and made().warning == ""
    few, apart = made(effective=400.0), made(r_hat=1.25)
    assert few.agreed and not few.long_enough and "`a`" in str(few) and "2500" in few.warning
    assert apart.long_enough and not apart.agreed and "`b`" in str(apart)
    assert "2000" in apart.warning and not (few.converged or apart.converged)
    # What fails by a hair does not read as passed.
    assert "1.011" in str(made(r_hat=1.01001)) and "∞" in str(made(r_hat=np.inf))


def test_json_is_strict_and_by_name():
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


def test_the_burn_in_is_left_out():
    draws = ensembles(0.5)
    draws[:, :100] += 100.0
    assert judged(draws).converged
    draws[:, 100:160] += 100.0  # negative control: after it
    assert not judged(draws).converged


def test_independent_draws_are_not_counted_twice():
    found = judged(ensembles(-0.5))  # antithetic: τ below one stored step
    assert found.tau[0] == 5.0 and found.effective[0] == 4 * 16 * 400


def test_half_stuck_ensembles_and_islands_in_every_ensemble_have_not_converged():
    stuck, islands = ensembles(0.5), ensembles(0.5)
    stuck[:2] += 8.0
    islands[:, :, ::2] += 8.0  # R-hat is content, τ is not
    assert (judged(stuck).long_enough, judged(stuck).agreed) == (True, False)
    assert (judged(islands).long_enough, judged(islands).agreed) == (False, True)
