"""Observers against the same equations in a NumPy loop, and against what they say of their lag."""

import math
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vttig_jax.control.hardware.encoder import (
    AlphaBetaGamma,
    FilteredDifference,
    MotionEstimate,
    Observer,
)

PERIOD = 1e-3
READINGS = 1024
TIME = np.arange(READINGS) * PERIOD
KINDS = (AlphaBetaGamma, FilteredDifference)


def observed(observer: Observer, readings: np.ndarray, period: float = PERIOD) -> np.ndarray:
    """Angle, speed and acceleration after every reading, shape (3, readings); from rest."""
    padded = np.pad(readings, (0, READINGS - readings.size), mode="edge")
    found = _observed(observer, jnp.asarray(padded), jnp.asarray(period))
    return np.asarray(found)[:, : readings.size]


@eqx.filter_jit
def _observed(observer, readings, period):
    def one(before, reading):
        after = observer.step(before, reading, period)
        return after, jnp.stack(jax.tree.leaves(after))

    still = jnp.zeros(())
    return jax.lax.scan(one, MotionEstimate(readings[0], still, still), readings)[1].T


def tracked(readings: np.ndarray, bandwidth: float, period: float) -> np.ndarray:
    """The tracking filter as prediction matrix and gain vector."""
    pole = math.exp(-2 * math.pi * bandwidth * period)
    gain = np.array(
        [
            1 - pole**3,
            1.5 * (1 - pole) * (1 - pole**2) / period,
            (1 - pole) ** 3 / period**2,
        ]
    )
    ahead = np.array([[1, period, period**2 / 2], [0, 1, period], [0, 0, 1]])
    state, found = np.array([readings[0], 0.0, 0.0]), []
    for reading in readings:
        state = ahead @ state
        state = state + gain * (reading - state[0])
        found.append(state)
    return np.transpose(found)


def differenced(readings: np.ndarray, bandwidth: float, period: float) -> np.ndarray:
    """Differences, smoothed exponentially with time constant 1/(2πf)."""
    kept = math.exp(-2 * math.pi * bandwidth * period)
    last, speed, gain, found = readings[0], 0.0, 0.0, []
    for reading in readings:
        faster = kept * speed + (1 - kept) * (reading - last) / period
        gain = kept * gain + (1 - kept) * (faster - speed) / period
        last, speed = reading, faster
        found.append((reading, speed, gain))
    return np.transpose(found)


@pytest.mark.parametrize(
    ("kind", "loop"), [(AlphaBetaGamma, tracked), (FilteredDifference, differenced)]
)
@given(seed=st.integers(0, 10**6), bandwidth=st.floats(0.5, 200.0), period=st.floats(1e-4, 1e-2))
def test_it_follows_any_readings_as_the_loop_does(kind, loop, seed, bandwidth, period):
    readings = np.random.default_rng(seed).normal(size=80).cumsum() * 1e-3
    found, expected = observed(kind(bandwidth), readings, period), loop(readings, bandwidth, period)
    scale = np.abs(expected).max(axis=1, keepdims=True)
    np.testing.assert_allclose(found / scale, expected / scale, atol=1e-9)
    if loop is tracked:
        assert not np.allclose(found / scale, differenced(readings, bandwidth, period) / scale)


@given(bandwidth=st.floats(1.0, 200.0), period=st.floats(1e-4, 2e-3))
def test_all_three_poles_of_the_tracking_filter_lie_in_one_place(bandwidth, period):
    filter_, still = AlphaBetaGamma(bandwidth), jnp.zeros(())

    def unforced(state: Any) -> Any:
        after = filter_.step(MotionEstimate(*state), still, jnp.asarray(period))
        return jnp.stack(jax.tree.leaves(after))

    columns = np.stack([np.asarray(unforced(jnp.asarray(unit))) for unit in np.eye(3)], axis=1)
    scale = np.array([1.0, period, period**2])
    balanced = scale[:, None] * columns / scale
    pole = math.exp(-2 * math.pi * bandwidth * period)
    # A triple eigenvalue moves by the cube root of the rounding; its polynomial does not.
    expected = [1, -3 * pole, 3 * pole**2, -(pole**3)]
    np.testing.assert_allclose(np.poly(balanced), expected, atol=1e-12)


def test_the_tracking_filter_follows_constant_acceleration_without_lag():
    rate, gain = 3.0, -12.5
    readings = 0.2 + rate * TIME + 0.5 * gain * TIME**2
    angle, speed, acceleration = observed(AlphaBetaGamma(20.0), readings)[:, -1]
    assert angle == pytest.approx(readings[-1], abs=1e-9)
    assert speed == pytest.approx(rate + gain * TIME[-1], abs=1e-9)
    assert acceleration == pytest.approx(gain, abs=1e-6)


def test_after_a_step_of_the_acceleration_its_speed_overshoots():
    """What the documentation warns of."""
    braked = np.where(TIME < 0.3, 3.0 * TIME, 0.9 + 3.0 * (TIME - 0.3) - 6.0 * (TIME - 0.3) ** 2)
    stopped = np.where(TIME < 0.55, braked, 0.9 + 0.75 - 6.0 * 0.25**2)
    speed = observed(AlphaBetaGamma(20.0), stopped)[1]
    assert speed[TIME > 0.55].min() < -1e-2
    assert abs(speed[-1]) < 1e-6


@pytest.mark.parametrize("bandwidth", [10.0, 20.0, 40.0])
def test_the_difference_lags_by_one_time_constant_in_speed_and_two_in_acceleration(bandwidth):
    gain, constant = 12.5, 1 / (2 * math.pi * bandwidth)
    sampled = (PERIOD / constant) ** 2 / 10  # a twelfth of it is due to the sampling
    speed = observed(FilteredDifference(bandwidth), 0.5 * gain * TIME**2)[1, -1]
    assert TIME[-1] - speed / gain == pytest.approx(constant, rel=sampled)
    jerk = 40.0
    acceleration = observed(FilteredDifference(bandwidth), jerk * TIME**3 / 6)[2, -1]
    assert TIME[-1] - acceleration / jerk == pytest.approx(2 * constant, rel=sampled)
    # The tracking filter lags in neither of the two: the measure of lag can tell.
    still = observed(AlphaBetaGamma(bandwidth), 0.5 * gain * TIME**2)[1, -1]
    assert abs(TIME[-1] - still / gain) < 1e-6


@pytest.mark.parametrize("kind", KINDS)
def test_at_rest_it_sees_rest(kind):
    np.testing.assert_array_equal(observed(kind(20.0), np.full(50, 1.25))[1:], 0.0)


@pytest.mark.parametrize("kind", KINDS)
def test_a_higher_bandwidth_sees_a_step_of_the_acceleration_sooner(kind):
    readings = 0.5 * 10.0 * np.maximum(TIME - 0.3, 0.0) ** 2
    seen = [np.argmax(observed(kind(f), readings)[2] > 5.0) for f in (5.0, 20.0, 80.0)]
    assert seen[0] > seen[1] > seen[2] > 300
