import numpy as np
import pytest

from vttig_jax.kinematics.te_curve import TECurve


@pytest.fixture
def curve():
    angle = np.radians(np.linspace(720.0, 0.0, 73))
    return TECurve("B", angle, 1e-4 * np.cos(angle), np.linspace(0.0, 1.0, 73))


def test_text_names_flank_turns_and_range(curve):
    assert len(curve) == 73
    assert curve.peak_to_peak == pytest.approx(2e-4, rel=1e-12)
    text = str(curve)
    assert "flank B" in text and "73" in text and "2.000" in text
    assert "720.000° … 0.000°" in text and f"{np.degrees(2e-4):.5f}°" in text
    empty = curve.part(slice(0, 0))
    assert (len(empty), empty.mean_speed, empty.peak_to_peak) == (0, 0.0, 0.0)
    text = str(empty)
    assert "flank B" in text and "points" in text and "driving angle" not in text


def test_mean_speed_is_the_whole_angle_over_the_whole_time():
    """The time starts late, and the samples are far from equally spaced."""
    angle, time = np.array([4.0, 3.5, -2.0]), np.array([10.0, 12.5, 13.0])
    found = TECurve("B", angle, 0 * angle, time)
    assert found.mean_speed == pytest.approx(2.0, rel=1e-12)
    assert found.part(slice(0, 1)).mean_speed == 0.0
