"""Each controller on measurements made up by hand: what Fig. 7 says, and what prediction adds."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vttig_jax.base.units import REV
from vttig_jax.control.controllers.controller import (
    Acceleration,
    Controller,
    Measurement,
    NoController,
    Predictive,
)
from vttig_jax.kinematics.flank_table import FirstOrderBounds

pytestmark = pytest.mark.smoke

MEAN, SWING, PER_MM = 7e-4, 4e-4, 1.3e-3
THRESHOLD, LEAST, MARGIN = 3.0, 0.5, 0.02
HORIZON, LEAD = 0.3, 0.003
ROOM = 64


def shift(angle: float, margin: float = MARGIN) -> float:
    """What closes the gap of the made-up pair, which is largest at 0, but for a margin, mm."""
    return (MEAN + SWING * math.cos(angle)) / PER_MM - margin


BOUNDS = FirstOrderBounds(
    ratio=0.5625,
    offset=np.array([0.0, MEAN]),
    cosine=np.array([[0.0, 0.0], [SWING, 0.0]]),
    sine=np.zeros((2, 2)),
    closing=np.array([0.4 * PER_MM, 0.6 * PER_MM]),
)


class Seen(NamedTuple):
    """One measurement: rad, rad/s, rad/s²."""

    angle: float
    speed: float
    acceleration: float


def acceleration(*sequence: Seen, margin: float = MARGIN) -> np.ndarray:
    """What the paper's controller commands period by period, mm."""
    return commands(Acceleration(THRESHOLD, LEAST * 60 / REV, margin), sequence, LEAD)


def predictive(*sequence: Seen, margin: float = MARGIN, lead: float = LEAD) -> np.ndarray:
    return commands(Predictive(LEAST * 60 / REV, HORIZON, margin), sequence, lead)


def commands(controller: Controller, sequence: Sequence[Seen], lead: float) -> np.ndarray:
    """All sequences share one program."""
    table = np.array(sequence, float)
    padded = np.pad(table, ((0, ROOM - len(table)), (0, 0)), mode="edge")
    return np.asarray(_commands(controller, jnp.asarray(padded), jnp.asarray(lead)))[: len(table)]


@eqx.filter_jit
def _commands(controller, table, lead):
    def one(state, row):
        angles = row[0], 0.5625 * row[0]
        seen = Measurement(jnp.zeros(()), *angles, row[1], row[2], row[0], row[1], BOUNDS, lead)
        return controller.step(state, seen)

    return jax.lax.scan(one, controller.start(), table)[1]


# Fig. 7.


def test_it_closes_by_the_backlash_where_deceleration_is_judged_and_holds_that():
    steady, braking = Seen(1.0, 6.0, 0.0), Seen(2.0, 5.9, -12.0)
    later, at_rest = Seen(3.0, 3.0, -12.0), Seen(3.5, 0.0, 0.0)
    found = acceleration(steady, braking, later, at_rest, at_rest)
    np.testing.assert_allclose(found, [0.0, *[shift(2.0)] * 4], atol=1e-15)
    assert abs(shift(3.5) - shift(2.0)) > 0.1  # the gap itself has long been another


def test_it_opens_when_the_shaft_accelerates_backwards_and_judges_the_next_stop_anew():
    braking, back, steady = Seen(2.0, 5.9, -12.0), Seen(2.0, -0.6, -12.0), Seen(1.0, -6.0, 0.0)
    braking_back = Seen(0.5, -5.9, 12.0)
    found = acceleration(braking, back, steady, braking_back, Seen(0.1, -3.0, 12.0))
    np.testing.assert_allclose(found, [shift(2.0), 0, 0, shift(0.5), shift(0.5)], atol=1e-15)


@pytest.mark.parametrize("sense", [1.0, -1.0])
def test_the_threshold_decides(sense):
    above, below = (Seen(2.0, sense * 6.0, -sense * THRESHOLD * f) for f in (1.001, 0.999))
    assert acceleration(below)[0] == 0.0
    assert acceleration(above)[0] == pytest.approx(shift(2.0))


def test_below_the_least_speed_nothing_is_judged_anew():
    slow, slow_back = Seen(2.0, 0.99 * LEAST, -12.0), Seen(2.0, -0.99 * LEAST, -12.0)
    assert acceleration(slow)[0] == 0.0
    braking = Seen(1.0, 6.0, -12.0)
    np.testing.assert_allclose(acceleration(braking, slow, slow_back), [shift(1.0)] * 3, atol=1e-15)


def test_a_margin_wider_than_the_gap_asks_for_nothing():
    brakes = Seen(2.0, 6.0, -12.0)
    assert np.all(acceleration(brakes, margin=5.0) == 0.0)
    assert acceleration(brakes, margin=0.0) == pytest.approx(shift(2.0, 0))
    assert np.all(commands(NoController(), [brakes], LEAD) == 0.0)


# Prediction.

_SEEN = st.builds(Seen, st.floats(-1e3, 1e3), st.floats(-20.0, 20.0), st.floats(-200.0, 200.0))


@given(sequence=st.lists(_SEEN, min_size=1, max_size=ROOM), margin=st.floats(0.0, 1.0))
def test_prediction_never_asks_for_more_than_the_present_gap_less_the_margin(sequence, margin):
    found = predictive(*sequence, margin=margin)
    most = np.array([max(shift(seen.angle, margin), 0.0) for seen in sequence])
    assert np.all(found >= 0) and np.all(found <= most + 1e-12)


@given(
    stop=st.floats(-50.0, 50.0), speed=st.floats(0.6, 20.0), gain=st.floats(50.0, 500.0),
    sense=st.sampled_from([1.0, -1.0]),
)  # fmt: skip
def test_at_constant_deceleration_it_knows_the_angle_where_the_shaft_will_stop(
    stop, speed, gain, sense
):
    if speed >= HORIZON * gain:
        return
    here = stop - sense * speed**2 / (2 * gain)
    found = predictive(Seen(here, sense * speed, -sense * gain), lead=0.0)[0]
    assert found == pytest.approx(max(min(shift(here), shift(stop)), 0.0), abs=1e-12)


def test_it_looks_as_far_ahead_as_its_actuator_follows_behind():
    here, speed, gain, lead = 2.0, 2.0, 50.0, 0.1
    stop = here + speed**2 / (2 * gain)
    beyond = here + speed * lead
    assert shift(beyond) < shift(stop) < shift(here)
    seen = Seen(here, speed, -gain)
    assert predictive(seen, lead=lead)[0] == pytest.approx(shift(beyond))
    assert predictive(seen, lead=0.0)[0] == pytest.approx(shift(stop))


def test_it_closes_no_sooner_than_the_horizon_and_opens_once_the_shaft_runs_steadily():
    gain = 12.0
    far, near = (Seen(2.0, gain * HORIZON * f, -gain) for f in (1.001, 0.999))
    steady = Seen(2.1, 2.0, 0.0)
    found = predictive(far, near, steady, Seen(2.2, 2.0, 5.0))
    assert found[1] > 0 and np.all(found[[0, 2, 3]] == 0.0)


def test_it_stays_closed_while_the_shaft_stands_but_open_before_the_first_move():
    still, runs = Seen(1.0, 0.0, 0.0), Seen(1.5, 6.0, 0.0)
    creeps, creeps_back = Seen(2.0, 0.9 * LEAST, 0.0), Seen(2.0, -0.9 * LEAST, 0.0)
    found = predictive(still, still, runs, creeps, creeps_back, lead=0.0)
    np.testing.assert_allclose(found, [0, 0, 0, shift(2.0), shift(2.0)], atol=1e-12)
