"""Steady stretches of a run whose speed fluctuates."""

import numpy as np
import pytest

from tests.logs.profiles import DEG, of_counts
from vttig_jax.logs.motion.segments import find_segments, steady

RATE = 30.0
TIME = np.arange(40 * 30) / RATE
RAMPED = np.interp(TIME, [0, 2, 38, 40], [0, 1, 1, 0])


def logged(speed):
    """A log polled at 30 Hz of a speed in degrees per second."""
    return of_counts(TIME, np.cumsum(speed) / RATE)


def swinging(speed, swing):
    """The speed with a relative swing once a turn."""
    return speed * (1 + swing * np.sin(np.cumsum(speed) / RATE * DEG))


@pytest.mark.parametrize("rpm", [20, 40, 60, 97])
def test_a_swing_once_a_turn_is_one_stretch(rpm):
    """A swing of ±7 % does not divide the steady part, and the ramps at both ends are cut."""
    (segment,) = find_segments(logged(swinging(6 * rpm * RAMPED, 0.07))).segments
    assert 2.0 - 0.15 <= TIME[segment.start] < 2.6 and 37.4 < TIME[segment.stop] <= 38.15
    assert segment.speed / DEG == pytest.approx(6 * rpm, rel=0.01)


def test_a_lower_plateau_is_its_own_stretch():
    """A plateau 40 % lower is not merged into the first one, and the ramp between is cut."""
    speed = 360 * np.interp(TIME, [0, 2, 20, 22, 38, 40], [0, 1, 1, 0.6, 0.6, 0])
    first, second = find_segments(logged(speed)).segments
    assert [round(each.speed / DEG) for each in (first, second)] == [360, 216]
    assert TIME[first.stop] <= 20.1 and TIME[second.start] >= 21.9


def test_a_swinging_plateau_ends_at_a_lower_one():
    """A plateau that swings by ±7 % ends where the speed falls by 40 %."""
    wave = 1 + 0.07 * np.sin(np.arange(1200) / 5)
    lower = wave * np.where(np.arange(1200) < 700, 1.0, 0.6)
    ((start, stop),) = steady(360 * lower, 360.0, 0.03, 4)
    assert start < 40 and 650 < stop <= 700
    ((start, stop),) = steady(360 * wave, 360.0, 0.03, 4)
    assert start < 40 and stop > 1160


@pytest.mark.parametrize(("dip", "stretches"), [(0.25, 1), (0.4, 2), (1.0, 2)])
def test_the_deviation_that_ends_a_stretch(dip, stretches):
    """A dip of half a second by 25 % does not divide a run, and a dip by 40 % does."""
    speed = np.full(1200, 360.0)
    speed[600:615] *= 1 - dip
    found = steady(speed, 360.0, 0.03, 4)
    assert len(found) == stretches
    assert (found[0][0], found[-1][1]) == (0, 1200)
    if stretches == 2:
        assert found[0][1] < 600 and found[1][0] > 614
