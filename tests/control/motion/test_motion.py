"""Motions in pieces and the sine against corners worked out by hand and numerical integration."""

from typing import Any

import jax
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.control.parts import at, motion_of, trapezoid
from vttig_jax.base.units import DEG, REV
from vttig_jax.control.motion.motion import Sine

TURNS = 3.0
NUMBERS: dict[str, Any] = {
    "speed_rpm": 60.0,
    "reversal_deg": 1080.0,
    "dwell_s": 0.75,
    "ramp_s": 0.5,
    "slow_share": 0.25,
    "stop_s": 0.1,
}

# Corners of the speed, (s, turns/s), of a run to 3 turns at 1 turn/s. A ramp covers 1/4 turn, the
# stop 1/20, one of the slow-down 15/64 in 3/8 s, the slow running 3/16.
CORNERS = {
    "reversal": [
        *[(0, 0), (0.5, 1), (3, 1), (3.5, 0)],
        *[(4.25, 0), (4.75, -1), (7.25, -1), (7.75, 0), (8.5, 0)],
    ],
    "slow_down": [
        *[(0, 0), (0.5, 1), (1.421875, 1), (1.796875, 0.25), (2.546875, 0.25)],
        *[(2.921875, 1), (3.84375, 1), (4.34375, 0), (5.09375, 0)],
    ],
    "aborted": [
        *[(0, 0), (0.5, 1), (1.515625, 1), (1.890625, 0.25), (2.265625, 1), (3.28125, 1)],
        *[(3.78125, 0), (4.53125, 0), (5.03125, -1), (7.53125, -1), (8.03125, 0), (8.78125, 0)],
    ],
    "emergency_stop": [
        *[(0, 0), (0.5, 1), (3.2, 1), (3.3, 0)],
        *[(4.05, 0), (4.55, -1), (7.05, -1), (7.55, 0), (8.3, 0)],
    ],
}
LANDMARKS = {
    "reversal": (3.0, 4.25),
    "slow_down": (1.421875, 5.09375),
    "aborted": (3.28125, 4.53125),
    "emergency_stop": (3.2, 4.05),
}
"""`braking_s` and `turn_s`."""

each_event = pytest.mark.parametrize("event", CORNERS)
each_kind = pytest.mark.parametrize("kind", ["trapezoid", "s_curve"])


def made(kind: Any, event: Any, **numbers: float) -> Any:
    return motion_of(kind, event, **{**NUMBERS, **numbers})


