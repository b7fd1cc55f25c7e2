"""What the fit sees of a log: shifted angles and the columns beside the harmonics."""

from dataclasses import replace
from fractions import Fraction

import equinox as eqx
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vttig_jax.base.errors import UsageError
from vttig_jax.base.units import DEG
from vttig_jax.identify.compress.regressors import (
    TORQUE_WINDOWS_S,
    Drift,
    Regressors,
    read_channels,
    shifted,
    torque_column,
    trimmed,
)
from vttig_jax.identify.model.column_layout import is_shared
from vttig_jax.logs.encoder_log import EncoderLog
from vttig_jax.logs.motion.segments import Segment
from vttig_jax.pair.gear_pair import Drive

pytestmark = pytest.mark.smoke

DRIVE = Drive(Fraction(1, 2))
RATE = 500.0


def _own(channels: Regressors) -> dict[str, np.ndarray]:
    """The own columns with the values of all samples."""
    return {name: column[:] for name, column in channels.own.items()}


def _angle(time: np.ndarray) -> np.ndarray:
    """5 rad/s and two waves of it, rad."""
    return 5.0 * time + 0.3 * np.sin(7 * time) + 0.1 * np.sin(20 * time)


def _log(time: np.ndarray, driving: np.ndarray | None = None, **columns) -> EncoderLog:
    driving = _angle(time) if driving is None else driving
    driven = 0.5 * driving + 1e-3 * np.sin(driving)
    return EncoderLog.from_arrays(time, driving, driven, pair=DRIVE, unit="rad", **columns)


def _even(seconds: float = 20.0) -> np.ndarray:
    return np.arange(int(seconds * RATE)) / RATE


def _jittered(seed: int = 0) -> np.ndarray:
    time = _even()
    return time + np.random.default_rng(seed).uniform(0, 0.8 / RATE, len(time))


def _inside(log: EncoderLog, delay_s: float) -> np.ndarray:
    """Samples whose shifted instant lies inside the log."""
    at = log.time - delay_s
    return (at >= log.time[2]) & (at <= log.time[-3])


@pytest.mark.parametrize("delay_s", [3e-3, -2e-3, 0.1, 0.0004])
@pytest.mark.parametrize("kind", ["even", "jittered"])
def test_shifted_is_the_angle_at_an_earlier_instant(kind, delay_s):
    time = _even() if kind == "even" else _jittered()
    log = _log(time)
    start = _angle(time[:1])
    found, inside = shifted(log, delay_s), _inside(log, delay_s)
    expected = _angle(time - delay_s) - start
    assert np.abs(found - expected)[inside].max() < 2e-6
    # The wrong sign, and no shift at all, are far off.
    assert np.abs(found - (_angle(time + delay_s) - start))[inside].min() > 1e-4
    assert np.abs(found - log.driving_angle)[inside].min() > 1e-4


def test_no_delay_touches_nothing():
    log = _log(_jittered())
    assert shifted(log, 0.0) is log.driving_angle


def test_shifted_past_the_ends_stands_still():
    log = _log(_even())
    late, early = shifted(log, 1.0), shifted(log, -1.0)
    np.testing.assert_allclose(late[:500], log.driving_angle[0], atol=1e-12)
    np.testing.assert_allclose(early[-500:], log.driving_angle[-1], atol=1e-12)


def test_duplicated_stamps_are_no_trouble():
    """Two samples with one stamp: the first counts."""
    time = _even()
    time[5::13] = time[4::13][: len(time[5::13])]
    log = _log(time)
    found, inside = shifted(log, 3e-3), _inside(log, 3e-3)
    assert np.isfinite(found).all()
    assert np.abs(found - (_angle(time - 3e-3) - _angle(time[:1])))[inside].max() < 1e-5


def test_spikes_are_bridged():
    """A cubic through a spike of 0.5 rad would ring into its neighbours."""
    time = _even()
    wild = np.arange(101, len(time) - 100, 97)
    driving = _angle(time)
    driving[wild] += 0.5
    log = _log(time, driving)
    assert log.driving.spikes is not None and log.driving.spikes[wild].all()
    off = np.abs(shifted(log, 3e-3) - (_angle(time - 3e-3) - _angle(time[:1])))
    assert off[_inside(log, 3e-3)].max() < 1e-4
    ringing = shifted(replace(log, driving=replace(log.driving, spikes=None)), 3e-3)
    assert np.abs(ringing - (_angle(time - 3e-3) - _angle(time[:1]))).max() > 0.2


