"""Whole numbers do not hang on the last digit of a quotient."""

import math
from fractions import Fraction

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from vttig_jax.base.numerics.counting import whole_below

HALVES = st.integers(0, 20_000)


@given(HALVES, st.integers(1, 999), st.sampled_from([-1, 0, 1]))
def test_halves_and_whole_numbers_are_what_they_are_meant_to_be(half, unit, way):
    """A quotient of decimals, a digit off or not."""
    step = unit / 1000
    quotient = np.nextafter(half / 2 * step / step, way * math.inf if way else half / 2)
    assert whole_below(quotient) == math.floor(Fraction(half, 2))


@given(st.integers(0, 10_000), st.floats(0.01, 0.49))
def test_everything_else_is_rounded_as_usual(whole, share):
    assert whole_below(whole + share) == whole
