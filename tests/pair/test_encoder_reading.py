import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from vttig_jax.pair.gear_pair import ShaftReading, shaft_reading
from vttig_jax.pair.schema import Encoder


@given(
    counts=st.integers(-(10**9), 10**9),
    origin=st.integers(-(10**6), 10**6),
    sign=st.sampled_from([1, -1]),
)
def test_counts_and_degrees_of_one_place_are_one_angle(counts, origin, sign):
    encoder = Encoder(counts_per_rev=90_000, sign=sign)
    shaft = shaft_reading(encoder, 2 * math.pi * origin / 90_000)
    expected = sign * 2 * math.pi * (counts - origin) / 90_000
    assert shaft.unit == "counts"
    assert shaft.angle(counts) == pytest.approx(expected, abs=1e-9)
    assert shaft.angle_of_deg(counts / 250) == pytest.approx(expected, abs=1e-9)


def test_a_scale_multiplies_counts_and_is_in_degrees_already():
    shaft = shaft_reading(Encoder(counts_per_rev=100), math.radians(36.0), 2.0)
    assert shaft.angle(30) == pytest.approx(math.radians(2 * (30 * 3.6 - 36.0)))
    assert shaft.angle_of_deg(216.0) == pytest.approx(math.radians(216.0 - 72.0))


def test_without_counts_per_revolution_readings_are_angles():
    shaft = shaft_reading(Encoder(sign=-1), 0.5)
    assert shaft == ShaftReading("rad", -1.0, 0.5)
    assert shaft.angle(0.7) == pytest.approx(-0.2)
