"""The whitening filter from an autocovariance."""

import numpy as np
import pytest
from scipy.linalg import solve_toeplitz
from scipy.signal import lfilter

from vttig_jax.base.numerics.autoregression import whitening_filter

pytestmark = pytest.mark.smoke


def _autocovariance(path: np.ndarray, lags: int) -> np.ndarray:
    count = len(path)
    return np.array([path[lag:] @ path[: count - lag] for lag in range(lags)]) / count


def test_an_exact_autocovariance_gives_back_its_filter():
    """Of ε_t = 0.9 ε_{t−1} − 0.3 ε_{t−2} + innovation; further orders add nothing."""
    response = np.asarray(lfilter([1.0], [1.0, -0.9, 0.3], np.eye(1, 400)[0]))
    exact = np.array([response[lag:] @ response[: 400 - lag] for lag in range(9)])
    np.testing.assert_allclose(whitening_filter(exact, 5000), [1.0, -0.9, 0.3], atol=1e-12)


def test_levinson_solves_the_normal_equations():
    path = np.asarray(
        lfilter([1.0], [1.0, -0.5, 0.2, -0.4], np.random.default_rng(0).standard_normal(20_000))
    )
    covariance = _autocovariance(path, 9)
    found = whitening_filter(covariance, len(path))
    order = len(found) - 1
    assert order >= 3
    expected = solve_toeplitz(covariance[:order], covariance[1 : order + 1])
    np.testing.assert_allclose(-found[1:], expected, atol=1e-12)


def test_white_noise_asks_for_no_order():
    """By a criterion that only weighs 2 an order, one series in six would ask for some."""
    orders = [
        len(whitening_filter(_autocovariance(path, 17), 600)) - 1
        for path in np.random.default_rng(1).standard_normal((60, 600))
    ]
    assert np.mean(np.array(orders) > 0) < 0.05


def test_more_rows_carry_a_weaker_correlation():
    weak = np.array([1.0, 0.15, 0.0225])
    assert [len(whitening_filter(weak, rows)) for rows in (50, 5000)] == [1, 2]
    np.testing.assert_array_equal(whitening_filter(np.zeros(5), 100), [1.0])


def test_the_filter_is_stationary():
    for path in np.random.default_rng(2).standard_normal((20, 60)).cumsum(axis=1):
        roots = np.roots(whitening_filter(_autocovariance(path, 17), 60))
        assert np.all(np.abs(roots) < 1)
