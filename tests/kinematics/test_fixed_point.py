"""The implicit solver on a contraction whose solution and derivatives are known otherwise."""

import jax
import jax.numpy as jnp
import numpy as np

from vttig_jax.kinematics.exact import exact_model
from vttig_jax.kinematics.flank_model import fixed_point

GAIN = 0.5
SHIFTS = np.array([-2.0, -0.3, 0.0, 0.7, 3.1])


def step(value, shift):
    """Kepler's equation t = shift + 0.5 sin t: contracts by 0.5 at worst."""
    return shift + GAIN * jnp.sin(value)


def solve(shift):
    return fixed_point(step, shift)


def slope(shift):
    return 1 / (1 - GAIN * np.cos(np.asarray(solve(shift))))


def test_solution_keeps_its_equation_and_its_derivative_is_that_of_the_implicit_function():
    found = np.asarray(solve(SHIFTS))
    np.testing.assert_allclose(found, SHIFTS + GAIN * np.sin(found), rtol=0, atol=2e-15)
    np.testing.assert_allclose(jax.vmap(jax.grad(solve))(SHIFTS), slope(SHIFTS), rtol=1e-13)
    jacobian = np.asarray(jax.jacrev(solve)(SHIFTS))
    np.testing.assert_allclose(jacobian, np.diag(slope(SHIFTS)), rtol=1e-13, atol=0)
    central = (solve(SHIFTS + 1e-5) - solve(SHIFTS - 1e-5)) / 2e-5
    np.testing.assert_allclose(slope(SHIFTS), central, rtol=1e-9)
    assert np.abs(slope(SHIFTS) - 1).max() > 0.2
    bend = jax.vmap(jax.grad(jax.grad(solve)))(SHIFTS)  # d²t/dx² = −0.5 sin t · (dt/dx)³
    expected = -GAIN * np.sin(found) * slope(SHIFTS) ** 3
    np.testing.assert_allclose(bend, expected, rtol=1e-12, atol=1e-14)


def test_a_relation_that_does_not_settle_ends_and_nan_stays():
    """An expansion is iterated a limited number of times and not forever."""
    found = fixed_point(lambda value, shift: shift - 1.5 * value, jnp.asarray(1.0))
    assert abs(float(found)) > 1e6
    found = np.asarray(solve(jnp.array([0.3, jnp.nan])))
    assert np.isfinite(found[0]) and np.isnan(found[1])


def test_lanes_that_swing_by_a_last_bit_do_not_hold_up_the_others(paper_pair, paper_rig):
    """Rounding makes a few of many angles swing between two neighbouring numbers for ever."""
    model = exact_model(paper_pair, paper_rig)
    evaluations = []

    def counted(error, args):
        jax.debug.callback(lambda: evaluations.append(1))
        model, angle = args
        return model.at_both_angles(angle, model.ratio * angle + error, "A")

    angles = jnp.linspace(0.0, 100.0, 100_000)
    found = fixed_point(counted, (model, angles))
    jax.effects_barrier()
    assert 3 <= len(evaluations) <= 8
    again = model.at_both_angles(angles, jnp.asarray(model.ratio) * angles + found, "A")
    np.testing.assert_allclose(found, again, rtol=0, atol=1e-15)
