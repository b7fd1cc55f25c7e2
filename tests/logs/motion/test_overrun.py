"""The flank of a fly-wheel that overruns the drive while the drive brakes harder than friction."""

import re

import numpy as np
import pytest

from tests.logs.profiles import DEG, drive, flanks, of_degrees
from vttig_jax.logs.encoder_log import EncoderLog
from vttig_jax.logs.motion.flank_assignment import assigned_segments, overrunning_segments
from vttig_jax.logs.motion.segments import Segments, find_segments

RATE = 500.0
RATIO = 9 / 16
GAP = 0.25 * DEG
HARDEST = 2 * np.pi * 0.7 * 2 * np.pi / 1.5
"""Largest deceleration of the drive in rad/s²."""


def carried(low, high, friction):
    """Driven angle and contact (+1 on A, −1 on B, 0 in the gap) of a load between two flanks.

    Friction slows the free load by `friction` rad/s². A flank stops it without a rebound.
    """
    pushed, held = (np.diff(bound, prepend=bound[0]) * RATE for bound in (low, high))
    angle, speed = low[0], 0.0
    driven, contact = np.empty_like(low), np.zeros(len(low), np.int8)
    for k in range(len(low)):
        speed -= np.sign(speed) * min(friction / RATE, abs(speed))
        angle += speed / RATE
        if angle <= low[k]:
            angle, speed, contact[k] = low[k], pushed[k], 1
        elif angle >= high[k]:
            angle, speed, contact[k] = high[k], held[k], -1
        driven[k] = angle
    return driven, contact


def flown(limit, noise=0.003, **columns) -> tuple[EncoderLog, np.ndarray]:
    """A log of 12 s, forward and back at 0.5 to 1.9 turns a second, and its true contact.

    Friction carries the load while the drive brakes by less than `limit` rad/s².
    """
    time = np.arange(int(12 * RATE)) / RATE
    turns = 1.2 * time + 0.7 * 1.5 / (2 * np.pi) * (1 - np.cos(2 * np.pi * time / 1.5))
    half = len(time) // 2
    angle = 2 * np.pi * np.where(time < time[half], turns, 2 * turns[half] - turns)
    waves = 0.02 * DEG * np.sin(angle) + 0.03 * DEG * np.sin(RATIO * angle + 1)
    low = RATIO * angle + waves
    driven, contact = carried(low, low + GAP, RATIO * limit)
    driven += noise * DEG * np.random.default_rng(0).standard_normal(len(time))
    log = EncoderLog.from_arrays(time, angle, driven, pair=drive("9/16"), unit="rad", **columns)
    return log, contact


def agreement(found: Segments, contact: np.ndarray) -> float:
    state = flanks(found)
    return float(np.mean(state[state != 0] == contact[state != 0]))


LIMITS = [*((limit, 0.003) for limit in (4.0, 6.0, 8.0, 12.0, 14.0)), (8.0, 0.02)]


@pytest.mark.parametrize(("limit", "noise"), LIMITS)
def test_the_segments_have_the_flank_of_the_contact_and_the_notes_say_why(limit, noise):
    """The flanks agree with the contact for 97 % of the used samples; by motion, a third fails."""
    log, contact = flown(limit, noise)
    found, by_motion = assigned_segments(log), find_segments(log)
    assert agreement(found, contact) >= 0.97
    assert agreement(by_motion, contact) < 0.75
    assert np.count_nonzero(flanks(found)) > 0.8 * len(log)
    gap, load = found.notes[-2:]
    assert found.notes[:-2] == by_motion.notes
    assert "cross the gap" in gap and "the load overruns" in load
    stated = re.search(r"more than ([\d.e+-]+) rad/s²", load)
    assert stated is not None and float(stated[1]) == pytest.approx(limit, rel=0.1)


@pytest.mark.parametrize("noise", [0.003, 0.02])
def test_no_overrun_without_hard_braking(noise):
    """Friction above the hardest braking keeps the load on its flank, and nothing is assigned."""
    log, contact = flown(1.3 * HARDEST, noise)
    by_motion = find_segments(log)
    assert agreement(by_motion, contact) == 1.0
    assert overrunning_segments(log, by_motion) is None
    assert assigned_segments(log) == by_motion


def test_a_steady_log_has_no_overrun():
    """A log of constant speed has too few braked samples for a comparison."""
    time = np.arange(3000) / RATE
    angle = 360.0 * time
    log = of_degrees(time, angle, RATIO * angle + 0.02 * np.sin(angle * DEG))
    assert overrunning_segments(log, find_segments(log)) is None


def test_a_direction_column_decides_alone():
    """The flanks of a log with a direction column are those of the column."""
    _, contact = flown(8.0)
    log, _ = flown(8.0, direction=contact)
    found = assigned_segments(log)
    assert found == find_segments(log)
    assert not any("overruns" in note for note in found.notes)
    assert agreement(found, contact) == 1.0
