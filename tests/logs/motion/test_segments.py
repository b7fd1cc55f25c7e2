import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.logs.profiles import DEG, counts, flanks, geared, trapezoid
from tests.logs.profiles import of_counts as logged
from vttig_jax.logs.channel.speed import smooth_speed
from vttig_jax.logs.motion.segments import Segments, find_segments, steady


def assert_on_flanks(found: Segments, flank: np.ndarray) -> np.ndarray:
    """Every used sample lies on its flank; returns the flanks of the samples."""
    state = flanks(found)
    np.testing.assert_array_equal(state[state != 0], flank[state != 0])
    return state


def kinds(found: Segments) -> list[str]:
    return [m.kind for m in found.motion if m.stop - m.start > 20]


@pytest.fixture(scope="module")
def paper():
    time, angle, steady_mask = trapezoid()
    driven, flank = geared(angle, noise=0.0005)
    return time, angle, steady_mask, driven, flank


def test_the_paper_profile(paper):
    time, angle, steady_mask, driven, flank = paper
    found = find_segments(logged(time, angle, driven))
    state = assert_on_flanks(found, flank)
    assert kinds(found) == ["forward", "dwell", "backward", "dwell"]
    assert [s.flank for s in found.segments] == ["A", "B"]
    assert found.forward == np.count_nonzero(state == 1)
    assert found.backward == np.count_nonzero(state == -1)
    assert found.read == found.forward + found.backward + found.masked == len(time)
    # No used sample lies on a ramp, and hardly a steady one is lost.
    assert steady_mask[state != 0].all()
    assert np.count_nonzero(state) > 0.985 * np.count_nonzero(steady_mask)
    assert [round(s.speed / DEG) for s in found.segments] == [360, -360]
    assert found.notes == ()
    assert [m.start for m in found.motion[1:]] == [m.stop for m in found.motion[:-1]]
    assert found.motion[0].start == 0 and found.motion[-1].stop == len(time)
    forward = next(m for m in found.motion if m.kind == "forward")
    assert forward.speed / DEG == pytest.approx(7560 / 21.5, rel=0.01)


def test_nineteen_reversals():
    time, angle, steady_mask = trapezoid(rate=500.0, reversal=720.0, dwell=0.4, passes=20)
    driven, flank = geared(angle)
    found = find_segments(logged(time, angle, driven))
    state = assert_on_flanks(found, flank)
    assert [s.flank for s in found.segments] == ["A", "B"] * 10
    assert steady_mask[state != 0].all() and found.forward > 0.9 * steady_mask.sum() / 2


@pytest.mark.parametrize("ramp", [0.02, 0.5])
def test_no_dwell_between_the_directions(ramp):
    time, angle, _ = trapezoid(rate=1000.0, reversal=1440.0, dwell=0.0, ramp=ramp)
    driven, flank = geared(angle, gap=0.3)
    state = assert_on_flanks(find_segments(logged(time, angle, driven)), flank)
    assert {1, -1} <= set(state.tolist())


def test_first_degree_after_an_abrupt_reversal_is_masked():
    time = np.arange(4000) / 1000.0
    angle = 100 * np.abs(time - 2.0)  # turns within one sample, 0.1° a sample
    state = flanks(find_segments(logged(time, angle)))
    after = np.flatnonzero(state == 1)[0]
    assert angle[after] >= 1.0 and angle[after] < 2.5


@given(st.floats(0.3, 200.0), st.integers(0, 5))
def test_slow_and_fast(rpm, seed):
    """From a tenth of a count to tens of counts a sample, with ripple and a noisy encoder."""
    time, angle, _ = trapezoid(rate=200.0, rpm=rpm, reversal=144 * rpm, ramp=1.0, dwell=6.0)
    noisy = angle + 0.002 * np.random.default_rng(seed).standard_normal(len(angle))
    found = find_segments(logged(time, noisy))
    state = assert_on_flanks(found, geared(angle)[1])
    assert [s.flank for s in found.segments] == ["A", "B"]
    assert np.count_nonzero(state) > 0.6 * len(time)


def test_two_speeds_in_one_direction_are_two_plateaus():
    time = np.arange(20_000) / 1000.0
    speed = np.interp(time, [0, 1, 9, 10, 20], [0, 60, 60, 180, 180])
    angle = np.cumsum(speed) / 1000.0
    found = find_segments(logged(time, angle))
    assert [round(s.speed / DEG) for s in found.segments] == [60, 180]
    assert abs(found.segments[0].stop - 9000) < 100 and abs(found.segments[1].start - 10_000) < 100


@pytest.mark.parametrize("cycles", [5, 150])
def test_two_speeds_in_turn_are_steady_however_long_the_log_is(cycles: int):
    time = np.arange(cycles * 400) / 100.0
    angle = np.cumsum(np.where(np.arange(len(time)) % 400 < 200, 0.6, 1.8))
    found = find_segments(logged(time, angle))
    assert [s.flank for s in found.segments] == ["A"] * 2 * cycles
    assert np.count_nonzero(flanks(found)) > 0.8 * len(time)


