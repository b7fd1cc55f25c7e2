"""A servo motor alone: its law, its limit, and its shaft, against equations solved by scipy."""

import re

import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from tests.control.driven import IDLE, Start, drive_of, follow, told_of, waves
from tests.control.followed import Still
from tests.control.scenarios import PAIR, case_of, spec_of
from vttig_jax.base.errors import ScenarioError
from vttig_jax.control.hardware.servo import Motor, Servo, ServoDrive
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
    return follow(drive, Play(), WIDE, Start(speed=speed), told, step)


def reference(limit: float, told: MotionPoint, step: float, friction: float, substeps: int = 1):
    """The same by DOP853 between the samples of the servo, with the friction of a moving shaft."""
    kp, ki, kv = GAINS
    place, wound, found = np.zeros(2), 0.0, []
    for number in range(len(told.angle) - 1):
        error = told.speed[number] + kv * (told.angle[number] - place[0]) - place[1]
        plain = kp * error + ki * (wound + step * error)
        torque = np.clip(plain, -limit, limit)
        if torque == plain or error * plain < 0:
            wound += step * error

        def rates(_, y, torque=torque):
            return [y[1], (torque - friction * np.tanh(1e9 * y[1])) / INERTIA]

        place = solve_ivp(rates, (0, step), place, "DOP853", rtol=1e-12, atol=1e-15).y[:, -1]
        found.append(place)
    return np.array(found)


def ramp(steps: int, step: float, acceleration: float = 30.0) -> MotionPoint:
    time = np.arange(steps + 1) * step
    return told_of(0.5 * acceleration * time**2 + 0.5 * time, acceleration * time + 0.5)


@pytest.mark.parametrize("limit", [5.0, 0.12])
def test_the_shaft_follows_as_scipy_has_it(limit):
    step, told = 1e-3, ramp(60, 1e-3)
    ways = alone(Servo(*GAINS, limit), told, step, FRICTION)
    oracle = reference(limit, told, step, FRICTION)
    np.testing.assert_allclose(ways.angle, oracle[:, 0], atol=1e-10)
    np.testing.assert_allclose(ways.speed, oracle[:, 1], atol=1e-8)


def test_ever_faster_samples_come_to_the_continuous_law():
    """ODE of three states: angle, speed, integral; the difference halves with the step."""
    kp, ki, kv = GAINS
    end, acceleration = 0.064, 30.0

    def rates(t, y):
        error = 0.5 + acceleration * t - y[1] + kv * (0.5 * acceleration * t**2 + 0.5 * t - y[0])
        return [y[1], (kp * error + ki * y[2]) / INERTIA, error]

    exact = solve_ivp(rates, (0, end), [0, 0, 0], "DOP853", rtol=1e-12, atol=1e-14).y[0, -1]
    away = []
    for step in (4e-4, 2e-4, 1e-4):
        ways = alone(Servo(*GAINS, 1e3), ramp(round(end / step), step), step)
        away.append(abs(ways.angle[-1] - exact))
    assert away[0] < 2e-4
    np.testing.assert_allclose(np.array(away[:-1]) / away[1:], 2.0, rtol=0.05)


def test_at_its_limit_it_speeds_up_evenly_and_brakes_evenly():
    limit, step, steps = 0.4, 1e-3, 50
    time = np.arange(1, steps + 1) * step
    ways = alone(Servo(*GAINS, limit), told_of(0.0, np.full(steps + 1, 1e4)), step, FRICTION)
    np.testing.assert_allclose(ways.speed, (limit - FRICTION) / INERTIA * time, rtol=1e-12)
    np.testing.assert_allclose(ways.angle, 0.5 * (limit - FRICTION) / INERTIA * time**2, rtol=1e-12)
    ways = alone(Servo(*GAINS, limit), told_of(0.0, np.full(51, -1e4)), step, FRICTION, speed=20.0)
    braked = 20.0 - (limit + FRICTION) / INERTIA * time
    np.testing.assert_allclose(ways.speed[braked > 0], braked[braked > 0], rtol=1e-10)


