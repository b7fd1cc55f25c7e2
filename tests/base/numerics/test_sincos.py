from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import mpmath
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vttig_jax.base.numerics import sincos as module
from vttig_jax.base.numerics.sincos import sincos

BOUND = 5e-16
# Jitted, XLA may fuse products and sums; op by op it cannot. Both must hold the bounds.
jitted = jax.jit(sincos)
BOTH = pytest.mark.parametrize("function", [sincos, jitted], ids=["eager", "jit"])
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


def test_float64_is_within_the_bound():
    for function in (sincos, jitted):
        for grid in GRIDS:
            assert worst_error(function, GRIDS[grid]) <= BOUND


@pytest.mark.slow
def test_float32_is_within_the_bound():
    for function in (sincos, jitted):
        for grid in GRIDS:
            x = GRIDS[grid].astype(np.float32)
            assert sincos(x)[0].dtype == np.float32
            assert worst_error(function, x) <= BOUND_FLOAT32


@given(st.lists(st.floats(-RANGE, RANGE), min_size=20, max_size=20))
def test_any_float64_is_within_the_bound(values):
    assert worst_error(sincos, np.array(values)) <= BOUND


def test_the_error_helper_sees_a_plain_reduction():
    # Negative control: π/2 as one number is what the parts are there to avoid.
    def naive(x):
        r = x - np.round(x / (2 * np.pi)) * (2 * np.pi)
        return np.sin(r), np.cos(r)

    assert worst_error(naive, GRIDS["dense"]) > BOUND


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


def test_tiny_angles_are_their_own_sine():
    x = np.array([0.0, 1e-200, -1e-9])
    sine, cosine = (np.asarray(value) for value in jitted(x))
    np.testing.assert_array_equal(sine, x)
    np.testing.assert_array_equal(cosine, 1.0)


@pytest.mark.parametrize("x", [np.inf, -np.inf, np.nan])
def test_no_angle_is_nan(x):
    assert all(np.isnan(value) for value in sincos(x))
    assert np.isnan(jax.grad(lambda a: sincos(a)[0])(x))


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


def test_vmap_is_the_loop():
    x = jnp.linspace(-50.0, 50.0, 12).reshape(3, 4)
    looped = np.stack([np.stack(jitted(row)) for row in x], axis=1)
    np.testing.assert_allclose(np.stack(jax.vmap(jitted)(x)), looped, atol=2e-16, rtol=0)


def test_integers_become_floats_and_other_types_are_refused():
    sine, cosine = sincos(3)
    assert sine.dtype == np.float64
    assert sine == pytest.approx(np.sin(3.0), abs=BOUND)
    assert cosine == pytest.approx(np.cos(3.0), abs=BOUND)
    with pytest.raises(ValueError, match=r"Argument `x` must be float32.*float16"):
        sincos(np.float16(1.0))


def test_every_operation_fits_a_vector_lane():
    # A gather, an integer modulo or a library call would end XLA's vector loop.
    allowed = {
        "mul",
        "add",
        "sub",
        "neg",
        "round",
        "floor",
        "eq",
        "ge",
        "lt",
        "or",
        "abs",
        "select_n",
    }
    allowed |= {"broadcast_in_dim", "convert_element_type", "jit", "pjit", "custom_jvp_call"}
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


@pytest.mark.parametrize(("dtype", "terms"), [("float64", 6), ("float32", 3)])
def test_the_coefficients_follow_from_their_description(dtype, terms):
    with mpmath.workdps(60):
        width = (mpmath.pi / 4) ** 2
        angles = [(2 * i + 1) * mpmath.pi / (2 * terms) for i in range(terms)]
        nodes = [width / 2 * (1 - mpmath.cos(angle)) for angle in angles]
        powers = mpmath.matrix([[t**j for j in range(terms)] for t in nodes])

        def interpolated(sign: int, first: int) -> list[float]:
            values = [
                sign * sum((-t) ** j / mpmath.factorial(first + 2 * j) for j in range(25))
                for t in nodes
            ]
            return [float(c) for c in mpmath.lu_solve(powers, mpmath.matrix(values))]

        constants = module._CONSTANTS[dtype]
        np.testing.assert_allclose(constants.sine, interpolated(-1, 3), rtol=1e-15)
        np.testing.assert_allclose(constants.cosine, interpolated(1, 4), rtol=1e-15)
        # What the parts leave of π/2 counts k < 2¹⁶ times; k times each but the last is exact.
        left_over = abs(sum(map(mpmath.mpf, constants.half_pi)) - mpmath.pi / 2)
        assert left_over * 2**16 < float(np.finfo(dtype).eps) / 16
        mantissa = np.finfo(dtype).nmant + 1
        for part in constants.half_pi[:-1]:
            bits = int(mpmath.mpf(part).man).bit_length()
            assert bits + 16 <= mantissa
