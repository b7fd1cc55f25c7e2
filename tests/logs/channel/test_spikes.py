import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.logs.profiles import counts, geared, late, trapezoid
from vttig_jax.logs.channel.speed import smooth_speed, spikes, without_spikes


@pytest.mark.parametrize("rate", [200.0, 500.0, 1987.0])
def test_late_readings_are_found(rate):
    time, angle, steady = trapezoid(rate=rate, reversal=2160.0)
    disturbed, which = late(time, angle)
    found = spikes(counts(disturbed), time, 1.0)
    far = np.abs(disturbed - angle) > 0.9
    assert np.count_nonzero(found & far & steady) > 0.98 * np.count_nonzero(far & steady)
    assert np.count_nonzero(found & ~which) <= 1 + 1e-3 * np.count_nonzero(which)


@pytest.mark.parametrize("rate", [100.0, 1987.0])
@pytest.mark.parametrize("noise", [0.0, 0.005])
def test_undisturbed_motion_has_none(rate, noise):
    time, angle, _ = trapezoid(rate=rate, reversal=1080.0, passes=4, ramp=0.1, dwell=0.2)
    driven, _ = geared(angle, noise=noise)
    for readings, quantum in ((counts(angle), 1.0), (counts(driven), 1.0), (driven, 0.0)):
        assert not spikes(readings, time, quantum).any()
    jitter = time + np.random.default_rng(0).uniform(-0.3, 0.3, len(time)) / rate
    assert not spikes(counts(driven), np.sort(jitter), 1.0).any()


def test_a_step_is_no_spike_nor_are_too_many():
    time = np.arange(2000) / 500.0
    reading = counts(360.0 * time)
    reading[900:] -= 40_000
    assert not spikes(reading, time, 1.0).any()
    reading[900:905] += 40_000  # five readings too late to follow
    assert np.flatnonzero(spikes(reading, time, 1.0)).tolist() in ([], [900, 901, 902, 903, 904])
    time = np.arange(3000) / 500.0
    rough, _ = late(time, 360.0 * time, share=0.3)
    assert not spikes(rough, time, 0.004).any()


@given(st.integers(0, 499), st.sampled_from([10**6, -(2**31), 5000, -2000]))
def test_one_wild_reading(row, wild):
    time = np.arange(500) / 500.0
    reading = counts(360.0 * time)
    true = reading.copy()
    reading[row] = true[row] + wild
    found = spikes(reading, time, 1.0)
    assert np.flatnonzero(found).tolist() == [row]
    restored = without_spikes(reading, time, found)
    assert restored.dtype == np.int64
    # At the ends the nearest good reading stands in.
    assert abs(restored[row] - true[row]) <= (1 if 0 < row < 499 else 200)


def test_without_spikes_keeps_what_it_was_given():
    values = np.array([2**45, 2**45 + 10, 7, 2**45 + 30])
    time = np.array([0.0, 1.0, 2.0, 3.0])
    found = np.array([False, False, True, False])
    restored = without_spikes(values, time, found)
    assert restored.tolist() == [2**45, 2**45 + 10, 2**45 + 20, 2**45 + 30] and values[2] == 7
    assert without_spikes(values, time, np.zeros(4, bool)) is values
    time[:] = 0.0
    assert np.isfinite(without_spikes(values.astype(float), time, found)).all()


def test_speed_is_not_wrecked_by_late_readings():
    time, angle, steady = trapezoid(rate=500.0, reversal=2160.0)
    disturbed, _ = late(time, angle)
    speed = smooth_speed(time, np.radians(disturbed), 1e-5).value[steady]
    assert np.abs(np.abs(speed) - 2 * np.pi).max() < 0.1


@pytest.mark.parametrize("resolution", [0.0, 1e-3])
def test_a_shaft_that_changes_in_its_spikes_only_stands_still(resolution):
    angle = np.zeros(400)
    angle[[50, 300]] = 1.0
    speed = smooth_speed(np.arange(400) / 500.0, angle, resolution)
    assert np.all(speed.value == 0.0) and np.isfinite(speed.dwell)
