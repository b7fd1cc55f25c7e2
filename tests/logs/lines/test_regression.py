"""Least squares of line columns: products of the columns while these are independent, else QR."""

import numpy as np
import pytest

from vttig_jax.logs.lines.rows import fitted


@pytest.mark.parametrize("apart", [1.0, 1e-2, 1e-5, 1e-9])
def test_coefficients_are_those_of_lstsq_for_columns_that_are_nearly_parallel(apart):
    rng = np.random.default_rng(3)
    columns = rng.normal(size=(400, 5)) * 10.0 ** np.arange(-2, 3)
    columns[:, 4] = columns[:, 0] + apart * columns[:, 4] / 1e4
    value = columns @ np.arange(1.0, 6.0) + rng.normal(size=400)
    found, covariance = fitted(columns, value)
    wanted = np.linalg.lstsq(columns, value, rcond=None)[0]
    std = np.sqrt(np.diag(np.linalg.inv(columns.T @ columns)))
    if apart >= 1e-5:
        np.testing.assert_allclose(np.sqrt(np.diag(covariance)), std, rtol=1e-5)
        np.testing.assert_allclose(found, wanted, atol=1e-5 * std.min())
    left = np.sum((value - columns @ found) ** 2)
    np.testing.assert_allclose(left, np.sum((value - columns @ wanted) ** 2), rtol=1e-9)


def test_columns_that_are_the_same_share_the_fit_of_one():
    one = np.random.default_rng(4).normal(size=(50, 1))
    found, _ = fitted(np.hstack([one, one]), one[:, 0])
    np.testing.assert_allclose(found.sum(), 1.0, rtol=1e-12)
