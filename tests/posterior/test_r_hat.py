import numpy as np
import pytest

from tests.posterior.densities import ar1
from vttig_jax.posterior.convergence import r_hat

pytestmark = pytest.mark.smoke


def ensembles(seed: int = 1) -> np.ndarray:
    """Four ensembles of 16 walkers that agree; their chains are 50 … 80 τ long."""
    return np.moveaxis(ar1(0.9, (1500, 4, 16, 1), seed), 0, 1)


def test_it_is_that_of_arviz():
    arviz = pytest.importorskip("arviz")
    normal = np.random.default_rng(7).standard_normal((4, 50, 8, 1))
    one = np.array([1.0, 0.0, 0.0, 0.0])[:, None, None, None]
    cauchy = np.random.default_rng(7).standard_cauchy(normal.shape)
    for draws in (normal, cauchy, normal + 0.5 * one, normal * (1 + 2 * one), np.round(normal)):
        flattened = draws.reshape(len(draws), -1)  # one chain an ensemble, as arviz counts them
        expected = arviz.rhat(flattened, method="rank")
        np.testing.assert_allclose(r_hat(draws), float(expected), rtol=1e-12)


def test_a_drift_of_all_and_another_width_of_one_are_seen():
    drifting = ensembles() + np.linspace(0, 1.5, 1500)[:, None, None]
    assert r_hat(drifting)[0] > 1.01
    mixed = np.concatenate([drifting[:, ::2], drifting[:, 1::2]], axis=1)
    assert r_hat(mixed)[0] < 1.01  # not seen unless halves in time are compared
    wide = ensembles()
    wide[0] *= 2.0
    assert r_hat(wide)[0] > 1.01


def test_each_coordinate_has_its_own():
    draws = np.concatenate([ensembles(1), ensembles(2), ensembles(3)], axis=3)
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
