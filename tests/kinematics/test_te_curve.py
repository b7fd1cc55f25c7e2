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


def test_a_part_without_points_says_so(curve):
    empty = curve.part(slice(0, 0))
    assert (len(empty), empty.peak_to_peak) == (0, 0.0)
    text = str(empty)
    assert "flank B" in text and "points" in text and "driving angle" not in text
