import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import lfilter

from tests.logs.profiles import (
    counts,
    drive,
    geared,
    late,
    of_counts,
    of_degrees,
    spec,
    trapezoid,
)
from vttig_jax.base.errors import LogError
from vttig_jax.logs.checks.slip import Slip, find_slips, refuse_slip
from vttig_jax.logs.encoder_log import EncoderLog
from vttig_jax.logs.inspection import inspect_log
from vttig_jax.logs.motion.segments import find_segments

RATE = 250.0


def rig(slip=0.0, at=0.0, length=0.0, share=0.0, delay=0.0, **motion):
    """A log whose driven encoder slips by `slip` degrees within `length` s, from `at` s on."""
    options = {"reversal": 2160.0, "dwell": 0.5, "passes": 3, **motion}
    time, angle, _ = trapezoid(rate=RATE, **options)
    driven = np.interp(time - delay, time, geared(angle, noise=0.002)[0])
    driven = driven + slip * np.clip((time - at) / max(length, 1e-9), 0, 1)
    if share:
        driven, _ = late(time, driven, share=share)
    return of_counts(time, angle, driven)


def slips_of(log) -> tuple[Slip, ...]:
    return find_slips(log, find_segments(log))


def found(log) -> Slip | None:
    """The largest slip."""
    return max(slips_of(log), key=lambda slip: abs(slip.size_deg), default=None)


@pytest.mark.parametrize(
    "options",
    [
        {"delay": 3e-3},
        {"share": 0.1},
        {"share": 0.1, "delay": 3e-3},
        {"passes": 16, "reversal": 400.0, "dwell": 0.1, "ramp": 0.1},
        {"passes": 1},
        {"reversal": 300.0},
        {"reversal": 200.0, "passes": 1},
        {"ripple": 0.05},
        {"slip": 0.1, "at": 6.7, "passes": 2},  # at the only reversal, where the gap is crossed
    ],
)
def test_silent_without_a_slip(options):
    assert found(rig(**options)) is None


@pytest.mark.slow
@settings(max_examples=25)
@given(
    st.sampled_from([0.1, -0.1, 0.03, -0.5]),
    st.sampled_from([1.7, 3.3, 9.1, 12.8, 17.0]),
    st.sampled_from([0.0, 0.03]),
    st.sampled_from([0.0, 0.1]),
)
def test_a_slip_is_found(slip, at, length, share):
    seen = found(rig(slip, at, length, share))
    assert seen is not None
    assert seen.size_deg == pytest.approx(slip, rel=0.15, abs=0.015)
    assert at - 0.06 <= seen.time_s <= at + length + 0.06
    assert 0 < seen.std_deg < 0.2 * abs(slip)


def test_a_slip_is_found_and_told():
    log = rig(0.1, 9.1, passes=2)
    seen = found(log)
    assert seen is not None and seen.size_deg == pytest.approx(0.1, abs=0.005)
    assert seen.time_s == pytest.approx(9.1, abs=0.06) and 0 < seen.std_deg < 0.02
    with pytest.raises(LogError) as caught:
        refuse_slip(log, find_segments(log))
    text = str(caught.value)
    for words in ("steps by 0.", "° at 9.", "stays", "an encoder slipped", "cut the log at"):
        assert words in text, text
    assert "sample 22" in str(caught.value.where)
    assert any("steps by 0." in note for note in inspect_log(log).notes)
    clean = rig(passes=2)
    refuse_slip(clean, find_segments(clean))
    assert not any("steps by" in note for note in inspect_log(clean).notes)
    still = find_segments(log)
    assert find_slips(log, type(still)((), (), still.read)) == ()