def test_a_step_of_the_speed_is_followed_without_a_lasting_error():
    ways = alone(Servo(1.0, 20.0, 0.0, 1e3), told_of(0.0, np.full(1001, 3.0)), 1e-3, FRICTION)
    assert ways.speed[-1] == pytest.approx(3.0, abs=1e-6)
    lags = alone(Servo(1.0, 0.0, 0.0, 1e3), told_of(0.0, np.full(1001, 3.0)), 1e-3, FRICTION)
    assert lags.speed[-1] == pytest.approx(3.0 - FRICTION, abs=1e-6)  # e = T/k_p


def test_the_position_loop_brings_it_back_to_its_angle():
    told = told_of(np.full(1001, 0.01), 0.0)
    assert alone(Servo(*GAINS, 5.0), told, 1e-3).angle[-1] == pytest.approx(0.01, abs=1e-4)
    assert alone(Servo(1.0, 20.0, 0.0, 5.0), told, 1e-3).angle[-1] == 0.0


def test_the_integral_does_not_wind_up_at_the_limit():
    """What the shaft overshoots a step that keeps it at its limit for long."""
    servo, step = Servo(1.0, 50.0, 0.0, 0.1), 1e-3
    ways = alone(servo, told_of(0.0, np.full(1001, 20.0)), step)
    assert 0.2 < np.argmax(ways.speed > 19.0) * step < 0.5  # at the limit for that long
    # What can wind is what the last part of the approach winds, where the torque is below it.
    assert ways.speed.max() < 20.2
    speed, wound, highest = 0.0, 0.0, 0.0
    for _ in range(1000):  # the same without that care
        wound += step * (20.0 - speed)
        speed += step * np.clip(20.0 - speed + 50.0 * wound, -0.1, 0.1) / INERTIA
        highest = max(highest, speed)
    assert highest > 22.0


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


def test_no_gain_is_no_torque():
    ways = alone(IDLE, told_of(1.0, np.full(11, 5.0)), 1e-3, speed=2.0)
    np.testing.assert_array_equal(ways.speed, 2.0)


# From a scenario.

PI = {"servo.motor": "pi"}
SHORT_RUN = {"motion.reversal_deg": 90.0, "motion.dwell_s": 0.1, "motion.ramp_s": 0.1}


@pytest.mark.slow
def test_what_a_servo_misses_is_said():
    base = {**PI, **SHORT_RUN, "controller": "none", "plant": "play"}
    found = simulate(spec_of(base), PAIR)
    following = found.to_json()["following_error_deg"]
    assert following is not None and 0.05 < following < 2.0
    assert "following error" in str(found) and "lost motion" in str(found)
    assert found.remarks == ()
    weak = simulate(spec_of(base, {"servo.torque_limit_Nm": 0.1}), PAIR)
    assert weak.to_json()["following_error_deg"] == pytest.approx(90.0, abs=0.1)
    assert re.match(r"The motor is at servo.torque_limit_Nm for .* s; .* 90\.", weak.remarks[0])
    prescribed = simulate(spec_of(base, {"servo.motor": "prescribed"}), PAIR)
    assert prescribed.to_json()["following_error_deg"] is None
    assert "following error" not in str(prescribed)


def test_a_prescribed_motion_is_the_default_and_a_servo_is_asked_for():
    assert case_of(spec_of({}), PAIR).drive is None
    drive = case_of(spec_of(PI, {"plant": "play"}), PAIR).drive
    assert isinstance(drive, ServoDrive) and float(drive.driven.inertia) == 0.0


def test_a_step_too_long_for_the_gain_is_refused_with_one_that_will_do():
    much = {**PI, "servo.speed_gain_Nms": 7.0}
    with pytest.raises(ScenarioError) as caught:
        case_of(spec_of(much), PAIR)
    assert caught.value.where == "sampling.plant_hz"
    assert (
        "too long for servo.speed_gain_Nms and for inertia.driving_kgm2; take plant_hz = 3500"
        in caught.value.message
    )
    case_of(spec_of(much, {"sampling.plant_hz": 4000.0}), PAIR)
    case_of(spec_of(much, {"servo.motor": "prescribed"}), PAIR)


def test_waves_are_waves():
    flanks = waves().at(jnp.linspace(0.0, 20.0, 400))
    assert np.ptp(flanks.lower) > 5e-4 and (flanks.upper - flanks.lower).min() < 4e-4
