"""A shaft on a count does not flicker, and the noise of a period is its own.

What an encoder shows is written out in `simulation/test_simulate.py`.
"""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

from vttig_jax.base.units import REV
from vttig_jax.control.hardware.encoder import Encoder, noise_draws

DRAWS = 20_000


@pytest.mark.parametrize("turns", [3, 10, 21])
def test_a_shaft_on_a_count_does_not_flicker(turns):
    encoder, still = Encoder(90_000), jnp.zeros(())
    near = turns * REV * (1 + np.array([-1e-14, 0.0, 1e-14]))
    assert len({float(encoder.read(jnp.asarray(angle), still)) for angle in near}) == 1


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
