"""Recorded motions against SciPy's spline and the motions they record; the file they come from."""

import jax
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.interpolate import CubicSpline

from tests.control.parts import EVENTS, at, motion_of
from vttig_jax.base.errors import InputError
from vttig_jax.base.units import ARCSEC, DEG
from vttig_jax.control.motion.recorded import read_motion, recorded

NUMBERS = (60.0, 1080.0, 0.75, 0.5, 0.25, 0.1)


def rows_of(kind, event, *, rate_hz=1000.0, count=0.0, numbers=NUMBERS):
    motion = motion_of(kind, event, *numbers)
    time = np.arange(0.0, float(motion.duration_s), 1 / rate_hz)
    angle = np.asarray(at(motion, time).angle)
    return motion, time, np.round(angle / count) * count if count else angle


def test_value_and_derivatives_are_those_of_scipy():
    draw = np.random.default_rng(0)
    rows = np.cumsum(draw.uniform(0.1, 1.0, 30))
    angle = 100 * draw.normal(size=30)
    motion = recorded(rows, angle)
    spline = CubicSpline(rows - rows[0], angle, bc_type="clamped")
    time = np.concatenate([np.linspace(0, rows[-1] - rows[0], 500)[1:-1], motion.knots[1:-1]])
    for order, found in enumerate(jax.tree.leaves(at(motion, time))):
        np.testing.assert_allclose(found, spline(time, order), rtol=1e-10, atol=1e-9)
    knots = at(motion, np.asarray(motion.knots))
    np.testing.assert_allclose(knots.angle, angle, rtol=1e-12)
    outside = at(motion, np.array([-1.0, rows[-1] - rows[0], 1e3]))
    np.testing.assert_allclose(outside.angle, angle[[0, -1, -1]], rtol=1e-12)
    assert not np.any(outside.speed) and not np.any(outside.acceleration)


@pytest.mark.parametrize(
    ("kind", "count", "sense"),
    [("trapezoid", 14.4 * ARCSEC, 1.0), ("s_curve", 14.4 * ARCSEC, -1.0), ("s_curve", 0.0, 1.0)],
)
@pytest.mark.parametrize("event", EVENTS)
def test_braking_and_turn_are_found(kind, event, sense, count):
    numbers = (60.0, sense * 1080.0, *NUMBERS[2:])
    motion, time, angle = rows_of(kind, event, count=count, numbers=numbers)
    found = recorded(5.0 + time, angle)
    # A tenth of the ramp on an S-curve, which brakes gently; the first count of the way back.
    assert float(found.braking_s) == pytest.approx(float(motion.braking_s), abs=0.055)
    assert float(found.turn_s) == pytest.approx(float(motion.turn_s), abs=0.015 if count else 2e-3)
    assert float(found.braking_s) < float(found.turn_s)


def test_braking_and_turn_of_a_sine_and_of_three_rows():
    motion, time, angle = rows_of("sine", "reversal")
    found = recorded(time, angle)
    assert float(found.turn_s) == pytest.approx(float(motion.turn_s), abs=1e-3)
    early = np.arccos(0.98) / (2 * np.pi) * float(motion.duration_s)
    expected = float(motion.braking_s) + early
    assert float(found.braking_s) == pytest.approx(expected, rel=1e-2)
    triangle = recorded(np.array([1.0, 2.0, 4.0]), np.array([0.0, -3.0, 1.0]))
    assert triangle.turn_s == 1.0 and triangle.duration_s == 3.0
    assert 0 < triangle.braking_s < 1


def test_the_first_of_several_turns_counts_and_play_does_not():
    time = np.arange(9.0)
    angle = np.array([0.0, -0.4, 50.0, 49.7, 100.0, 100.0, 40.0, 101.0, 0.0])
    assert recorded(time, angle).turn_s == 5.0
    angle[3] = 40.0
    assert recorded(time, angle).turn_s == 2.0
    assert recorded(time[:5], angle[[0, 1, 2, 4, 7]]).turn_s == 4.0


