"""One impact on spring and damper against closed forms, DOP853 and the law of energy."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from benchmarks.compiler import fast_to_compile
from vttig_jax.control.plants.elastic import Press, Pulls, impact

TABLED = {0.02: 0.941, 0.05: 0.863, 0.1: 0.759, 0.2: 0.614, 0.3: 0.520, 0.5: 0.404, 0.7: 0.333}
LONG = 1e4
"""Time in 1/ω after which every impact is over."""

_impact = jax.jit(impact)


def after(depth: float, rate: float, pull: float, time: float, damping_ratio: float):
    numbers = (jnp.asarray(float(number)) for number in (depth, rate, pull, time, damping_ratio))
    place, speed, force, *others = numbers
    return _impact(Press(place, speed), Pulls(force, force, force), *others)


@jax.jit
def _in_steps(press: Press, pull, step, damping_ratio):
    """4096 steps instead of one."""

    def one(press, _):
        return impact(press, Pulls(pull, pull, pull), step, damping_ratio).press, None

    return jax.lax.scan(one, press, None, length=4096)[0]


def restitution(damping_ratio: float) -> float:
    """Piece by piece, underdamped: the stiff spring in closed form, then the damped oscillation."""
    first = math.atan(2 * math.sqrt(2) * damping_ratio) / math.sqrt(2)
    depth = math.sin(math.sqrt(2) * first) / math.sqrt(2)
    rate = math.cos(math.sqrt(2) * first)
    turn = complex(-damping_ratio, math.sqrt(1 - damping_ratio**2))
    size = complex(depth, -(rate + damping_ratio * depth) / turn.imag)

    def at(time: float) -> tuple[float, float]:
        wave = size * np.exp(turn * time)
        return wave.real, (turn * wave).real

    def force(time: float) -> float:
        depth, rate = at(time)
        return depth + 2 * damping_ratio * rate

    last = brentq(force, 1e-6, 0.99 * math.pi / turn.imag, xtol=1e-14)
    return -at(float(last))[1]  # pyright: ignore[reportArgumentType]


@pytest.mark.parametrize(("damping_ratio", "tabled"), TABLED.items())
def test_it_throws_back_as_tabled(damping_ratio, tabled):
    exact = restitution(damping_ratio)
    assert exact == pytest.approx(tabled, abs=6e-4)
    thrown = after(-3.0, 1.0, 0.0, LONG, damping_ratio).press
    assert -float(thrown.rate) == pytest.approx(exact, abs=1e-7)


@pytest.mark.parametrize("damping_ratio", [1.0, 2.0])
def test_overdamped_impacts_against_dop853(damping_ratio):
    def law(_, state):
        depth, rate = state
        most = max(depth, 0.0)
        return rate, -(most + np.clip(2 * damping_ratio * rate, -most, most))

    path = solve_ivp(law, (0, 60), (0.0, 1.0), "DOP853", rtol=1e-9, atol=1e-12, max_step=0.02)
    found = after(0.0, 1.0, 0.0, 60.0, damping_ratio).press
    assert float(found.rate) == pytest.approx(path.y[1, -1], abs=1e-5)
    assert float(found.depth) == pytest.approx(path.y[0, -1], abs=1e-3)


@pytest.mark.parametrize("damping_ratio", [0.0, 0.1, 0.9, 1.1, 3.0])
@pytest.mark.parametrize(("depth", "rate"), [(-0.3, 0.8), (0.2, 0.5), (0.4, -0.1), (0.3, -2.0)])
def test_one_step_is_many(damping_ratio, depth, rate):
    """With a pull, from flight or from any piece of the law, until it has left again."""
    pull, time = 1e-3 if damping_ratio > 1 else 0.02, 5.0 + 4 * damping_ratio
    one = after(depth, rate, pull, time, damping_ratio).press
    numbers = map(jnp.asarray, (pull, time / 4096, damping_ratio))
    many = _in_steps(Press(jnp.asarray(depth), jnp.asarray(rate)), *numbers)
    error = 1e-4 if damping_ratio > 1 else 1e-6
    assert float(one.depth) == pytest.approx(float(many.depth), abs=error)
    assert float(one.rate) == pytest.approx(float(many.rate), abs=error)
    assert float(one.depth) < 0


def test_a_loose_flank_that_the_pull_catches_up_with_is_pressed_again():
    """ζ = 3: the force is gone, but the body does not get out."""
    start, pull, damping_ratio = (1.0, -0.25), 0.5, 3.0
    path = np.polynomial.Polynomial([1.0, -0.25, 0.25])
    again = min((path + 6 * path.deriv()).roots(), key=abs)
    for time in (again, 2.0):
        found = after(*start, pull, time, damping_ratio).press
        assert float(found.depth) == pytest.approx(path(again), rel=1e-12)
    numbers = map(jnp.asarray, (pull, 60.0 / 4096, damping_ratio))
    many = _in_steps(Press(*map(jnp.asarray, start)), *numbers)
    assert float(many.depth) == pytest.approx(pull, abs=1e-3)


def test_the_instant_of_entry():
    found = after(-2.0, 1.0, 0.5, LONG, 0.1)
    assert float(found.entry) == pytest.approx(-2 + math.sqrt(4 + 8), rel=1e-14)
    assert bool(found.met)
    for depth, rate, pull in ((-2.0, -1.0, 0.0), (-2.0, 1.0, -0.26), (-2.0, 0.0, -1.0)):
        missed = after(depth, rate, pull, 7.0, 0.1)
        assert not missed.met and float(missed.entry) == 7.0
        assert float(missed.press.depth) == pytest.approx(depth + 7 * rate + 24.5 * pull)
    assert float(after(0.1, 0.0, 0.0, 1.0, 0.1).entry) == 0.0


def test_the_pull_may_change_where_the_flank_is_met_and_where_it_is_left():
    """Undamped: thrown back at the speed of the entry, then the last pull."""
    entry = -2 + math.sqrt(12)  # of -1 + t/2 + t²/8
    speed = 0.5 + 0.25 * entry
    start, pulls = Press(*map(jnp.asarray, (-1.0, 0.5))), (0.25, 0.0, -0.1)
    numbers = map(jnp.asarray, (entry + 4.0, 0.0))
    found = _impact(start, Pulls(*map(jnp.asarray, pulls)), *numbers)
    flight = 4.0 - math.pi
    assert float(found.entry) == pytest.approx(entry, rel=1e-14)
    assert float(found.press.rate) == pytest.approx(-speed - 0.1 * flight, abs=1e-7)
    depth = -speed * flight - 0.05 * flight**2
    assert float(found.press.depth) == pytest.approx(depth, abs=1e-7)


def test_what_lasts_on_comes_to_rest_where_spring_and_pull_balance():
    for depth, rate in ((-1e-3, 0.0), (0.02, 1e-3), (0.01, 0.0)):
        found = after(depth, rate, 0.01, LONG, 0.1)
        assert float(found.press.depth) == 0.01 and float(found.press.rate) == 0.0


@given(
    depth=st.floats(-2.0, 2.0),
    rate=st.floats(-2.0, 2.0),
    pull=st.floats(-0.5, 0.5),
    time=st.floats(0.0, 20.0),
    damping_ratio=st.sampled_from([0.0, 0.01, 0.1, 0.5, 1.0, 3.0, 30.0]) | st.floats(0.0, 100.0),
)
def test_no_energy_is_gained(depth, rate, pull, time, damping_ratio):
    found = after(depth, rate, pull, time, damping_ratio).press

    def energy(depth: float, rate: float) -> float:
        return 0.5 * rate**2 + 0.5 * max(depth, 0.0) ** 2 - pull * depth

    assert energy(float(found.depth), float(found.rate)) <= energy(depth, rate) + 1e-7


def _ended(numbers):
    """Depth and rate at the time 5, by start, pull and damping ratio."""
    depth, rate, pull, damping_ratio = numbers
    start, time = Press(depth, rate), jnp.asarray(5.0)
    ended = impact(start, Pulls(pull, pull, pull), time, damping_ratio).press
    return jnp.stack([ended.depth, ended.rate])


@pytest.mark.slow
def test_gradients_through_an_impact_and_at_the_kinks():
    slopes = jax.jit(jax.jacrev(_ended), **fast_to_compile())
    point, ended = jnp.array([-0.3, 0.8, 0.02, 0.1]), jax.jit(_ended)
    differences = [(ended(point + s) - ended(point - s)) / 2e-5 for s in 1e-5 * jnp.eye(4)]
    np.testing.assert_allclose(slopes(point), np.transpose(differences), rtol=1e-4, atol=1e-6)
    for start in ((0, 0, 0), (0, 0.5, 0), (-1, 0, 0), (0.1, -0.5, 0), (0, 0, 1), (1, -0.5, 1)):
        for damping_ratio in (0.0, 1.0):
            assert np.all(np.isfinite(slopes(jnp.array([*start, damping_ratio], float))))