def test_sine_motion_is_ragged():
    time = np.arange(8000) / 500.0
    angle = 900 * (1 - np.cos(2 * np.pi * time / 8))
    driven, flank = geared(angle)
    found = find_segments(logged(time, angle, driven))
    state = assert_on_flanks(found, flank)
    assert "no steady speed in 4 of 4 runs" in found.notes[0]
    speed = np.abs(np.gradient(angle, time))
    assert speed[state != 0].min() > 0.095 * speed.max()
    assert np.count_nonzero(state) > 0.9 * np.count_nonzero(speed > 0.1 * speed.max())


def test_a_sine_of_rising_frequency_is_followed():
    """A window that is right at its start would span several of its last periods."""
    time = np.arange(9000) / 75.0
    periods = 0.4 * time + 1.5 / 120 * time**2  # 0.4 to 3.4 Hz
    angle = 2500 / (1 + time / 5) * np.sin(2 * np.pi * periods)
    noise = np.random.default_rng(0).normal(0, 0.2, len(time))
    found = find_segments(logged(time, angle + noise))
    state, forward = flanks(found), np.sign(np.gradient(angle))
    used = state != 0
    assert used.mean() > 0.6
    assert (state[used] == forward[used]).mean() > 0.99


def test_one_direction_all_the_way_and_a_gap_in_time():
    time = np.arange(5000) / 500.0
    paused = time + 1.0 * (np.arange(5000) >= 2000)
    for angle, stamps, seen in (
        (360 * time, time, [(0, 5000, "A")]),
        (-360 * time, time, [(0, 5000, "B")]),
        (360 * paused, paused, [(0, 2000, "A"), (2000, 5000, "A")]),
    ):
        found = find_segments(logged(stamps, angle))
        assert [(s.start, s.stop, s.flank) for s in found.segments] == seen


def test_direction_column_wins(paper):
    time, angle, *_ = paper
    direction = np.sign(np.gradient(angle))
    direction[:20_000] = 0
    found = find_segments(logged(time, angle, direction=-direction))
    state = flanks(found)
    assert [s.flank for s in found.segments] == ["B", "A"]
    assert not state[:20_000].any() and "direction column" in found.notes[0]
    plain = flanks(find_segments(logged(time, angle)))
    np.testing.assert_array_equal(state[25_000:], -plain[25_000:])


def test_torque_column_decides(paper):
    time, angle, *_ = paper
    speed = np.gradient(angle, time)
    torque = np.where(np.abs(speed) > 1, 2.0, 0.05)  # one flank in both directions
    torque[30_000:31_000] = -0.09  # weak: below 5 % of the usual torque
    found = find_segments(logged(time, angle, torque=torque))
    state = flanks(found)
    assert {s.flank for s in found.segments} == {"A"} and "torque column" in found.notes[0]
    assert not state[30_000:31_000].any()
    plain = flanks(find_segments(logged(time, angle)))
    assert np.count_nonzero(state) > np.count_nonzero(plain) - 1000  # ramps count now
    both = find_segments(logged(time, angle, torque=torque, direction=np.sign(speed)))
    assert {s.flank for s in both.segments} == {"A"} and both.forward < found.forward
    assert "direction and the torque" in both.notes[0]


def test_torque_that_turns_over_masks_the_crossing():
    time = np.arange(4000) / 1000.0
    torque = np.where(time < 2.0, 1.0, -1.0)
    found = find_segments(logged(time, 50 * time, torque=torque))
    assert [s.flank for s in found.segments] == ["A", "B"]
    assert 50 * time[found.segments[1].start] == pytest.approx(101.0, abs=0.1)


def test_samples_between_turns_of_a_dithering_dwell_are_no_motion():
    time, angle, _ = trapezoid(rate=500.0, reversal=1800.0, dwell=3.0)
    dither = angle + 0.004 * (np.arange(len(time)) % 7 < 3)
    assert kinds(find_segments(logged(time, dither))) == ["forward", "dwell", "backward", "dwell"]


def test_speed_is_free_of_counts():
    time = np.arange(20_000) / 2000.0
    angle = counts(6.0 * time) * (360 / 90_000) * DEG  # 0.75 counts a sample
    speed = smooth_speed(time, angle, 360 / 90_000 * DEG)
    np.testing.assert_allclose(speed.value[500:-500] / DEG, 6.0, rtol=0.02)
    assert speed.window > 100 and speed.dwell < 0.1 * 6 * DEG
    fine = smooth_speed(time, 6.0 * time * DEG, 1e-9)
    assert fine.window == 2
    noise = 1e-4 * np.random.default_rng(0).standard_normal(len(time))
    assert smooth_speed(time, 6.0 * time * DEG + noise, 1e-9).window > 50


def test_steady_leaves_out_the_rest_of_a_ramp():
    speed = np.concatenate([np.linspace(1, 100, 1000), np.full(1000, 100.0)])
    ((start, stop),) = steady(speed, 100.0, 0.03, 10)
    assert start > 1000 and stop == 2000
    ((wide, _),) = steady(speed, 100.0, 0.05, 10)
    assert wide < start
    ((later, _),) = steady(speed, 100.0, 0.03, 100)
    assert later > start
    assert steady(speed, 300.0, 0.03, 10) == []
