from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import mpmath
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vttig_jax.base.numerics.sincos import sincos

BOUND = 5e-16
# Jitted, XLA may fuse products and sums; op by op it cannot. Both must hold the bounds.
jitted = jax.jit(sincos)
BOUND_FLOAT32 = 1.5e-7
RANGE = 1e5


def worst_error(function: Callable[[Any], tuple[Any, Any]], x: np.ndarray) -> float:
    """Largest absolute error of (sin, cos) against 140 bits, at the numbers as stored."""
    sine, cosine = (np.asarray(value, np.float64) for value in function(x))
    with mpmath.workprec(140):
        errors = [
            max(abs(s - mpmath.sin(a)), abs(c - mpmath.cos(a)))
            for a, s, c in zip(x.astype(np.float64).tolist(), sine, cosine, strict=True)
        ]
        return float(max(errors))


def near_quadrants() -> np.ndarray:
    """Multiples of π/4 and their neighbours, where reduction cancels or switches quadrant."""
    k = np.random.default_rng(0).integers(-127_000, 127_000, 700)
    points = np.concatenate([k, np.arange(-16, 17)]) * (np.pi / 4)
    return np.concatenate([points, np.nextafter(points, np.inf), np.nextafter(points, -np.inf)])


GRIDS = {
    "dense": np.linspace(-RANGE, RANGE, 4001),
    "first turn": np.linspace(-7.0, 7.0, 1001),
    "quadrants": near_quadrants(),
}


@pytest.mark.parametrize(
    ("dtype", "bound"), [("f8", BOUND), pytest.param("f4", BOUND_FLOAT32, marks=pytest.mark.slow)]
)
def test_the_error_is_within_the_bound(dtype, bound):
    for function in (sincos, jitted):
        for grid in GRIDS.values():
            x = grid.astype(dtype)
            assert sincos(x)[0].dtype == dtype
            assert worst_error(function, x) <= bound


@given(st.lists(st.floats(-RANGE, RANGE), min_size=20, max_size=20))
def test_any_float64_is_within_the_bound(values):
    assert worst_error(sincos, np.array(values)) <= BOUND


def test_beyond_the_range_the_error_is_that_of_a_rounded_angle():
    for function in (sincos, jitted):
        for dtype, size in (("f8", 1e6), ("f8", 4e15), ("f4", 1e6), ("f4", 8e6)):
            x = np.random.default_rng(1).uniform(size / 2, size, 200).astype(dtype)
            assert worst_error(function, x) <= np.finfo(dtype).eps * size


@pytest.mark.parametrize("dtype", ["f8", "f4"])
def test_where_numbers_lie_a_radian_apart_there_is_no_answer(dtype):
    limit = 1 / np.finfo(dtype).eps
    x = np.array([limit, -limit, 1e30], dtype)
    assert np.isnan(np.stack(jitted(x))).all()
    assert np.isfinite(np.stack(jitted(np.nextafter(x[:2], x.dtype.type(0))))).all()


def test_tiny_angles_are_their_own_sine_and_no_angle_is_nan():
    x = np.array([0.0, 1e-200, -1e-9])
    sine, cosine = (np.asarray(value) for value in jitted(x))
    np.testing.assert_array_equal(sine, x)
    np.testing.assert_array_equal(cosine, 1.0)
    for none in (np.inf, -np.inf, np.nan):
        assert all(np.isnan(value) for value in sincos(none))
        assert np.isnan(jax.grad(lambda a: sincos(a)[0])(none))


def test_the_derivative_is_exactly_the_other_function():
    x = jnp.asarray(GRIDS["quadrants"])
    (sine, cosine), (d_sine, d_cosine) = jax.jvp(sincos, (x,), (jnp.ones_like(x),))
    np.testing.assert_array_equal(d_sine, cosine)
    np.testing.assert_array_equal(d_cosine, -sine)


def test_gradients_of_both_kinds_and_the_second():
    for x in (0.3, np.pi / 4, -2.0, 1234.5):
        sine, cosine = jitted(x)
        assert jax.jit(jax.grad(lambda a: sincos(a)[0]))(x) == cosine
        assert jax.jit(jax.jacfwd(lambda a: sincos(a)[1]))(x) == -sine
        second = jax.jit(jax.grad(jax.grad(lambda a: sincos(a)[0])))(x)
        assert float(second) == pytest.approx(-float(sine), abs=1e-15)


def test_integers_become_floats_and_other_types_are_refused():
    sine, cosine = sincos(3)
    assert sine.dtype == np.float64
    np.testing.assert_allclose((sine, cosine), (np.sin(3.0), np.cos(3.0)), rtol=0, atol=BOUND)
    with pytest.raises(ValueError, match=r"Argument `x` must be float32.*float16"):
        sincos(np.float16(1.0))


def test_every_operation_fits_a_vector_lane():
    # A gather, an integer modulo or a library call would end XLA's vector loop.
    allowed = {"mul", "add", "sub", "neg", "round", "floor", "eq", "ge", "lt", "or", "abs"}
    allowed |= {"select_n", "broadcast_in_dim", "convert_element_type", "jit", "pjit"}
    allowed |= {"custom_jvp_call"}
    assert primitives(jax.make_jaxpr(sincos)(jnp.ones(8)).jaxpr) <= allowed
    assert "sin" in primitives(jax.make_jaxpr(jax.jit(jnp.sin))(jnp.ones(8)).jaxpr)


def primitives(jaxpr: Any) -> set[str]:
    """Names of all primitives, those of inner functions too."""
    names = set()
    for equation in jaxpr.eqns:
        names.add(equation.primitive.name)
        for parameter in equation.params.values():
            inner = getattr(parameter, "jaxpr", None)
            if inner is not None:
                names |= primitives(inner)
    return names
