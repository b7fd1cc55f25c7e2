import json

import numpy as np
import pytest

from tests.posterior.densities import ar1
from vttig_jax.base.files.json_io import dumps
from vttig_jax.posterior.sampling.convergence import Diagnosis, diagnose
from vttig_jax.posterior.sampling.stop_rule import Until


def made(tau: float = 10.0, r_hat: float = 1.0021, steps: int = 1000) -> Diagnosis:
    return Diagnosis(
        names=("a", "b"),
        tau=np.array([tau, tau / 2]),
        shortest=0.75 * steps / tau,
        r_hat=np.array([1.0, r_hat]),
        acceptance=0.412,
        effective=np.array([100.0, 200.0]),
        steps=steps,
        until=Until(),
    )


def judged(draws: np.ndarray, thin: int = 5, until: Until | None = None) -> Diagnosis:
    return diagnose(
        draws,
        ("a",),
        thin=thin,
        steps=draws.shape[1] * thin,
        acceptance=0.4,
        until=until or Until(),
    )


def ensembles(rho: float, steps: int, walkers: int = 16) -> np.ndarray:
    return np.moveaxis(ar1(rho, (steps, 4, walkers, 1), seed=1), 0, 1)


def test_the_line_of_converged_chains():
    line = "converged: yes; shortest chain 75 τ; R-hat 1.003; acceptance 0.41"
    assert str(made()) == line  # rounded to the careful side


def test_the_line_of_short_chains_names_the_coordinate_and_the_cure():
    assert str(made(tau=60.0)) == (
        "converged: no; shortest chain 12 τ (`a`), 50 asked for; R-hat 1.003; acceptance 0.41;"
        " go on with --resume and about --steps 4000 or a longer --until"
    )


def test_the_line_of_ensembles_that_disagree_names_the_coordinate_and_the_cure():
    assert str(made(r_hat=1.25)) == (
        "converged: no; shortest chain 75 τ; R-hat 1.250 (`b`), at most 1.01 asked for; acceptance"
        " 0.41; the ensembles hold different parts of the posterior: go on with --resume and"
        " --steps 2000 or a longer --until"
    )


def test_a_warning_says_what_it_means_and_what_to_do():
    assert made().warning == ""
    for one, cure in ((made(tau=60.0), "--steps 4000"), (made(r_hat=1.25), "--steps 2000")):
        meaning, *_, last = one.warning.split("; ")
        assert meaning.startswith("not converged: ") and "intervals may be wrong" in meaning
        assert cure in last


def test_what_fails_by_a_hair_does_not_read_as_passed():
    assert "shortest chain 49 τ (`a`)" in str(made(tau=750 / 49.99))
    assert "R-hat 1.011 (`b`)" in str(made(r_hat=1.01001))
    assert "R-hat ∞ (`b`)" in str(made(r_hat=np.inf))


def test_json_is_strict_and_by_name():
    found = json.loads(dumps(made(r_hat=np.inf).to_json()))
    assert found["converged"] is False
    assert found["autocorrelation_steps"] == {"a": 10.0, "b": 5.0}
    assert found["r_hat"] == {"a": 1.0, "b": None}
    assert found["asked"] == {"autocorrelation_times": 50.0, "r_hat": 1.01}


@pytest.mark.parametrize("steps", [2000, 30_000])
def test_time_and_effective_draws_are_in_steps_of_the_sampler(steps):
    rho, thin = 0.9, 5  # of the stored steps
    found = judged(ensembles(rho, steps, walkers=4), thin)
    tau = thin * (1 + rho) / (1 - rho)
    assert found.tau[0] == pytest.approx(tau, rel=0.1)  # 30 000 are read at every sixth only
    assert found.shortest == pytest.approx(0.75 * steps * thin / tau, rel=0.1)
    assert found.effective[0] == pytest.approx(4 * 4 * found.shortest)
    assert found.converged


def test_the_burn_in_is_left_out():
    draws = ensembles(0.5, 2000)
    draws[:, :500] += 100.0
    assert judged(draws).converged
    draws[:, 500:800] += 100.0  # negative control: after it
    assert not judged(draws).converged


def test_independent_draws_are_not_counted_twice():
    found = judged(ensembles(-0.5, 1000))  # antithetic: τ below one stored step
    assert found.tau[0] == 5.0
    assert found.effective[0] == 4 * 16 * 750


def test_half_stuck_ensembles_have_not_converged():
    draws = ensembles(0.5, 2000)
    draws[:2] += 8.0
    found = judged(draws)
    assert found.long_enough and not found.agreed and not found.converged


def test_islands_in_every_ensemble_have_not_converged():
    # Each ensemble has half of its walkers on each island: R-hat is content, τ is not.
    draws = ensembles(0.5, 2000)
    draws[:, :, ::2] += 8.0
    found = judged(draws)
    assert found.agreed and not found.long_enough and not found.converged
