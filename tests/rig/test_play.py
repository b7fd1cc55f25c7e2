"""The play operator against a plain loop."""

import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vttig_jax.rig.synthetic import play

pytestmark = pytest.mark.smoke

# Multiples of 1/64: numbers so small that XLA takes them for zero are no angles.
NUMBER = st.integers(-640, 640).map(lambda n: n / 64)
GAP = st.integers(0, 192).map(lambda n: n / 64)
PATH = st.lists(st.tuples(NUMBER, GAP), min_size=40, max_size=40)


def _play(lower, upper, start: float) -> np.ndarray:
    return np.asarray(play(jnp.asarray(lower), jnp.asarray(upper), jnp.asarray(start)))


def _loop(lower, upper, start: float) -> np.ndarray:
    path, position = [], start
    for low, high in zip(lower, upper, strict=True):
        position = min(max(position, low), high)
        path.append(position)
    return np.array(path)


@given(PATH, NUMBER)
def test_equals_the_loop(path, start):
    lower, gap = np.array(path).T
    upper = lower + gap
    np.testing.assert_array_equal(_play(lower, upper, start), _loop(lower, upper, start))
