"""Observers against what they say of their lag; differences against the same in a NumPy loop.

The loop of the tracking filter stands in `simulation/test_simulate.py`.
"""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vttig_jax.control.hardware.encoder import AlphaBetaGamma, FilteredDifference, Observer
from vttig_jax.control.motion.motion import MotionPoint

PERIOD = 1e-3
READINGS = 1024
TIME = np.arange(READINGS) * PERIOD


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
    return jax.lax.scan(one, MotionPoint(readings[0], still, still), readings)[1].T


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


@given(seed=st.integers(0, 10**6), bandwidth=st.floats(0.5, 200.0), period=st.floats(1e-4, 1e-2))
def test_the_difference_follows_any_readings_as_the_loop_does(seed, bandwidth, period):
    readings = np.random.default_rng(seed).normal(size=80).cumsum() * 1e-3
    found = observed(FilteredDifference(bandwidth), readings, period)
    expected = differenced(readings, bandwidth, period)
    scale = np.abs(expected).max(axis=1, keepdims=True)
    np.testing.assert_allclose(found / scale, expected / scale, atol=1e-9)


@pytest.mark.parametrize("bandwidth", [10.0, 40.0])
def test_the_difference_lags_by_one_and_two_time_constants_and_the_tracking_filter_not(bandwidth):
    gain, jerk, constant = 12.5, 40.0, 1 / (2 * math.pi * bandwidth)
    sampled = (PERIOD / constant) ** 2 / 10  # a twelfth of it is due to the sampling
    even, growing = 0.5 * gain * TIME**2, jerk * TIME**3 / 6
    speed = observed(FilteredDifference(bandwidth), even)[1, -1]
    assert TIME[-1] - speed / gain == pytest.approx(constant, rel=sampled)
    acceleration = observed(FilteredDifference(bandwidth), growing)[2, -1]
    assert TIME[-1] - acceleration / jerk == pytest.approx(2 * constant, rel=sampled)
    found = observed(AlphaBetaGamma(bandwidth), even)[:, -1]
    np.testing.assert_allclose(found, [even[-1], gain * TIME[-1], gain], atol=1e-6)
