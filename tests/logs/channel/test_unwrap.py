import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vttig_jax.logs.channel.unwrap import (
    find_modulus,
    steps_per_interval,
    stray_jump,
    unwrap,
    wrap_steps,
)

pytestmark = pytest.mark.smoke


@st.composite
def walks(draw):
    """A modulus, an offset up to 2**45, and steps of less than half the modulus."""
    modulus = draw(st.sampled_from([256, 1000, 65_536, 90_000, 90_001, 2**32]))
    most = (modulus - 1) // 2
    steps = draw(st.lists(st.integers(-most, most), min_size=1, max_size=60))
    start = draw(st.integers(-(2**45), 2**45))
    return modulus, start + np.concatenate([[0], np.cumsum(steps)]).astype(np.int64)


@given(walks())
def test_integer_round_trip(walk):
    modulus, true = walk
    back = unwrap(true % modulus, modulus)
    assert back.dtype == np.int64
    np.testing.assert_array_equal(back - back[0], true - true[0])
    np.testing.assert_array_equal((back - true) % modulus, 0)


@given(walks())
def test_signed_counters_round_trip(walk):
    modulus, true = walk
    half = modulus // 2
    back = unwrap((true + half) % modulus - half, modulus)
    np.testing.assert_array_equal(back - back[0], true - true[0])


@given(walks())
def test_already_continuous_readings_stay(walk):
    modulus, true = walk
    np.testing.assert_array_equal(unwrap(true, modulus), true)


def test_steps_beyond_half_a_modulus_come_out_wrong():
    true = np.arange(0, 6000, 600)
    assert not np.array_equal(unwrap(true % 1000, 1000), true)
    np.testing.assert_array_equal(unwrap((true // 600 * 499) % 1000, 1000), true // 600 * 499)


@given(
    st.sampled_from([360.0, 2 * np.pi, 1.0]),
    st.floats(-0.49, 0.49),
    st.floats(-5.0, 5.0),
)
def test_angles_round_trip(turn, speed, start):
    true = turn * (start + speed * np.arange(40) + 0.004 * np.sin(np.arange(40)))
    back = unwrap(true % turn, turn)
    np.testing.assert_allclose(back - back[0], true - true[0], atol=1e-9 * turn)


@pytest.mark.parametrize("modulus", [2**12, 2**16, 90_000])
@pytest.mark.parametrize("share", [0.0013, 0.11, 0.37, 0.4983, -0.4983])
def test_modulus_found_up_to_half_of_it_per_sample(modulus, share):
    count = 4000
    true = 12_345 + np.rint(share * modulus * np.arange(count)).astype(np.int64)
    assert find_modulus(true % modulus, 90_000) == modulus
    np.testing.assert_array_equal(np.diff(unwrap(true % modulus, modulus)), np.diff(true))


def test_power_of_two_needs_no_counts_per_revolution():
    true = np.arange(0, 500_000, 45)
    assert find_modulus(true % 65_536, None) == 65_536
    # 90 000 is no power of two: without the counts per revolution it cannot be guessed.
    assert find_modulus(true % 90_000, 90_000) == 90_000
    assert find_modulus(true % 90_000, None) != 90_000


@pytest.mark.parametrize(
    "reading",
    [
        np.arange(0, 500_000, 45),
        np.array([0, 400, 500, 700]),
        np.rint(1e5 * np.sin(np.arange(2000) / 150)).astype(np.int64),
    ],
)
def test_no_modulus_in_continuous_counts(reading):
    assert find_modulus(reading, 90_000) is None


def test_a_wild_reading_feigns_no_huge_counter():
    reading = np.arange(0, 500_000, 45)
    reading[70] = -(2**60)
    assert find_modulus(reading, 90_000) is None


def test_single_turn_angles():
    true = np.arange(0, 2000, 7.3)
    assert find_modulus(true % 360, 360.0) == 360.0
    assert find_modulus((true + 180) % 360 - 180, 360.0) == 360.0
    assert find_modulus(true, 360.0) is None
    assert find_modulus(true % 300, 360.0) is None
    assert np.count_nonzero(wrap_steps(true % 360, 360.0)) == 5


def _time(count):
    return np.arange(count) / 100.0


def test_a_pause_is_no_jump():
    time = _time(1000)
    time[500:] += 3.0
    reading = 4000 * time
    assert stray_jump(reading, time, 1.0) is None
    assert stray_jump(reading, _time(1000), 1.0) == 500
    assert steps_per_interval(reading, time).max() == pytest.approx(40.0)
