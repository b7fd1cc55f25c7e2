"""The prescribed motion against a numerical derivative and a plain description of the trapezoid."""

from dataclasses import replace

import numpy as np
import pytest

from vttig_jax.base.units import DEG, REV
from vttig_jax.rig.motion import PassMotion

pytestmark = pytest.mark.smoke

STEADY = 2 * np.pi
"""60 rpm in rad/s."""


def _speed(motion: PassMotion, time: np.ndarray, half_step: float = 1e-6) -> np.ndarray:
    ahead, behind = (motion.driving_angle(time + s * half_step) for s in (1, -1))
    return (ahead - behind) / (2 * half_step)


def _trapezoid(time: np.ndarray, ramp_s: float, steady_s: float) -> np.ndarray:
    """Speed of one pass as a share of the steady speed."""
    corners = [0.0, ramp_s, ramp_s + steady_s, 2 * ramp_s + steady_s]
    return np.interp(time, corners, [0.0, 1.0, 1.0, 0.0])


MOTION = PassMotion(speed_rpm=60.0, reversal_deg=720.0, dwell_s=0.75, ramp_s=0.5, ripple=0.0)
STEADY_S = 2.0 - 0.5
PASS_S = STEADY_S + 2 * 0.5 + 0.75


def test_both_passes_run_at_the_trapezoid():
    time = np.linspace(0.003, 2.497, 301)
    forward, back = _speed(MOTION, time), _speed(MOTION, PASS_S + time)
    expected = STEADY * _trapezoid(time, 0.5, STEADY_S)
    np.testing.assert_allclose(forward, expected, atol=1e-5)
    np.testing.assert_allclose(back, -expected, atol=1e-5)
    wrong = STEADY * _trapezoid(time, 0.45, STEADY_S + 0.1)
    assert np.abs(forward - wrong).max() > 0.1


def test_both_ends_and_the_dwell_between():
    dwell = np.linspace(2.5, PASS_S, 20)
    np.testing.assert_allclose(MOTION.driving_angle(dwell) / DEG, 720.0, atol=1e-9)
    ends = MOTION.driving_angle(np.array([-1.0, 0.0, 2 * PASS_S - 0.75, 2 * PASS_S, 99.0]))
    np.testing.assert_allclose(ends, 0.0, atol=1e-12)


def test_passes_go_to_and_fro():
    for passes in (1, 2, 3, 4):
        motion = PassMotion(reversal_deg=720.0, dwell_s=0.75, ripple=0.0, passes=passes)
        assert motion.duration_s == pytest.approx(passes * PASS_S)
        last = motion.driving_angle(np.array([motion.duration_s]))[0]
        assert last / DEG == pytest.approx(720.0 if passes % 2 else 0.0, abs=1e-9)
        middles = (np.arange(passes) + 0.5) * PASS_S - 0.375
        speed = _speed(motion, middles)
        np.testing.assert_allclose(speed, STEADY * (-1.0) ** np.arange(passes), atol=1e-5)


def test_without_ramps_the_speed_steps():
    motion = PassMotion(reversal_deg=720.0, dwell_s=0.5, ramp_s=0.0, ripple=0.0)
    time = np.linspace(0.01, 1.99, 50)
    np.testing.assert_allclose(motion.driving_angle(time), STEADY * time, atol=1e-12)
    assert motion.duration_s == pytest.approx(2 * (2.0 + 0.5))


def test_ripple_has_its_size_and_order():
    motion = PassMotion(reversal_deg=1080.0, ripple=0.01, ripple_order=5)
    time = np.linspace(0.6, 2.9, 4001)
    plain = PassMotion(reversal_deg=1080.0, ripple=0.0)
    relative = _speed(motion, time) / STEADY - 1
    expected = 0.01 * np.cos(5 * plain.driving_angle(time))
    np.testing.assert_allclose(relative, expected, atol=1e-6)
    assert np.abs(expected).max() > 0.009


def test_speed_sets_the_time_and_reversal_the_way():
    slow = PassMotion(speed_rpm=30.0, reversal_deg=720.0, dwell_s=0.0, ripple=0.0)
    assert slow.duration_s == pytest.approx(2 * (4.0 + 0.5))
    angle = slow.driving_angle(np.linspace(0, slow.duration_s, 1001))
    assert angle.max() == pytest.approx(2 * REV)


@pytest.mark.parametrize(
    ("name", "wrong", "condition"),
    [
        *((name, value, "positive") for name in ("speed_rpm", "reversal_deg")
          for value in (0.0, -1.0, float("nan"))),
        *((name, 0, "positive") for name in ("passes", "ripple_order")),
        *((name, -0.1, "not be negative") for name in ("dwell_s", "ramp_s", "ripple")),
    ],
)  # fmt: skip
def test_arguments_out_of_range(name, wrong, condition):
    with pytest.raises(ValueError, match=f"Argument `{name}` must .*{condition}, but is {wrong}"):
        replace(MOTION, **{name: wrong})
    if condition != "positive":
        replace(MOTION, **{name: 0.0})


def test_reversal_inside_the_ramps_is_refused():
    PassMotion(reversal_deg=180.0, ramp_s=0.5)
    with pytest.raises(ValueError, match=r"`reversal_deg` must be at least 180° \(both ramps\)"):
        PassMotion(reversal_deg=179.0, ramp_s=0.5)
