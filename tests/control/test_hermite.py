"""The cubic of one step against polynomials and NumPy's roots."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vttig_jax.control.hermite import Cubic, cubic, first_root

NUMBER = st.integers(-192, 192).map(lambda n: n / 64)
root_of = jax.jit(first_root)
root_and_slopes = jax.jit(jax.value_and_grad(first_root))


@given(st.lists(NUMBER, min_size=4, max_size=4), st.floats(0.01, 2.0))
def test_cubics_are_reproduced(coefficients, step):
    truth = np.polynomial.Polynomial(coefficients)
    rates = truth.deriv()
    values = (jnp.asarray(one(at)) for one in (truth, rates) for at in (0.0, step))
    start, end, first, last = values
    curve = cubic(start, end, first, last, step)
    for share in (0.0, 0.2, 0.5, 1.0):
        assert float(curve.at(jnp.asarray(share))) == pytest.approx(truth(share * step), abs=1e-10)
        slope = float(curve.slope(jnp.asarray(share))) / step
        assert slope == pytest.approx(rates(share * step), abs=1e-9)


SHARE = st.integers(-64, 64).map(lambda n: n / 64)


@given(st.floats(1e-6, 1.0), st.floats(1e-6, 1.0), SHARE, SHARE)
def test_the_root_of_a_curve_that_falls_is_found(above, below, bend, jerk):
    """Bent by less than it falls, as within a short step."""
    fall, bend, jerk = above + below, 0.3 * bend, 0.1 * jerk
    curve = Cubic(*map(jnp.asarray, (above, -fall * (1 + bend + jerk), fall * bend, fall * jerk)))
    found = np.polynomial.Polynomial([float(c) for c in jax.tree.leaves(curve)]).roots()
    real = found[np.abs(found.imag) < 1e-12].real
    (expected,) = real[(real >= 0) & (real <= 1)]
    assert float(root_of(curve)) == pytest.approx(expected, abs=1e-12)


@given(st.lists(NUMBER, min_size=4, max_size=4))
def test_any_curve_gives_a_share_and_a_finite_gradient(coefficients):
    curve = Cubic(*map(jnp.asarray, coefficients))
    value, slopes = root_and_slopes(curve)
    assert 0 <= value <= 1
    assert np.all(np.isfinite(jax.tree.leaves(slopes)))


def test_the_root_moves_with_the_curve():
    """dτ/dc₀ = −1/slope at the root."""
    curve = Cubic(*map(jnp.asarray, (0.4, -0.9, -0.1, 0.05)))
    at, slopes = root_and_slopes(curve)
    assert float(slopes.c0) == pytest.approx(-1 / float(curve.slope(at)), rel=1e-12)
    assert float(slopes.c1) == pytest.approx(-float(at) / float(curve.slope(at)), rel=1e-12)