def _with_late_reading() -> tuple[EncoderLog, int, np.ndarray]:
    """One reading too far by 0.01 rad, which is no spike, with the weight 0."""
    time, late = _even(), 5000
    driving, weight = _angle(time), np.ones(len(time))
    driving[late] += 0.01
    weight[late] = 0.0
    log = _log(time, driving)
    return replace(log, driving=replace(log.driving, spikes=None)), late, weight


def test_a_late_reading_moves_no_other():
    log, late, weight = _with_late_reading()
    expected = _angle(log.time - 3e-4) - _angle(log.time[:1])
    off = shifted(log, 3e-4, weight) - expected
    assert off[late] == pytest.approx(0.01, rel=1e-3)
    near = np.r_[late - 3 : late, late + 1 : late + 4]
    assert np.abs(off[near]).max() < 2e-6
    assert np.abs((shifted(log, 3e-4) - expected)[near]).max() > 1e-4


def test_a_late_reading_shows_no_speed():
    log, late, weight = _with_late_reading()
    near = slice(late - 3, late + 4)
    for weights, seen in ((weight, False), (None, True)):
        column = _own(read_channels(log, DRIVE, ("delay",), Drift(), 3e-4, weights))["delay"]
        speed = np.gradient(_angle(log.time), log.time)
        assert (np.abs(column + 0.5 * speed)[near].max() > 0.05) == seen


def test_the_error_is_that_of_the_shifted_angle():
    log = _log(_even())
    channels = read_channels(log, DRIVE, (), Drift(), 3e-3)
    np.testing.assert_array_equal(channels.driving, shifted(log, 3e-3))
    for flank in ("A", "B"):
        error = log.driven_angle - 0.5 * channels.driving
        np.testing.assert_allclose(channels.error[flank], error, atol=1e-12)
    assert np.abs(channels.error["A"] - log.transmission_error).max() > 1e-3
    assert channels.sample_s == pytest.approx(1 / RATE)
    assert channels.own == {} and channels.weight is None


def test_powers_of_the_scaled_time():
    log = _log(_jittered())
    own = _own(read_channels(log, DRIVE, (), Drift(3)))
    assert list(own) == ["drift_1", "drift_2", "drift_3"] == list(Drift(3).names(99.0))
    scaled = own["drift_1"]
    assert (scaled[0], scaled[-1]) == pytest.approx((-1.0, 1.0))
    assert np.corrcoef(scaled, log.time)[0, 1] == pytest.approx(1.0)
    for power in (2, 3):
        np.testing.assert_allclose(own[f"drift_{power}"], scaled**power)


@pytest.mark.parametrize(("knots_s", "pieces"), [(5.0, 4), (6.0, 3), (100.0, 1), (20.0, 1)])
def test_splines_are_all_but_one_of_a_partition_of_unity(knots_s, pieces):
    """With ones they span the cubics; the offset is not among them."""
    log = _log(_even(20.0))
    drift = Drift(knots_s=knots_s)
    own = _own(read_channels(log, DRIVE, (), drift))
    assert tuple(own) == drift.names(float(np.ptp(log.time)))
    assert len(own) == pieces + 2
    matrix = np.stack(list(own.values()), axis=1)
    assert matrix.min() >= 0 and matrix.sum(axis=1).max() <= 1 + 1e-12
    # The one left out is all that is missing at the start, and nothing at the end.
    missing = 1 - matrix.sum(axis=1)
    assert missing[0] == pytest.approx(1 / 6)
    np.testing.assert_allclose(missing[log.time > 20.0 / pieces + 0.01], 0.0, atol=1e-12)
    with_ones = np.column_stack([np.ones(len(log)), matrix])
    assert np.linalg.matrix_rank(with_ones) == pieces + 3
    for power in range(4):
        cubic = (log.time / 20) ** power
        left = cubic - with_ones @ np.linalg.lstsq(with_ones, cubic, rcond=None)[0]
        assert np.abs(left).max() < 1e-9
    # A whole basis and ones would be one column too many.
    whole = np.column_stack([with_ones, missing])
    assert np.linalg.matrix_rank(whole) == pieces + 3


@given(order=st.integers(0, 6), knots_s=st.floats(0.1, 100.0), duration_s=st.floats(1.0, 1000.0))
def test_stiffness_is_two_extremes_a_piece(order, knots_s, duration_s):
    powers, splines = Drift(order), Drift(knots_s=knots_s)
    expected = 2 * duration_s / order if order else None
    assert powers.stiffness_s(duration_s) == expected
    pieces = len(splines.names(duration_s)) - 2
    assert splines.stiffness_s(duration_s) == pytest.approx(2 * duration_s / pieces)
    assert abs(duration_s / pieces - knots_s) <= max(0.51 * knots_s, knots_s - duration_s)


