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

COUNTING = np.arange(0, 500_000, 45)


@st.composite
def walks(draw):
    """A modulus, an offset up to 2**45, and steps of less than half the modulus."""
    modulus = draw(st.sampled_from([256, 1000, 65_536, 90_000, 90_001, 2**32]))
    most = (modulus - 1) // 2
    steps = draw(st.lists(st.integers(-most, most), min_size=1, max_size=60))
    start = draw(st.integers(-(2**45), 2**45))
    return modulus, start + np.concatenate([[0], np.cumsum(steps)]).astype(np.int64)


@given(walks())
def test_counters_from_zero_about_zero_and_continuous_ones_round_trip(walk):
    modulus, true = walk
    half = modulus // 2
    back = unwrap(true % modulus, modulus)
    assert back.dtype == np.int64
    np.testing.assert_array_equal((back - true) % modulus, 0)
    for found in (back, unwrap((true + half) % modulus - half, modulus)):
        np.testing.assert_array_equal(found - found[0], true - true[0])
    np.testing.assert_array_equal(unwrap(true, modulus), true)


@given(st.sampled_from([360.0, 2 * np.pi, 1.0]), st.floats(-0.49, 0.49), st.floats(-5.0, 5.0))
def test_angles_round_trip(turn, speed, start):
    true = turn * (start + speed * np.arange(40) + 0.004 * np.sin(np.arange(40)))
    back = unwrap(true % turn, turn)
    np.testing.assert_allclose(back - back[0], true - true[0], atol=1e-9 * turn)


@pytest.mark.parametrize("modulus", [2**12, 2**16, 90_000])
@pytest.mark.parametrize("share", [0.0013, 0.11, 0.37, 0.4983, -0.4983])
def test_modulus_found_up_to_half_of_it_per_sample(modulus, share):
    true = 12_345 + np.rint(share * modulus * np.arange(4000)).astype(np.int64)
    assert find_modulus(true % modulus, 90_000) == modulus
    np.testing.assert_array_equal(np.diff(unwrap(true % modulus, modulus)), np.diff(true))


@pytest.mark.parametrize(
    ("readings", "per_turn", "modulus"),
    [
        (COUNTING % 65_536, None, 65_536),  # a power of two needs no counts per revolution
        (COUNTING, 90_000, None),
        (np.array([0, 400, 500, 700]), 90_000, None),
        (np.rint(1e5 * np.sin(np.arange(2000) / 150)).astype(np.int64), 90_000, None),
        (np.where(COUNTING == 45 * 70, -(2**60), COUNTING), 90_000, None),
        (np.arange(0, 2000, 7.3) % 360, 360.0, 360.0),
        ((np.arange(0, 2000, 7.3) + 180) % 360 - 180, 360.0, 360.0),
        (np.arange(0, 2000, 7.3), 360.0, None),
        (np.arange(0, 2000, 7.3) % 300, 360.0, None),
    ],
)
def test_the_modulus_of_readings(readings, per_turn, modulus):
    assert find_modulus(readings, per_turn) == modulus


def test_wraps_are_counted_and_other_moduli_are_not_guessed():
    assert np.count_nonzero(wrap_steps(np.arange(0, 2000, 7.3) % 360, 360.0)) == 5
    assert find_modulus(COUNTING % 90_000, None) != 90_000


def test_a_pause_is_no_jump():
    steady = np.arange(1000) / 100.0
    paused = steady + 3.0 * (np.arange(1000) >= 500)
    assert stray_jump(4000 * paused, paused, 1.0) is None
    assert stray_jump(4000 * paused, steady, 1.0) == 500
    assert steps_per_interval(4000 * paused, paused).max() == pytest.approx(40.0)