@given(
    steps=st.lists(st.tuples(st.floats(1e-3, 2.0), st.floats(-50.0, 50.0)), min_size=6, max_size=6)
)
def test_any_recording_has_ordered_times_and_stays_finite(steps):
    gaps, angles = np.array([(0.5, 0.0), *steps]).T
    if np.ptp(angles) < 1e-6:
        return
    motion = recorded(np.cumsum(gaps), angles)
    end = float(motion.duration_s)
    assert 0 <= float(motion.braking_s) <= float(motion.turn_s) <= end
    point = motion.at(np.array([-1.0, 0.0, 0.3 * end, end, 2 * end]))
    assert np.all(np.isfinite(jax.tree.leaves(point)))
    assert not np.any(np.asarray(point.speed)[[0, 1, 3, 4]])
    assert float(point.angle[3]) == pytest.approx(angles[-1], abs=1e-9)


@pytest.mark.parametrize(
    ("time", "angle", "words"),
    [
        ([0.0], [1.0], "`time` must have two rows or more, but has 1"),
        ([0.0, 1.0, 1.0], [0.0, 1.0, 2.0], "`time` must increase, but goes from 1 to 1 s in row 2"),
        ([0.0, np.inf], [0.0, 1.0], "`time` must be finite, but is inf in row 1"),
        ([0.0, 1.0], [2.0, 2.0], "`driving_angle` must change, but the shaft never moves"),
    ],
)
def test_rows_that_are_no_motion(time, angle, words):
    with pytest.raises(ValueError, match=f"Argument {words}"):
        recorded(np.array(time), np.array(angle))


GOOD = "# a remark\n\ntime_s, driving_deg ,torque\n10,0,1\n10.5,90,\n\n11,0,2\n"


def test_a_file_is_read(tmp_path):
    path = tmp_path / "motion.csv"
    path.write_bytes(GOOD.replace("\n", "\r\n").encode("utf-16"))
    motion = read_motion(path)
    assert motion.duration_s == 1.0 and motion.turn_s == 0.5
    np.testing.assert_allclose(motion.at(motion.knots).angle / DEG, [0.0, 90.0, 0.0], atol=1e-12)


HEAD = "time_s,driving_deg\n"
CURE = "write the header time_s,driving_deg"


@pytest.mark.parametrize(
    ("text", "where", "words"),
    [
        ("", "", "the file is empty"),
        ("time_s;driving_deg\n0;0\n", "", f"there is no table; {CURE}"),
        ("\ntime,driving_deg\n0,0\n", "", f"0 columns `time_s` .*has time, driving_deg.*; {CURE}"),
        ("time_s,time_s,driving_deg\n0,0,0\n", "", f"2 columns `time_s` .*; {CURE}"),
        (HEAD + "0,0\n", "", "the file has one row; a motion needs two or more"),
        (HEAD + "0,0\n1,5,2\n", ": line 3", "3 fields, but the header has 2; .* decimal point"),
        (HEAD + "0,0\n1\n", ": line 3", "driving_deg is empty; write a number"),
        (HEAD + "0,0\n1,nan\n", ": line 3", "driving_deg is `nan`; write a number"),
        (HEAD + "0,0\n1_0,1\n", ": line 3, column `time_s`", "`1_0` is no number; correct it"),
        (HEAD + "0,0\n1,1e300\n", ": line 3", "driving_deg is `1e300`; write a number up to 1e"),
        (HEAD + "0,0\n1,1\n\n1,2\n", ": line 5", "time_s goes from 1.0 to 1.0; .* sort the file"),
        (HEAD + "0,7\n1,7\n", "", "driving_deg is 7 in every row; a motion must move"),
    ],
)
def test_what_is_wrong_with_a_file(tmp_path, text, where, words):
    path = tmp_path / "motion.csv"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=words) as caught:
        read_motion(path)
    assert caught.value.where == f"{path}{where}"
