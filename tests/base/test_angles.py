import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vttig_jax.base.angles import amplitude_phase, difference_deg, wrap_deg
from vttig_jax.base.units import DEG

pytestmark = pytest.mark.smoke

ANGLES = st.floats(-1e6, 1e6)
COEFFICIENTS = st.floats(-1e3, 1e3)


@given(ANGLES, ANGLES)
def test_wrapped_angles_and_differences_are_the_same_direction(angle, other):
    wrapped, way = wrap_deg(angle), difference_deg(angle, other)
    assert 0.0 <= wrapped < 360.0
    assert -180.0 <= way < 180.0
    for turns in ((angle - wrapped) / 360.0, (angle - other - way) / 360.0):
        assert turns == pytest.approx(round(turns), abs=1e-9)


def test_angles_at_the_ends_of_the_ranges():
    assert wrap_deg(-1e-20) == 0.0
    np.testing.assert_array_equal(wrap_deg([[-90.0], [720.0]]), [[270.0], [0.0]])
    assert difference_deg(180.0, 0.0) == difference_deg(0.0, 180.0) == -180.0


@given(COEFFICIENTS, COEFFICIENTS, st.floats(0, 360))
def test_amplitude_and_phase_are_the_same_wave(cosine, sine, angle_deg):
    amplitude, phase_deg = amplitude_phase(cosine, sine)
    assert amplitude >= 0.0
    assert 0.0 <= phase_deg < 360.0
    x = angle_deg * DEG
    wave = cosine * np.cos(x) + sine * np.sin(x)
    assert amplitude * np.sin(x + phase_deg * DEG) == pytest.approx(wave, abs=1e-9)


def test_no_amplitude_has_phase_zero_whatever_the_signs_of_the_zeros():
    amplitude, phase_deg = amplitude_phase([0.0, 0.0, -0.0], [0.0, -0.0, -0.0])
    np.testing.assert_array_equal(amplitude, 0.0)
    np.testing.assert_array_equal(phase_deg, 0.0)
