"""Quadratic forms of a filter and of columns beside dense covariance matrices."""

import jax
import numpy as np
import pytest

from tests.oracles.stationary_noise import covariance
from vttig_jax.base.numerics.partial_autocorrelation import filter_of
from vttig_jax.identify.compress.lagged_forms import filter_form, whitened_products

WIDTH, LAGS = 3, 3
LENGTHS = (9, 14)


def products() -> tuple[list[np.ndarray], np.ndarray, np.ndarray]:
    """Two runs, their lag products, and the rows next to their ends."""
    generator = np.random.default_rng(4)
    runs = [generator.normal(size=(count, WIDTH)) for count in LENGTHS]
    lagged = sum(
        np.stack([run[lag:].T @ run[: len(run) - lag] for lag in range(LAGS + 1)]) for run in runs
    )
    ends = [end for run in runs for end in (run[:LAGS], run[::-1][:LAGS])]
    return runs, np.asarray(lagged), np.stack(ends)


def dense(runs: list[np.ndarray], filter_: np.ndarray) -> np.ndarray:
    """Uᵀ Σ⁻¹ U with the dense covariance of each run."""
    parts = [run.T @ np.linalg.solve(covariance(filter_, len(run)), run) for run in runs]
    return np.sum(parts, axis=0)


@pytest.mark.parametrize("partial", [[], [0.6], [0.6, -0.3], [0.6, -0.3, 0.2]])
def test_whitened_products_are_those_of_the_dense_covariance(partial):
    runs, lagged, ends = products()
    filter_ = filter_of(np.array(partial))
    taps = len(filter_)
    found = whitened_products(lagged[:taps], ends[:, : taps - 1], filter_)
    np.testing.assert_allclose(found, dense(runs, filter_), rtol=1e-11, atol=1e-11)


@pytest.mark.parametrize("partial", [[0.0, 0.0, 0.0], [0.5, -0.4, 0.3], [-0.9, 0.1, 0.0]])
def test_the_form_of_the_filter_is_that_of_the_columns(partial):
    runs, lagged, ends = products()
    weights = np.random.default_rng(5).normal(size=(WIDTH, 2))
    filter_ = filter_of(np.array(partial))
    for form in (
        filter_form(lagged, ends, weights),
        np.asarray(jax.jit(filter_form)(lagged, ends, weights)),
    ):
        expected = np.trace(weights.T @ dense(runs, filter_) @ weights)
        assert filter_ @ form @ filter_ == pytest.approx(expected, rel=1e-11)


def test_without_the_ends_the_form_is_another():
    runs, lagged, ends = products()
    filter_, weights = filter_of(np.array([0.5, -0.4, 0.3])), np.eye(WIDTH)
    wrong = filter_ @ filter_form(lagged, 0 * ends, weights) @ filter_
    assert wrong > 1.01 * np.trace(dense(runs, filter_))
