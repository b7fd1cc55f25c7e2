import numpy as np
import pytest

from tests.posterior.densities import ar1
from vttig_jax.posterior.convergence import r_hat

pytestmark = pytest.mark.smoke


def ensembles(seed: int = 1, steps: int = 1500, rho: float = 0.9) -> np.ndarray:
    """Four ensembles of 16 walkers that agree; their chains are 50 … 80 τ long."""
    return np.moveaxis(ar1(rho, (steps, 4, 16, 1), seed), 0, 1)


def flattened(draws: np.ndarray) -> np.ndarray:
    """One chain an ensemble, as arviz counts them."""
    return draws.reshape(len(draws), -1)


def test_it_is_that_of_arviz():
    for kind in ("normal", "cauchy", "shifted", "scaled", "ties"):
        arviz = pytest.importorskip("arviz")
        generator = np.random.default_rng(7)
        draws = generator.standard_normal((4, 50, 8, 1))
        if kind == "cauchy":
            draws = generator.standard_cauchy(draws.shape)
        elif kind == "shifted":
            draws[0] += 0.5
        elif kind == "scaled":
            draws[0] *= 3.0
        elif kind == "ties":
            draws = np.round(draws)
        expected = arviz.rhat(flattened(draws), method="rank")
        np.testing.assert_allclose(r_hat(draws), float(expected), rtol=1e-12)


def test_ensembles_that_agree_pass():
    for seed in range(5):
        assert 0.999 < r_hat(ensembles(seed))[0] < 1.005


def test_a_stuck_ensemble_fails_between_ensembles_and_passes_between_its_walkers():
    draws = ensembles(steps=8000)
    draws[2:] += 6.0  # two modes; each ensemble sees one
    assert r_hat(draws)[0] > 1.5
    for ensemble in draws:  # negative control: walkers as chains see nothing
        assert r_hat(np.moveaxis(ensemble, 1, 0)[:, :, None])[0] < 1.01


def test_a_drift_of_all_ensembles_together_fails():
    draws = ensembles()
    drifting = draws + np.linspace(0, 1.5, draws.shape[1])[:, None, None]
    assert r_hat(drifting)[0] > 1.01
    backwards = np.concatenate([drifting[:, ::2], drifting[:, 1::2]], axis=1)
    assert r_hat(backwards)[0] < 1.01  # not seen unless halves in time are compared


def test_an_ensemble_of_another_width_fails_by_the_folded_part():
    draws = ensembles()
    draws[0] *= 2.0
    assert r_hat(draws)[0] > 1.01


def test_each_coordinate_has_its_own():
    draws = np.concatenate([ensembles(1), ensembles(2)], axis=3)
    draws[0, :, :, 1] += 2.0
    first, second = r_hat(draws)
    assert first < 1.005 < 1.1 < second


def test_constants_agree_or_do_not():
    same = np.zeros((4, 10, 4, 1))
    apart = same + np.arange(4.0)[:, None, None, None]
    assert r_hat(same).tolist() == [1.0]
    assert r_hat(apart).tolist() == [np.inf]


def test_a_middle_step_left_over_is_dropped():
    draws = np.random.default_rng(3).standard_normal((4, 11, 4, 1))
    changed = draws.copy()
    changed[:, 5] = 1e6
    np.testing.assert_array_equal(r_hat(draws), r_hat(changed))
