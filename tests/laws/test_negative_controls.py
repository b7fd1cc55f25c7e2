"""Each check of the law table catches a function that is wrong in just that way."""

import types
from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.core import Tracer

from tests.laws import checks, table

pytestmark = pytest.mark.smoke

HERE = (np.array([0.3, -2.0, 1.7]), np.array(0.5))


def caught():
    return pytest.raises(AssertionError)


def test_a_sound_function_passes_every_check():
    def sound(angle, gain):
        return jnp.asarray(gain) * jnp.sin(jnp.asarray(angle, float))

    checks.check_double(sound, HERE)
    checks.check_jit_is_eager(sound, HERE)
    checks.check_vmap_is_loop(sound, HERE)
    checks.check_derivatives(sound, HERE)
    checks.check_finite_gradient(sound, HERE)
    checks.check_one_trace(jax.jit(sound), HERE)
    checks.check_dimensions(sound, HERE, 1, _scale_gain)


def test_single_precision_is_caught():
    with caught():
        checks.check_double(lambda angle, gain: jnp.sin(angle).astype(jnp.float32), HERE)


def test_single_precision_inside_is_caught():
    def hidden(angle, gain):
        return jnp.asarray(gain, jnp.float64) * jnp.sin(angle)

    with caught():
        checks.check_double(hidden, HERE)


def test_a_result_that_depends_on_tracing_is_caught():
    def peeking(angle, gain):
        return gain * angle + (1e-9 if isinstance(angle, Tracer) else 0.0)

    with caught():
        checks.check_jit_is_eager(peeking, HERE)


def test_elements_that_know_of_each_other_are_caught():
    with caught():
        checks.check_vmap_is_loop(lambda angle, gain: gain * (angle - jnp.mean(angle)), HERE)


def test_an_argument_without_effect_is_caught():
    with caught():
        checks.check_vmap_is_loop(lambda angle, gain: jnp.sin(angle) + 0.0 * gain, HERE)


def test_a_wrong_derivative_is_caught():
    @jax.custom_jvp
    def wrong(angle, gain):
        return gain * jnp.sin(angle)

    @wrong.defjvp
    def _(primals, tangents):
        (angle, gain), (moved, _) = primals, tangents
        return wrong(angle, gain), gain * jnp.cos(angle) * moved

    with caught():
        checks.check_derivatives(wrong, HERE)


def test_a_reverse_mode_that_differs_from_forward_mode_is_caught():
    def wrong(angle, gain):
        twice = jax.custom_derivatives.linear_call(
            lambda _, value: 2.0 * value, lambda _, weight: 3.0 * weight, (), jnp.asarray(angle)
        )
        return gain * twice

    with caught():
        checks.check_derivatives(wrong, HERE)


def test_an_infinite_gradient_is_caught():
    with caught():
        checks.check_finite_gradient(
            lambda angle, gain: jnp.sqrt(angle**2 + gain**2), (np.zeros(3), np.array(0.0))
        )


def test_recompiling_for_a_plain_number_is_caught():
    static = eqx.filter_jit(lambda angle, gain: gain * jnp.sin(angle))
    with caught():
        checks.check_one_trace(static, HERE)


def test_recompiling_for_an_array_is_caught():
    def fresh(angle, gain):
        return jax.jit(lambda x: gain * jnp.sin(x))(angle)

    with caught():
        checks.check_one_trace(fresh, HERE)


@pytest.mark.parametrize(
    "wrong",
    [lambda angle, gain: jnp.sin(gain) * angle, lambda angle, gain: gain**2 * angle],
    ids=["sine of a length", "length squared"],
)
def test_a_wrong_dimension_is_caught(wrong):
    with caught():
        checks.check_dimensions(wrong, HERE, 1, _scale_gain)


def test_a_declared_unit_that_is_wrong_is_caught():
    law = next(law for law in table.LAWS if law.covers == "axial_displacement")
    law = replace(law, unit="rad")
    with caught():
        checks.check_dimensions(law.function, law.arguments, table.POWER[law.unit], law.scale)


def test_scaling_reaches_every_length_and_no_angle():
    before, after = (table.scaled([table.PAIR, table.RIG], factor) for factor in (1.0, 2.0))
    changed = {
        jax.tree_util.keystr(path)
        for (path, old), (_, new) in zip(
            jax.tree_util.tree_leaves_with_path(before),
            jax.tree_util.tree_leaves_with_path(after),
            strict=True,
        )
        if not np.array_equal(old, new)
    }
    assert changed == {
        "[0].driving.face_width_mm",
        "[0].driven.face_width_mm",
        "[0].module_mm",
        "[0].centre_distance_mm",
        "[1].driving_mm",
        "[1].driven_mm",
        "[1].axial_mm",
    }


def test_an_export_without_a_row_is_seen():
    module = types.ModuleType("vttig_jax.kinematics.functions")

    def runout():
        return 0.0

    runout.__module__ = module.__name__
    vars(module).update(runout=runout, _hidden=runout, borrowed=np.sin, Kind=dict)
    assert table.public_functions(module) == {"runout"}


def test_a_method_without_a_row_is_seen():
    class Model(table.ClosedModel):
        def runout(self):
            return 0.0

    Model.__module__ = "vttig_jax.made_up"
    assert "Model.runout" in table.public_methods(Model)


def _scale_gain(arguments, factor):
    return arguments[0], arguments[1] * factor
