"""Each check of the law table catches a function that is wrong in just that way."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.core import Tracer

from tests.laws import checks, table

pytestmark = pytest.mark.smoke

HERE = (np.array([0.3, -2.0, 1.7]), np.array(0.5))


def check_dimensions(function, arguments):
    """The result is a length as `gain` is."""
    checks.check_dimensions(function, arguments, 1, lambda args, by: (args[0], args[1] * by))


def single(angle, gain):
    return jnp.sin(angle).astype(jnp.float32)


def single_inside(angle, gain):
    return jnp.asarray(gain, jnp.float64) * jnp.sin(angle)


def traced_otherwise(angle, gain):
    return gain * angle + (1e-9 if isinstance(angle, Tracer) else 0.0)


def knows_the_others(angle, gain):
    return gain * (angle - jnp.mean(angle))


def without_gain(angle, gain):
    return jnp.sin(angle) + 0.0 * gain


@jax.custom_jvp
def wrong_derivative(angle, gain):
    return gain * jnp.sin(angle)


@wrong_derivative.defjvp
def _(primals, tangents):
    (angle, gain), (moved, _) = primals, tangents
    return wrong_derivative(angle, gain), gain * jnp.cos(angle) * moved


def wrong_reverse_mode(angle, gain):
    twice = jax.custom_derivatives.linear_call(
        lambda _, value: 2.0 * value, lambda _, weight: 3.0 * weight, (), jnp.asarray(angle)
    )
    return gain * twice


def infinite_at_zero(angle, gain):
    return jnp.sqrt(angle**2 + (gain - HERE[1]) ** 2)


@eqx.filter_jit
def static_number(angle, gain):
    return gain * jnp.sin(angle)


def program_of_its_own(angle, gain):
    return jax.jit(lambda x: gain * jnp.sin(x))(angle)


def sine_of_a_length(angle, gain):
    return jnp.sin(gain) * angle


def length_squared(angle, gain):
    return gain**2 * angle


@pytest.mark.parametrize(
    ("check", "wrong"),
    [
        (checks.check_double, single),
        (checks.check_double, single_inside),
        (checks.check_jit_is_eager, traced_otherwise),
        (checks.check_vmap_is_loop, knows_the_others),
        (checks.check_vmap_is_loop, without_gain),
        (checks.check_derivatives, wrong_derivative),
        (checks.check_derivatives, wrong_reverse_mode),
        (checks.check_finite_gradient, infinite_at_zero),
        (checks.check_one_trace, static_number),
        (checks.check_one_trace, program_of_its_own),
        (check_dimensions, sine_of_a_length),
        (check_dimensions, length_squared),
    ],
)
def test_a_wrong_function_is_caught(check, wrong):
    angles = np.zeros(3) if wrong is infinite_at_zero else HERE[0]
    with pytest.raises(AssertionError):
        check(wrong, (angles, HERE[1]))


def test_a_declared_unit_that_is_wrong_is_caught():
    law = next(law for law in table.LAWS if law.covers == "axial_displacement")
    with pytest.raises(AssertionError):
        checks.check_dimensions(law.function, law.arguments, table.POWER["rad"], law.scale)
