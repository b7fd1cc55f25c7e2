import numpy as np
import pytest

from vttig_jax.logs.channel.unwrap import find_modulus, unwrap, wrap_steps

pytestmark = pytest.mark.smoke

COUNTING = np.arange(0, 500_000, 45)


@pytest.mark.parametrize("modulus", [2**12, 2**16, 90_000])
@pytest.mark.parametrize("share", [0.0013, 0.11, 0.37, 0.4983, -0.4983])
def test_modulus_found_up_to_half_of_it_per_sample(modulus, share):
    true = 12_345 + np.rint(share * modulus * np.arange(4000)).astype(np.int64)
    assert find_modulus(true % modulus, 90_000) == modulus
    half = modulus // 2
    for reading in (true % modulus, (true + half) % modulus - half, true):  # also about zero
        np.testing.assert_array_equal(np.diff(unwrap(reading, modulus)), np.diff(true))


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
