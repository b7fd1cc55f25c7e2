"""The whitening filter from partial autocorrelations, in NumPy and in compiled programs."""

import jax
import numpy as np
import pytest

from vttig_jax.base.numerics.partial_autocorrelation import filter_of, partial_of

pytestmark = pytest.mark.smoke


def drawn(order: int) -> np.ndarray:
    return np.tanh(np.random.default_rng(order).standard_normal(order))


@pytest.mark.parametrize("order", [0, 1, 3, 4, 16])
def test_a_compiled_program_has_the_filter_and_the_derivatives_of_numpy(order):
    """By the steps that are written out and by the loop. The filter is linear in every π_k."""
    partial = drawn(order)
    expected = filter_of(partial)
    assert expected.shape == (order + 1,)
    np.testing.assert_allclose(jax.jit(filter_of)(partial), expected, rtol=1e-12, atol=1e-12)
    found = np.asarray(jax.jit(jax.jacrev(filter_of))(partial))
    for k in range(order):
        at_one, at_zero = (np.where(np.arange(order) == k, end, partial) for end in (1.0, 0.0))
        slope = filter_of(at_one) - filter_of(at_zero)
        np.testing.assert_allclose(found[:, k], slope, rtol=1e-11, atol=1e-11)


@pytest.mark.parametrize("order", [4, 16])
def test_partial_autocorrelations_of_zero_leave_the_filter_of_the_lower_order(order):
    partial = drawn(order)
    partial[2:] = 0.0
    found = np.asarray(jax.jit(filter_of)(partial))
    np.testing.assert_allclose(found[:3], filter_of(partial[:2]), rtol=1e-12)
    assert not found[3:].any()


def test_the_partial_autocorrelations_come_back():
    partial = 0.5 * drawn(16)
    np.testing.assert_allclose(partial_of(filter_of(partial)), partial, rtol=1e-9)
