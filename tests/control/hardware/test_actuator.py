"""The actuator against the closed form of a trapezoidal move, and what holds it back."""

import math
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from vttig_jax.control.hardware.actuator import Actuator, can_back_drive

pytestmark = pytest.mark.smoke

PERIODS = 512
OPEN = 1e9
ROUNDING = 1e-11


class Way(NamedTuple):
    """What an actuator did, period by period."""

    target: Any
    wanted: Any
    rate: Any
    reached: Any
    blocked: Any
    start: Any
    end: Any
    start_rate: Any
    end_rate: Any


def actuator(**values: Any) -> Actuator:
    given: dict[str, Any] = {"speed_mm_s": 20.0, "acceleration_mm_s2": 2000.0, "stroke_mm": 10.0}
    given |= {"resolution_mm": 0.0, "delay": 0.0, "back_drivable": np.asarray(True), "periods": 1}
    return Actuator(**(given | values))


def follow(which: Actuator, command: Any, closed: Any = OPEN, step: float = 1e-3) -> Way:
    """Run `PERIODS` periods from rest; a number stands for a constant."""
    commands, gaps = (
        jnp.asarray(np.broadcast_to(np.asarray(values, float), PERIODS))
        for values in (command, closed)
    )
    return Way(*map(np.asarray, _follow(which, commands, gaps, jnp.asarray(step))))


@eqx.filter_jit
def _follow(which, commands, gaps, step):
    def one(carriage, given):
        carriage, target = which.commanded(carriage, given[0])
        carriage, slide, blocked = which.step(carriage, target, given[1], step)
        kept = (target, carriage.unobstructed, carriage.rate, carriage.reached, blocked)
        return carriage, (*kept, *jax.tree.leaves(slide))

    return jax.lax.scan(one, which.at_rest(), (commands, gaps))[1]


def within_limits(way: Way, speed: float, acceleration: float, step: float) -> bool:
    gains = np.diff(way.rate, prepend=0.0)
    return bool(
        np.all(np.abs(way.rate) <= speed * (1 + ROUNDING))
        and np.all(np.abs(gains) <= acceleration * step * (1 + ROUNDING) + ROUNDING * speed)
    )


def move_time(distance: float, speed: float, acceleration: float) -> float:
    """Of a trapezoidal move from rest to rest, s."""
    if distance * acceleration < speed**2:
        return 2 * math.sqrt(distance / acceleration)
    return distance / speed + speed / acceleration


@given(
    command=st.floats(1e-4, 10.0),
    speed=st.floats(0.1, 1e3),
    acceleration=st.floats(1.0, 1e5),
    step=st.floats(1e-4, 1e-2),
)
def test_it_arrives_within_its_limits_in_the_time_of_a_trapezoid_and_never_beyond(
    command, speed, acceleration, step
):
    expected = move_time(command, speed, acceleration)
    assume(expected < (PERIODS - 4) * step)
    way = follow(actuator(speed_mm_s=speed, acceleration_mm_s2=acceleration), command, step=step)
    assert within_limits(way, speed, acceleration, step)
    assert np.all(np.diff(way.wanted) >= -ROUNDING) and way.wanted.max() <= command + ROUNDING
    arrived = (np.argmax(np.abs(way.wanted - command) < 1e-9 * command) + 1) * step
    assert way.wanted[-1] == pytest.approx(command, rel=1e-12)
    assert expected - 2 * step <= arrived <= expected + 2 * step


@given(
    commands=st.lists(st.floats(0.0, 1.0), min_size=1, max_size=16),
    speed=st.floats(10.0, 1e3),
    acceleration=st.floats(500.0, 1e5),
)
def test_whatever_it_is_told_it_keeps_its_limits_and_ends_on_the_last_command(
    commands, speed, acceleration
):
    told = np.resize(np.repeat(commands, 4), PERIODS // 4)
    told = np.concatenate([told, np.full(PERIODS - told.size, commands[-1])])
    way = follow(actuator(speed_mm_s=speed, acceleration_mm_s2=acceleration), told)
    assert within_limits(way, speed, acceleration, 1e-3)
    highest = min(speed, 2 * math.sqrt(acceleration))  # on a way of a mm it gets no faster
    late = 2 * highest / acceleration
    late += move_time(1 + highest**2 / acceleration, highest, acceleration)
    assume(late < 0.75 * PERIODS * 1e-3)
    assert way.wanted[-1] == pytest.approx(commands[-1], abs=1e-12)


def test_a_slide_leads_from_place_to_place():
    way = follow(actuator(), 0.7, closed=0.5)
    np.testing.assert_array_equal(way.end, way.reached)
    np.testing.assert_array_equal(way.start[1:], way.reached[:-1])
    mean = (way.end - way.start) / 1e-3
    np.testing.assert_allclose(way.start_rate + way.end_rate, 2 * mean, atol=1e-9)


# What it takes of a command.


def test_the_stroke_ends_it():
    assert follow(actuator(stroke_mm=0.25), 0.7).reached[-1] == pytest.approx(0.25)
    assert follow(actuator(stroke_mm=0.25), 0.2).reached[-1] == pytest.approx(0.2)
    assert np.all(follow(actuator(), -0.5).reached == 0.0)
    assert np.all(follow(actuator(), 0.7, closed=-0.2).reached == 0.0)  # the flanks overlap


@given(commands=st.lists(st.floats(0.0, 9.0), min_size=1), resolution=st.floats(1e-4, 1.0))
def test_it_stops_on_whole_steps_at_most_one_short_of_the_command(commands, resolution):
    told = np.resize(commands, PERIODS)
    target = follow(actuator(resolution_mm=resolution), told).target
    steps = target / resolution
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-9)
    assert np.all(target <= told + 1e-12) and np.all(target > told - resolution * (1 + 1e-9))


