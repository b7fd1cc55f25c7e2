"""Samples in the gap after a reversal: a reducer turns far before its teeth touch again."""

import numpy as np
import pytest

from tests.logs.profiles import drive, flanks, of_degrees, played
from vttig_jax.base.units import DEG
from vttig_jax.identify.identification import fit
from vttig_jax.logs.encoder_log import EncoderLog
from vttig_jax.logs.motion.flank_assignment import (
    assigned_segments,
    crossed_gap,
    find_ramps,
    seen_gap,
)
from vttig_jax.logs.motion.segments import AFTER_REVERSAL, find_segments
from vttig_jax.pair.gear_pair import pair_from_spec

RATIO = 1 / 8
TIME = np.arange(20_000) / 1000
SINES = 150.0 * np.sin(1.3 * TIME) + 60.0 * np.sin(2.9 * TIME)
"""A motion without a steady speed, deg."""


def log_of(time: np.ndarray, driving: np.ndarray, driven: np.ndarray) -> EncoderLog:
    return of_degrees(time, driving, driven, drive("1/8"))


def noise(count: int, noise_deg: float = 0.003) -> np.ndarray:
    return noise_deg * np.random.default_rng(0).standard_normal(count)


def reducer(gap_deg: float, driving: np.ndarray = SINES) -> tuple[EncoderLog, np.ndarray]:
    """A log of a motion, and the share of the gap that the driven shaft left.

    The share is 0 on flank A and 1 on flank B.
    """
    lower = RATIO * driving + 0.02 * np.sin(np.radians(driving))
    driven = played(lower, gap_deg)
    return log_of(TIME, driving, driven + noise(len(TIME))), (driven - lower) / gap_deg


def inside(share: np.ndarray, segments) -> int:
    """Number of used samples that are on neither flank."""
    return int(np.sum((flanks(segments) != 0) & (share > 0.001) & (share < 0.999)))


def test_no_sample_of_the_gap_is_used():
    log, share = reducer(0.4)
    plain, found = find_segments(log), assigned_segments(log)
    assert inside(share, plain) > 100
    assert inside(share, found) == 0
    assert found.masked > plain.masked
    assert any("cross the gap" in note for note in found.notes)


def test_the_gap_is_seen_and_a_small_one_changes_nothing():
    for gap_deg in (0.1, 0.4):
        log, _ = reducer(gap_deg)
        assert 0.7 * gap_deg < seen_gap(log, find_segments(log)) / DEG < 1.05 * gap_deg
    log, _ = reducer(0.03)
    assert assigned_segments(log) == find_segments(log)
    log, _ = reducer(1e-9)
    assert seen_gap(log, find_segments(log)) == 0.0
    forward = log_of(TIME, 300.0 * TIME, 37.5 * TIME)
    assert seen_gap(forward, find_segments(forward)) == 0.0


def test_a_flank_is_not_given_up():
    """Strokes back that are shorter than twice the crossing keep flank B behind the crossing."""
    knots = np.cumsum(np.tile([0.0, 1.5, 0.5], 11))
    places = np.cumsum(np.tile([0.0, 60.0, -5.0], 11))
    strokes = np.pad(np.interp(TIME, knots, places), (50, 49), "edge")
    driving = np.convolve(strokes, np.ones(100) / 100, "valid")
    log, share = reducer(0.4, driving)
    assert find_segments(log, 6.4 * DEG).backward == 0
    found = assigned_segments(log)
    assert found.forward and found.backward and not found.unclear
    assert inside(share, find_segments(log)) > inside(share, found) == 0


def test_strokes_hardly_longer_than_the_crossing_show_no_flank():
    """The teeth cross the gap over 26° of strokes of 30°."""
    driving = 15.0 * (1 - np.cos(TIME))
    log, share = reducer(3.3, driving)
    found = assigned_segments(log)
    assert "log longer strokes" in found.unclear and found.notes[-1] == found.unclear
    assert inside(share, found) == 0
    result = fit(log, pair_from_spec(drive("1/8")))
    assert result.checks.gap_over_angles_covered.value is None
    assert result.warnings[0] == found.unclear


def one_speed(gap_deg: float, delay_s: float = 0.0, silent: bool = False):
    """One way out and back of a reducer at one speed, and the share of the gap as in `reducer`.

    The drive brakes slowly. With `silent` the logger writes nothing at standstill.
    """
    rpm = [0, 0, 90, 90, 0, 0, -90, -90, 0, 0]
    knots = [0, 1, 1.1, 5, 6, 7, 7.1, 11, 12, 13]
    fine = np.arange(0.0, 13.0, 1e-3)
    place = np.cumsum(6 * np.interp(fine, knots, rpm)) * 1e-3
    lower = RATIO * place + 0.02 * np.sin(np.radians(place))
    driven = played(lower, gap_deg, start=0.7 * gap_deg)
    share = (driven - lower) / max(gap_deg, 1e-12)
    driven = np.interp(fine - delay_s, fine, driven)
    rows = np.arange(0, len(fine), 2)
    if silent:
        rows = rows[(np.gradient(place)[rows] != 0) | (rows == 0)]
    return log_of(fine[rows], place[rows], driven[rows] + noise(len(rows))), share[rows]


@pytest.mark.parametrize("silent", [False, True])
def test_at_one_speed_the_crossings_show_the_gap(silent):
    """Speed and direction are the same column there, so that no step shows it."""
    log, share = one_speed(8.0, silent=silent)
    plain, found = find_segments(log), assigned_segments(log)
    assert inside(share, plain) > 20 and seen_gap(log, plain) == 0.0
    assert 7.0 < crossed_gap(log, plain) / DEG < 9.0
    assert inside(share, found) == 0
    assert 1.9 * 8.0 < RATIO * found.crossing / DEG < 2.1 * 8.0
    assert found.forward > 100 and found.backward > 100


def test_a_delay_is_no_crossing():
    log, _ = one_speed(0.0, delay_s=0.05)
    assert crossed_gap(log, find_segments(log)) == 0.0
    assert assigned_segments(log).crossing == AFTER_REVERSAL


def test_no_ramp_crosses_the_gap():
    log, share = one_speed(8.0)
    found = assigned_segments(log)
    narrow, wide = find_ramps(log, found), find_ramps(log, find_segments(log))
    across = [share[r.segment.start : r.segment.stop] for r in (*narrow, *wide)]
    assert narrow
    assert all(np.isin(np.round(part, 3), (0, 1)).all() for part in across[: len(narrow)])
    assert any(np.any(part % 1 > 0.01) for part in across[len(narrow) :])


def _without(log: EncoderLog, start: int, stop: int) -> EncoderLog:
    """The log without the rows [start, stop)."""
    columns = (log.time, np.degrees(log.driving_angle), np.degrees(log.driven_angle))
    return log_of(*(np.delete(column, np.s_[start:stop]) for column in columns))


def test_a_run_after_a_silence_at_standstill_is_masked():
    """A logger that writes only changes has a gap in time there, and the teeth may be anywhere."""
    log, _ = one_speed(2.0, silent=True)
    slow = find_segments(_without(log, 3, 10), 20 * DEG)
    assert 3 in slow.starts
    # Rows that are missing during the motion change nothing.
    middle = len(log) // 4
    assert middle not in find_segments(_without(log, middle, middle + 20), 20 * DEG).starts