def test_windows_of_the_torque():
    """Averages of at least three samples and at most a twentieth of the log."""
    time = np.arange(4000) / 250.0
    torque = np.sin(time) + 2.0
    own = _own(read_channels(_log(time, torque=torque), DRIVE, ("torque",), Drift()))
    fitting = [k for k, s in enumerate(TORQUE_WINDOWS_S) if s == 0 or 3 / 250 <= s < 16 / 20]
    assert list(own) == [torque_column(k) for k in fitting]
    np.testing.assert_allclose(own["torque_0"], torque)
    window = round(TORQUE_WINDOWS_S[3] * 250)
    expected = np.convolve(torque, np.ones(window) / window, "same")
    np.testing.assert_allclose(own["torque_3"][100:-100], expected[100:-100], atol=1e-9)
    short = read_channels(_log(time[:1250], torque=torque[:1250]), DRIVE, ("torque",), Drift())
    assert list(short.own) == [torque_column(k) for k in (0, 1, 2, 3)]


def test_a_torque_that_was_not_logged_is_refused():
    with pytest.raises(UsageError, match="no torque column; name it with --column"):
        read_channels(_log(_even()), DRIVE, ("torque",), Drift())


def test_columns_of_motion_are_those_of_the_driven_shaft():
    time = _even()
    own = _own(
        read_channels(_log(time), DRIVE, ("speed", "acceleration", "delay", "ratio"), Drift())
    )
    speed = 5.0 + 2.1 * np.cos(7 * time) + 2.0 * np.cos(20 * time)
    acceleration = -14.7 * np.sin(7 * time) - 40 * np.sin(20 * time)
    inner = slice(50, -50)
    np.testing.assert_allclose(own["speed"][inner], 0.5 * speed[inner], atol=0.02)
    np.testing.assert_allclose(own["delay"], -own["speed"])
    np.testing.assert_allclose(own["acceleration"][inner], 0.5 * acceleration[inner], atol=0.5)
    angle = _angle(time)
    np.testing.assert_allclose(own["ratio"], angle - angle.mean(), atol=1e-9)


def test_logged_speed_and_acceleration_win():
    time = _even()
    log = _log(time, speed=np.full(len(time), 4.0), acceleration=np.full(len(time), 3.0))
    own = _own(read_channels(log, DRIVE, ("speed", "acceleration", "delay"), Drift()))
    np.testing.assert_array_equal(own["speed"], 2.0)
    np.testing.assert_array_equal(own["acceleration"], 1.5)
    # A delay acts on the angle that was read, whatever a speed column says.
    assert np.ptp(own["delay"]) > 1.0


def test_shared_are_those_of_the_rig_and_not_of_the_day():
    assert all(is_shared(n) for n in ("delay", "ratio", "torque_3", "acceleration", "speed"))
    assert not any(is_shared(n) for n in ("offset", "drift_1", "spline_2"))


@pytest.mark.parametrize(
    ("delay_s", "start", "stop"),
    [(0.0, 100, 900), (3e-3, 102, 900), (-3e-3, 100, 898), (4e-3, 102, 900)],
)
def test_trimmed_leaves_what_looks_beyond_the_segment(delay_s, start, stop):
    channels = read_channels(_log(_even()), DRIVE, (), Drift(), delay_s)
    found = trimmed(Segment(100, 900, "B", -2.0), channels)
    assert found == Segment(start, stop, "B", -2.0)
    tiny = trimmed(Segment(100, 101, "B", -2.0), channels)
    assert tiny.stop - tiny.start == (1 if delay_s == 0 else 0)


def test_an_axial_position_moves_each_flank_by_its_own_taper(paper_pair):
    tapered = eqx.tree_at(
        lambda p: (p.driving.helix_right_deg, p.driven.helix_right_deg),
        paper_pair,
        (np.asarray(2.0), np.asarray(2.0)),
    )
    time = _even()
    driving = _angle(time)
    log = EncoderLog.from_arrays(
        time, driving, 0.5625 * driving, pair=tapered, unit="rad", axial_mm=np.full(len(time), 0.4)
    )
    error = read_channels(log, tapered, (), Drift()).error
    left, right = np.tan(3 * DEG), np.tan(2 * DEG)
    moved = {flank: log.transmission_error - error[flank] for flank in ("A", "B")}
    np.testing.assert_allclose(moved["A"], 0.4 * left / 80, rtol=2e-3)
    np.testing.assert_allclose(moved["B"], -0.4 * right / 80, rtol=2e-3)