@pytest.mark.parametrize(("delay", "periods"), [(0, 1), (1, 1), (2, 2), (3, 4), (1, 4)])
def test_a_command_arrives_after_whole_periods_of_delay(delay, periods):
    told = np.random.default_rng(1).uniform(0, 9, PERIODS)
    found = follow(actuator(delay=float(delay), periods=periods), told).target
    np.testing.assert_array_equal(found, np.concatenate([np.zeros(delay), told])[:PERIODS])


# What stands in its way.


def test_it_stalls_at_the_closed_gap_and_is_pushed_back_as_the_gap_shrinks():
    number = np.arange(PERIODS)
    closed = np.where(number < 200, 0.5, np.maximum(0.5 - 0.001 * (number - 199), 0.3))
    way = follow(actuator(), 0.7, closed=closed)
    np.testing.assert_array_equal(way.reached, np.minimum(way.wanted, closed))
    free = follow(actuator(), 0.7)
    np.testing.assert_array_equal(way.wanted, free.wanted)  # a stall does not wind it up
    assert way.reached[-1] == 0.3 and not way.blocked.any()
    assert not np.array_equal(way.reached, free.reached)


def test_after_a_stall_it_leaves_the_closed_gap_when_it_has_come_back_to_it():
    told = np.where(np.arange(PERIODS) < 256, 0.7, 0.0)
    way = follow(actuator(), told, closed=0.5)
    leaves = np.argmax((way.reached < 0.5) & (np.arange(PERIODS) > 256))
    assert way.wanted[leaves - 1] >= 0.5 > way.wanted[leaves]
    assert way.reached[-1] == pytest.approx(0.0, abs=1e-12)


def test_the_drive_blocks_where_the_gap_shrinks_below_what_does_not_yield():
    number = np.arange(PERIODS)
    shrinking = np.where(number < 200, 0.5, 0.5 - 0.0005 * (number - 199))
    stiff = actuator(back_drivable=np.asarray(False))
    way = follow(stiff, 0.7, closed=shrinking)
    assert np.argmax(way.blocked) == 200 and way.blocked[200:].all()
    # Neither a stall at a gap that stays or grows, nor a gap with room left, blocks.
    assert not follow(stiff, 0.7, closed=0.5).blocked.any()
    assert not follow(stiff, 0.7, closed=0.5 + 1e-4 * number).blocked.any()
    assert not follow(stiff, 0.2, closed=shrinking).blocked.any()
    # It blocks as well where it withdraws, but slower than the gap shrinks.
    told = np.where(number < 200, 0.5, 0.0)
    slow = actuator(speed_mm_s=0.1, back_drivable=np.asarray(False))
    assert not follow(slow, 0.04, closed=shrinking).blocked.any()
    assert follow(stiff, told, closed=np.where(number < 201, 0.5, 0.2)).blocked.any()


# Can the teeth push it back?


@pytest.mark.parametrize("taper", [(3.0, 3.0), (0.0, 5.0), (5.0, -2.0), (-4.0, 1.0)])
def test_the_steepest_flank_pushes_unless_the_wedge_is_flatter_than_its_friction(taper):
    slopes = np.tan(np.radians(taper))
    locked = slopes.max()  # a flank of negative taper pushes towards the closed gap
    for friction in (0.0, 0.5 * locked, locked * (1 - 1e-9)):
        assert can_back_drive(slopes, friction)
    for friction in (locked, locked * (1 + 1e-9), 0.5):
        assert not can_back_drive(slopes, friction)
    many = can_back_drive(np.stack([slopes] * 2), np.array([0.0, locked]))
    np.testing.assert_array_equal(many, [True, False])