@pytest.mark.slow
@pytest.mark.parametrize("count", [2, 4, 6, 9])
def test_slips_do_not_hide_each_other(count):
    """An encoder that loses 0.05° again and again: place and size of every loss are told."""
    log = rig(passes=6)
    inside = np.concatenate([np.arange(s.start, s.stop) for s in find_segments(log).segments])
    at = log.time[inside[len(inside) * (10 * np.arange(count) + 4) // (10 * count)]]
    lost = -0.05 * (log.time[:, None] > at).sum(axis=1)
    driven = geared(np.degrees(log.driving_angle), noise=0.002)[0] + lost
    log = EncoderLog.from_arrays(log.time, log.driving.reading, counts(driven), pair=spec())
    seen = slips_of(log)
    assert [slip.time_s for slip in seen] == pytest.approx(at.tolist(), abs=0.2)
    assert [slip.size_deg for slip in seen] == pytest.approx([-0.05] * count, abs=0.005)
    with pytest.raises(LogError) as caught:
        refuse_slip(log, find_segments(log))
    assert all(f"at {slip.time_s:.6g} s" in str(caught.value) for slip in seen)


@pytest.mark.slow
def test_slips_of_both_shafts_and_two_in_a_row():
    time, angle, _ = trapezoid(rate=RATE, reversal=2160.0, passes=3)
    driven = geared(angle)[0]
    for second in (0.1, -0.1, 0.3):
        twice = driven + 0.1 * (time > 4.0) + second * (time > 10.5)
        assert found(of_degrees(time, angle, twice)) is not None
    seen = found(of_degrees(time, angle + 0.2 * (time > 4.0), driven))
    assert seen is not None and seen.size_deg == pytest.approx(-0.2 * 45 / 80, abs=0.01)


def test_changes_that_are_not_sharp_or_have_another_cause_are_none():
    time, angle, _ = trapezoid(rate=RATE, reversal=4320.0, passes=1)
    for change in (
        0.2 * (1 - np.exp(-time / 3.0)),  # warming up
        0.1 * np.tanh((time - 6.0) / 2.0),
        0.05 * np.sin(0.3 * np.radians(angle)),
    ):
        driven = geared(angle, noise=0.001)[0] + change
        assert found(of_degrees(time, angle, driven)) is None
    # Slow, then fast for good: the load changed.
    time = np.arange(8000) / RATE
    angle = np.where(time < 10.0, 200.0 * time, 2000.0 + 400.0 * (time - 10.0))
    assert found(of_degrees(time, angle, geared(angle)[0] + 0.1 * (time > 10.0))) is None


def test_a_delay_that_steps_is_no_slip():
    """Two speeds both ways: the error of each changes by its own speed times the step."""
    time, angle, _ = trapezoid(rate=RATE, reversal=2160.0, dwell=0.5, passes=4)
    time, angle = np.append(time, time[-1] + 0.01 + 0.5 * time), np.append(angle, angle)
    driven, _ = geared(angle, noise=0.002)
    step = np.where(time % (time[-1] / 3) < time[-1] / 6, 4e-4, 9e-4)
    assert found(of_degrees(time, angle, driven - np.gradient(driven, time) * step)) is None


NOISE = 0.03
"""Standard deviation in degrees of noise that is correlated over a quarter of a turn."""


def coloured(seed, slip=0.0, off=0.0):
    """A log of three turns each way: a slip at 2 s, and a ratio that is off by the share `off`."""
    time, angle, _ = trapezoid(rate=RATE, reversal=1080.0, dwell=0.5)
    driven, _ = geared(angle, ratio=9 / 16 * (1 + off))
    memory = np.exp(-4 / RATE)  # one turn takes a second
    innovation = np.random.default_rng(seed).standard_normal(len(time) + 2000)
    noise = NOISE * np.sqrt(1 - memory**2) * np.asarray(lfilter([1.0], [1.0, -memory], innovation))
    return of_degrees(time, angle, driven + noise[2000:] + slip * (time >= 2.0), drive("9/16"))


@pytest.mark.parametrize("off", [0.003, 0.0])
def test_coloured_noise_is_no_slip(off):
    """No slip is claimed, whether the given ratio is exact or 0.3 % off."""
    assert [found(coloured(seed, off=off)) for seed in range(4)] == [None] * 4


@pytest.mark.parametrize(("seed", "sign"), [(0, 1), (3, -1)])
def test_a_slip_above_coloured_noise_is_found(seed, sign):
    """A step of eight times the noise is found within 0.1 s, with its size up to two noises."""
    seen = found(coloured(seed, sign * 8 * NOISE))
    assert seen is not None
    assert seen.time_s == pytest.approx(2.0, abs=0.1)
    assert seen.size_deg == pytest.approx(sign * 8 * NOISE, abs=2 * NOISE)
