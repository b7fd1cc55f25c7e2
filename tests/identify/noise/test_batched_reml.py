"""The batched estimate of the noise beside that of single fits."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import brentq

from benchmarks.compiler import fast_to_compile
from vttig_jax.base.numerics.partial_autocorrelation import filter_of
from vttig_jax.identify.compress.row_products import (
    conditioned,
    inner,
    row_products,
    upper_and_inverse,
)
from vttig_jax.identify.noise.batched_reml import estimated_noise, needed_lags
from vttig_jax.identify.noise.restricted_likelihood import LARGEST, best_partial

WIDTH, LAGS = 4, 4


@jax.jit
def _summed(rows, counts):
    return row_products(*conditioned(rows), counts, LAGS)


def summed(rows: np.ndarray, counts: list[list[int]]):
    """The products of rows whose runs have these counts."""
    return _summed(rows, np.array(counts))


_lowest = jax.jit(best_partial)
_needed = jax.jit(needed_lags)


def drawn(count: int, seed: int = 0) -> np.ndarray:
    """Rows of one run on one flank: white columns, and y with AR(1) noise."""
    generator = np.random.default_rng(seed)
    rows, noise = generator.normal(size=(count, WIDTH)), 0.0
    for t in range(count):
        noise = 0.6 * noise + generator.normal()
        rows[t, -1] = noise
    return rows[None, None]


@pytest.mark.parametrize("slope", [-1e3, -0.3, 1e-9, 2.0, 1e6])
@pytest.mark.parametrize("curvature", [-1e-9, 0.0, 1e-9, 1e-3, 1.0, 1e8])
def test_lowest_point_of_the_bound(curvature, slope):
    cubic = lambda p: (max(curvature, 0.0) * p + slope) * (1 - p**2) + 4 * p  # noqa: E731
    root: Any = brentq(cubic, -1.0, 1.0, xtol=1e-15)
    expected = np.clip(root, -LARGEST, LARGEST)
    values = [np.asarray(x) for x in (float(curvature), float(slope), 4.0)]
    assert float(_lowest(*values)) == pytest.approx(expected, abs=1e-10)
    assert float(best_partial(*values)) == pytest.approx(expected, abs=1e-10)
    assert best_partial(curvature + 0.0, slope, 4) == pytest.approx(expected, abs=1e-10)


def test_the_factor_is_that_of_the_dense_covariance():
    count, partial = 40, np.array([0.7, -0.3, 0.0, 0.0])
    rows = drawn(count)
    products = summed(rows, [[count]])
    taps = np.asarray(jax.jit(filter_of)(partial))
    factor = np.asarray(jax.jit(inner)(products, taps).triangle) @ np.asarray(products.triangle)
    # The autocovariance of the autoregression from its impulse response.
    response = np.zeros(4000)
    for t in range(len(response)):
        past = sum(-taps[k] * response[t - k] for k in range(1, 3) if t >= k)
        response[t] = past + (t == 0)
    covariance = [response[lag:] @ response[: len(response) - lag] for lag in range(count)]
    dense = np.array(covariance)[np.abs(np.subtract.outer(np.arange(count), np.arange(count)))]
    expected = rows[0, 0].T @ np.linalg.solve(dense, rows[0, 0])
    np.testing.assert_allclose(factor[0].T @ factor[0], expected, rtol=1e-9, atol=1e-9)


def test_rows_of_zeros_behind_a_run_change_nothing():
    short, long = drawn(120), np.zeros((1, 2, 150, WIDTH))
    long[:, 0, :120] = short[:, 0]
    one, two = summed(short, [[120]]), summed(long, [[120, 0]])
    np.testing.assert_allclose(one.lag_products, two.lag_products, atol=1e-12)
    estimated = jax.jit(
        lambda p: estimated_noise(p, jnp.asarray(LAGS), jnp.asarray(1e-12)), **fast_to_compile()
    )
    noise = [estimated(products) for products in (one, two)]
    np.testing.assert_allclose(noise[0].partial, noise[1].partial, atol=1e-9)
    assert noise[0].order == 1
    assert noise[0].partial[0] == pytest.approx(0.6, abs=0.2)


def test_derivatives_of_the_factor_are_those_of_differences():
    gram = drawn(60)[0, 0].T @ drawn(60)[0, 0]
    turn = np.diag([1.0, 2.0, -1.0, 0.5]) + 0.1

    @jax.jit
    def both(step):
        upper = upper_and_inverse(gram + step * turn)
        return jnp.stack([upper.triangle, upper.inverse])

    exact = jax.jit(jax.jacfwd(both))(0.0)
    errors = [
        np.abs((both(h) - both(-h)) / (2 * h) - exact).max() / np.abs(exact).max()
        for h in (1e-2, 1e-3)
    ]
    assert errors[0] < 1e-5 and errors[1] < 1e-7
    assert np.abs(np.matmul(*np.asarray(both(0.0))) - np.eye(WIDTH)).max() < 1e-12


@pytest.mark.parametrize(("correlation", "order"), [(0.0, 0), (0.8, 1)])
def test_needed_lags_follow_the_order_of_the_residual(correlation, order):
    covariance, rows = np.array([correlation ** np.arange(17)]), np.array([1000.0])
    assert int(_needed(covariance, rows, np.asarray(16))) == order + 2
    assert int(_needed(covariance, rows, np.asarray(1))) == 1
