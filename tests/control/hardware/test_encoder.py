"""Encoders against a reading written out, and the noise of a period whatever came before it."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from vttig_jax.base.units import ARCSEC, DEG, REV
from vttig_jax.control.hardware.encoder import Encoder, noise_draws

COUNT = REV / 90_000
DRAWS = 20_000


def sensor(count: float = 0.0, amplitude: float = 0.0, phase: float = 0.0, noise: float = 0.0):
    counts = round(REV / count) if count else 0
    return Encoder(counts, amplitude / ARCSEC, phase / DEG, noise / ARCSEC)


def read(which: Encoder, angle: float, shock: float = 0.0) -> float:
    return float(which.read(jnp.asarray(angle), jnp.asarray(shock)))


@given(angle=st.floats(-1e4, 1e4), counts=st.integers(100, 10**7))
def test_it_shows_the_whole_count_that_is_nearest(angle, counts):
    count = REV / counts
    shown = read(sensor(count), angle)
    assert shown / count == pytest.approx(round(shown / count), abs=1e-6)
    assert abs(angle - shown) <= (0.5 + 1e-6) * count


@pytest.mark.parametrize("turns", [3, 10, 21])
def test_a_shaft_on_a_count_does_not_flicker(turns):
    near = turns * REV * (1 + np.array([-1e-14, 0.0, 1e-14]))
    assert len({read(sensor(COUNT), angle) for angle in near}) == 1


@given(angle=st.floats(-1e3, 1e3, allow_subnormal=False), phase=st.floats(-7.0, 7.0))
def test_without_counts_it_shows_the_angle_and_mounted_off_centre_a_sine_of_its_shaft(angle, phase):
    assert read(sensor(), angle) == angle
    size = 18 * ARCSEC
    shown = read(sensor(amplitude=size, phase=phase), angle)
    assert shown == pytest.approx(angle + size * math.sin(angle + phase), abs=1e-12)


def test_noise_comes_before_the_rounding():
    noisy = sensor(COUNT, noise=COUNT)
    middle = 10 * COUNT
    assert [round(read(noisy, middle, shock) / COUNT) for shock in (-1.0, 0.0, 1.0)] == [9, 10, 11]
    assert read(sensor(noise=0.3), 1.0, -2.0) == pytest.approx(0.4)


# The noise itself.


def drawn(seed: int, periods: np.ndarray) -> np.ndarray:
    return np.asarray(jax.vmap(noise_draws, (None, 0))(jax.random.key(seed), jnp.asarray(periods)))


def test_the_noise_of_a_period_is_its_own_whatever_is_drawn_with_it():
    key, all_at_once = jax.random.key(7), drawn(7, np.arange(64))
    late = drawn(7, np.arange(63, 31, -1))
    np.testing.assert_array_equal(all_at_once[32:], late[::-1])
    for period in (0, 5, 63):
        np.testing.assert_array_equal(all_at_once[period], noise_draws(key, jnp.asarray(period)))
    values = np.concatenate([all_at_once.ravel(), drawn(8, np.arange(64)).ravel()])
    assert len(np.unique(values)) == values.size


def test_the_noise_is_white_standard_normal_and_independent_of_the_other_shaft():
    noise = drawn(3, np.arange(DRAWS))
    for values in noise.T:
        assert stats.kstest(values, "norm").pvalue > 1e-3
        assert abs(np.corrcoef(values[1:], values[:-1])[0, 1]) < 4 / math.sqrt(DRAWS)
    assert abs(np.corrcoef(noise.T)[0, 1]) < 4 / math.sqrt(DRAWS)
