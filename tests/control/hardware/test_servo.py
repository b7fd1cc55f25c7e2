"""A servo motor alone: its law, its limit, and its shaft, against equations solved by scipy."""

import re

import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.control.followed import Still, by_scipy, drive_of, shafts_of, told_of, turned
from tests.control.scenarios import PAIR, case_of, spec_of
from tests.control.texts import refused
from vttig_jax.control.hardware.servo import Motor, Servo
from vttig_jax.control.motion.motion import MotionPoint
from vttig_jax.control.plants.plant import Drag, Play
from vttig_jax.control.simulation.simulate import simulate

INERTIA, FRICTION = 0.002, 0.05
GAINS = (1.0, 20.0, 15.0)
WIDE = Still(-10.0, 10.0).bounds()
"""Flanks so far apart that none is met."""


def alone(servo: Servo, told: MotionPoint, step: float, friction: float = 0.0, speed: float = 0.0):
    """The driving shaft in the middle of a gap that it never crosses."""
    drive = drive_of(servo, Drag(INERTIA, friction))
    return turned(drive, Play(), WIDE, shafts_of(WIDE, speed=speed), told, step)[0]


@pytest.mark.parametrize("limit", [5.0, 0.12])
def test_the_shaft_follows_as_scipy_has_it(limit):
    step, time = 1e-3, np.arange(61) * 1e-3
    told = told_of(15.0 * time**2 + 0.5 * time, 30.0 * time + 0.5)
    ways = alone(Servo(*GAINS, limit), told, step, FRICTION)

    def rates(y, torque):
        return [y[1], (torque - FRICTION * np.tanh(1e9 * y[1])) / INERTIA]

    precision = {"rtol": 1e-12, "atol": 1e-15}
    oracle = by_scipy(GAINS, told, step, np.zeros(2), rates, limit, **precision)
    np.testing.assert_allclose(ways.angle, oracle[:, 0], atol=1e-10)
    np.testing.assert_allclose(ways.speed, oracle[:, 1], atol=1e-8)


@settings(deadline=None)
@given(st.floats(-1e3, 1e3), st.floats(-100, 100), st.floats(-1.0, 1.0), st.floats(0.01, 10.0))
def test_the_torque_keeps_its_limit_and_the_integral_grows_only_below_it(angle, speed, wound, most):
    motor = Motor(*map(jnp.asarray, (0.0, 0.0, wound, False)))
    servo = Servo(*GAINS, most)
    torque, kept = servo.torque(motor, *map(jnp.asarray, (angle, speed, 1e-3)))
    torque, after = float(torque), float(kept.integral)
    assert bool(kept.limited) <= (abs(torque) == most)
    assert abs(torque) <= most
    if abs(torque) == most and after != wound:
        assert (after - wound) * torque < 0  # it unwinds


# From a scenario.

PI = {"servo.motor": "pi"}


@pytest.mark.slow
def test_what_a_servo_misses_is_said():
    base = {**PI, "controller": "none", "plant": "play", "motion.reversal_deg": 90.0}
    base |= {"motion.dwell_s": 0.1, "motion.ramp_s": 0.1}
    found = simulate(spec_of(base), PAIR)
    following = found.to_json()["following_error_deg"]
    assert following is not None and 0.05 < following < 2.0
    assert "following error" in str(found) and "lost motion" in str(found)
    assert found.remarks == ()
    weak = simulate(spec_of(base, {"servo.torque_limit_Nm": 0.1}), PAIR)
    assert weak.to_json()["following_error_deg"] == pytest.approx(90.0, abs=0.1)
    assert re.match(r"The motor is at servo.torque_limit_Nm for .* s; .* 90\.", weak.remarks[0])
    told = simulate(spec_of(base, {"servo.motor": "prescribed"}), PAIR)
    assert told.to_json()["following_error_deg"] is None and "following error" not in str(told)


def test_a_step_too_long_for_the_gain_is_refused_with_one_that_will_do():
    much = {**PI, "servo.speed_gain_Nms": 7.0}
    with refused("sampling.plant_hz", "take plant_hz = 3500"):
        case_of(spec_of(much), PAIR)
    case_of(spec_of(much, {"sampling.plant_hz": 4000.0}), PAIR)
    case_of(spec_of(much, {"servo.motor": "prescribed"}), PAIR)