def by_hand(kind: str, event: str, time: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Speed in rad/s and acceleration in rad/s² from the corners."""
    corners, speeds = np.array(CORNERS[event], float).T * [[1.0], [REV]]
    place = np.clip(np.searchsorted(corners, time, side="right") - 1, 0, len(corners) - 2)
    length = np.diff(corners)[place]
    change = np.diff(speeds)[place]
    share = (time - corners[place]) / length
    if kind == "trapezoid":
        return speeds[place] + change * share, change / length
    first = share < 0.5
    rise = np.where(first, 2 * share**2, 1 - 2 * (1 - share) ** 2)
    slope = 4 * np.where(first, share, 1 - share) / length
    return speeds[place] + change * rise, change * slope


def between_corners(event: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Gauss–Legendre times and weights in both halves of every stretch, and the ends of these.

    The quadrature is exact for the pieces.
    """
    corners = np.array(CORNERS[event], float)[:, 0]
    edges = np.sort(np.concatenate([corners, 0.5 * (corners[1:] + corners[:-1])]))
    x, w = np.polynomial.legendre.leggauss(4)
    half = 0.5 * np.diff(edges)[:, None]
    return edges[:-1, None] + half * (1 + x), half * w, edges


@each_kind
@each_event
@pytest.mark.parametrize("sense", [1.0, -1.0])
def test_angle_speed_and_acceleration_are_those_worked_out_by_hand(kind, event, sense):
    """The angle by quadrature that is exact on polynomials of degree 7."""
    motion = made(kind, event, reversal_deg=sense * TURNS * 360)
    time, weight, ends = between_corners(event)
    speed, acceleration = by_hand(kind, event, time)
    inside = at(motion, time)
    np.testing.assert_allclose(inside.speed, sense * speed, atol=1e-12)
    np.testing.assert_allclose(inside.acceleration, sense * acceleration, atol=1e-10)
    angle = sense * np.cumsum(np.sum(weight * speed, axis=1))
    np.testing.assert_allclose(at(motion, ends[1:]).angle, angle, atol=1e-11)
    times = motion.braking_s, motion.turn_s, motion.duration_s
    np.testing.assert_allclose(times, (*LANDMARKS[event], CORNERS[event][-1][0]), atol=1e-13)


positive = st.floats(0.02, 50.0)


@given(
    kind=st.sampled_from(["trapezoid", "s_curve"]),
    event=st.sampled_from(list(CORNERS)),
    speed_rpm=st.floats(0.1, 3000.0),
    times=st.tuples(positive, positive, positive | st.just(0.0), positive | st.just(0.0)),
    share=st.floats(0.01, 0.99),
    sense=st.sampled_from([1.0, -1.0]),
)
def test_every_motion_keeps_its_promises(kind, event, speed_rpm, times, share, sense):
    ramp_s, stop_s, dwell_s, steady_s = times
    rate = speed_rpm * 6.0  # deg/s
    least = max(2 * ramp_s, ramp_s + stop_s) + share * dwell_s
    reversal_deg = sense * rate * (least + steady_s)
    motion = motion_of(kind, event, speed_rpm, reversal_deg, dwell_s, ramp_s, share, stop_s)
    end = float(motion.duration_s)
    braking, turn = float(motion.braking_s), float(motion.turn_s)
    special = [-1.0, end, 2 * end + 1.0, turn, braking + 1e-6 * end]
    point = at(motion, np.concatenate([special, np.linspace(0.0, end, 2000)]))
    there = abs(reversal_deg * DEG)
    final = reversal_deg * DEG if event == "slow_down" else 0.0
    np.testing.assert_allclose(point.angle[:3], [0.0, final, final], rtol=0, atol=1e-13 * there)
    assert not np.any(point.speed[:4]) and not np.any(point.acceleration[:3])

    assert 0 < braking < turn <= end and (turn == end) == (event == "slow_down")
    assert point.angle[3] == pytest.approx(reversal_deg * DEG, rel=1e-13)
    assert point.acceleration[4] * sense < 0

    assert np.all(sense * point.angle >= -1e-13 * there)
    assert np.all(sense * point.angle <= (1 + 1e-13) * there)
    assert np.abs(point.speed).max() <= rate * DEG * (1 + 1e-12)


@each_kind
@each_event
def test_neither_speed_nor_angle_steps_anywhere(kind, event):
    """Not even for one rounding of the time, where one piece hands over to the next."""
    for dwell_s in (0.75, 0.0, 0.1234567):
        motion = made(kind, event, dwell_s=dwell_s, speed_rpm=57.3)
        edges = np.concatenate([motion.start, motion.start + motion.duration])
        ulp = np.spacing(edges)
        times = edges + ulp * np.arange(-4, 5)[:, None]
        point = at(motion, times)
        assert np.ptp(point.speed, axis=0).max() < 1e-11
        assert np.ptp(point.angle, axis=0).max() < 1e-11


@pytest.mark.parametrize("reversal_deg", [720.0, -360.0])
def test_the_sine_against_its_formula(reversal_deg):
    motion = Sine(60.0, reversal_deg)
    size, frequency = reversal_deg * DEG, 60 / 60 * REV / (np.pi * abs(reversal_deg) * DEG)
    time = np.linspace(0.0, 1 / frequency, 400, endpoint=False)
    turn = 2 * np.pi * frequency
    point = at(motion, time)
    np.testing.assert_allclose(point.angle, size * (1 - np.cos(turn * time)) / 2, atol=1e-13)
    np.testing.assert_allclose(point.speed, size * turn * np.sin(turn * time) / 2, atol=1e-13)
    expected = size * turn**2 * np.cos(turn * time) / 2
    np.testing.assert_allclose(point.acceleration, expected, atol=1e-12)
    assert float(np.abs(point.speed).max()) == pytest.approx(REV)  # 60 rpm
    assert motion.duration_s == pytest.approx(1 / frequency)
    ends = at(motion, np.array([motion.braking_s, motion.turn_s]))
    np.testing.assert_allclose(np.abs(ends.speed), [REV, 0.0], atol=1e-12)
    assert ends.angle[1] == pytest.approx(size)
    outside = at(motion, np.array([-1.0, 1 / frequency, 99.0]))
    assert not np.any(outside.speed) and not np.any(outside.acceleration)
    np.testing.assert_allclose(outside.angle, 0.0, atol=1e-13)


# What is refused.

WRONG = [
    ("reversal", "speed_rpm", 0.0),
    ("reversal", "reversal_deg", 0.0),
    ("reversal", "dwell_s", -0.1),
    ("reversal", "ramp_s", 0.0),
    ("emergency_stop", "stop_s", 0.0),
    ("slow_down", "slow_share", 0.0),
    ("aborted", "slow_share", 1.0),
    ("reversal", "speed_rpm", np.nan),
    ("reversal", "ramp_s", np.inf),
    ("sine", "speed_rpm", 0.0),
    ("sine", "reversal_deg", 0.0),
]
LEAST = {
    "reversal": 180.0,
    "slow_down": 360 * (0.5 + 0.46875 + 0.1875),
    "aborted": 360 * (0.5 + 0.46875),
    "emergency_stop": 180.0,
}


@pytest.mark.parametrize(("event", "name", "value"), WRONG)
def test_a_number_out_of_range(event, name, value):
    kind = "sine" if event == "sine" else "trapezoid"
    with pytest.raises(ValueError, match=f"^Argument `{name}`"):
        motion_of(kind, event, **{**NUMBERS, name: value})


@pytest.mark.parametrize("sense", [1.0, -1.0])
@pytest.mark.parametrize("event", LEAST)
def test_a_reversal_inside_the_ramps(event: Any, sense):
    least = LEAST[event]
    numbers = {**NUMBERS, "reversal_deg": sense * least}
    motion = motion_of("trapezoid", event, **numbers)
    assert float(motion.at(motion.turn_s).angle) == pytest.approx(np.deg2rad(sense * least))
    numbers["reversal_deg"] = sense * (least - 0.01)
    with pytest.raises(ValueError, match=rf"^Argument `reversal_deg` must be .* {least:.10g}°"):
        motion_of("trapezoid", event, **numbers)


def test_known_numbers_are_checked_beside_traced_ones():
    def angle(speed_rpm, ramp_s):
        return trapezoid(speed_rpm, 1080.0, 0.5, ramp_s).at(1.0).angle

    assert np.isfinite(jax.jit(angle)(60.0, 0.5))
    with pytest.raises(ValueError, match="`ramp_s`"):
        jax.jit(angle, static_argnums=1)(60.0, 0.0)
