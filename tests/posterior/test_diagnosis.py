import json

import numpy as np
import pytest

from tests.posterior.densities import ar1
from vttig_jax.base.files.json_io import dumps
from vttig_jax.posterior.convergence import BURN_IN, Diagnosis, diagnose
from vttig_jax.posterior.until import Until


def made(effective: float = 1200.0, r_hat: float = 1.0021, steps: int = 1000) -> Diagnosis:
    return Diagnosis(
        names=("a", "b"),
        tau=np.array([10.0, 5.0]),
        r_hat=np.array([1.0, r_hat]),
        effective=np.array([effective, 2 * effective]),
        acceptance=0.412,
        steps=steps,
        until=Until(),
    )


def judged(draws: np.ndarray, thin: int = 5, until: Until | None = None) -> Diagnosis:
    return diagnose(
        draws, ("a",), steps=draws.shape[1] * thin, acceptance=0.4, until=until or Until()
    )


def ensembles(rho: float, steps: int, walkers: int = 16) -> np.ndarray:
    return np.moveaxis(ar1(rho, (steps, 4, walkers, 1), seed=1), 0, 1)


def test_too_few_draws_and_ensembles_that_disagree_are_named_with_the_steps_that_cure():
    assert made().converged and made().warning == ""
    few, apart = made(effective=400.0), made(r_hat=1.25)
    assert few.agreed and not few.long_enough and "`a`" in str(few) and "2500" in few.warning
    assert apart.long_enough and not apart.agreed and "`b`" in str(apart)
    assert "2000" in apart.warning and not (few.converged or apart.converged)


def test_what_fails_by_a_hair_does_not_read_as_passed():
    assert "1.011" in str(made(r_hat=1.01001))
    assert "∞" in str(made(r_hat=np.inf))


def test_json_is_strict_and_by_name():
    found = json.loads(dumps(made(r_hat=np.inf).to_json()))
    assert found["converged"] is False
    assert found["autocorrelation_steps"] == {"a": 10.0, "b": 5.0}
    assert found["r_hat"] == {"a": 1.0, "b": None}
    assert found["asked"] == {"effective_draws": 1000.0, "r_hat": 1.01}


@pytest.mark.parametrize("steps", [700, 3000])
def test_time_and_effective_draws_are_in_steps_of_the_sampler(steps):
    rho, thin = 0.9, 5  # of the stored steps
    found = judged(ensembles(rho, steps, walkers=8), thin)
    tau = thin * (1 + rho) / (1 - rho)
    assert found.tau[0] == pytest.approx(tau, rel=0.3)  # 3000 are read at every third
    assert found.effective[0] == pytest.approx(
        4 * 8 * (1 - BURN_IN) * steps * thin / found.tau[0], rel=1e-2
    )


def test_the_burn_in_is_left_out():
    draws = ensembles(0.5, 500)
    draws[:, :100] += 100.0
    assert judged(draws).converged
    draws[:, 100:160] += 100.0  # negative control: after it
    assert not judged(draws).converged


def test_independent_draws_are_not_counted_twice():
    found = judged(ensembles(-0.5, 500))  # antithetic: τ below one stored step
    assert found.tau[0] == 5.0
    assert found.effective[0] == 4 * 16 * 400


def test_half_stuck_ensembles_have_not_converged():
    draws = ensembles(0.5, 500)
    draws[:2] += 8.0
    found = judged(draws)
    assert found.long_enough and not found.agreed and not found.converged


def test_islands_in_every_ensemble_have_not_converged():
    # Each ensemble has half of its walkers on each island: R-hat is content, τ is not.
    draws = ensembles(0.5, 500)
    draws[:, :, ::2] += 8.0
    found = judged(draws)
    assert found.agreed and not found.long_enough and not found.converged
