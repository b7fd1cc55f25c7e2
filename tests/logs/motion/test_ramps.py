"""Ramps beside the steady speed of every run."""

import numpy as np
import pytest

from tests.logs.profiles import geared, of_degrees, trapezoid
from vttig_jax.logs.encoder_log import EncoderLog
from vttig_jax.logs.motion.flank_assignment import find_ramps
from vttig_jax.logs.motion.segments import AFTER_REVERSAL, Segments, find_segments

pytestmark = pytest.mark.smoke

RATE = 500.0


def _log(ramp: float = 0.5, passes: int = 2, reversal: float = 1800.0, **columns) -> EncoderLog:
    time, angle, _ = trapezoid(rate=RATE, reversal=reversal, ramp=ramp, dwell=1.0, passes=passes)
    return of_degrees(time, angle, geared(angle)[0], **columns)


@pytest.mark.parametrize("passes", [1, 2, 3])
def test_every_run_has_a_ramp_before_and_behind(passes):
    log = _log(passes=passes)
    found = find_segments(log)
    ramps = find_ramps(log, found)
    assert [r.speeding_up for r in ramps] == [True, False] * passes
    assert [r.segment.flank for r in ramps] == [f for s in "ABA"[:passes] for f in (s, s)]
    for segment, before, behind in zip(found.segments, ramps[::2], ramps[1::2], strict=True):
        assert before.segment.stop == segment.start
        assert behind.segment.start == segment.stop
        assert before.segment.speed == behind.segment.speed == segment.speed


def test_ramps_lie_where_the_speed_changes():
    log = _log(ramp=1.0)
    _, _, steady = trapezoid(rate=RATE, reversal=1800.0, ramp=1.0, dwell=1.0)
    for ramp in find_ramps(log, find_segments(log)):
        part = slice(ramp.segment.start, ramp.segment.stop)
        # 1 s of ramp, less the first degree and what the smoothing of the speed rounds off.
        assert 0.6 * RATE < ramp.segment.stop - ramp.segment.start < 1.1 * RATE
        assert np.mean(steady[part]) < 0.15
        pace = np.abs(np.gradient(log.driving_angle[part]))
        third = len(pace) // 3
        faster = pace[-third:].mean() > pace[:third].mean()
        assert faster == ramp.speeding_up


def test_the_crossing_of_the_gap_is_left_out():
    """The first degree behind a reversal and a start; behind it the driven gear is on its flank."""
    log = _log()
    found = find_segments(log)
    _, flank = geared(np.degrees(log.driving_angle))
    for ramp in find_ramps(log, found):
        if not ramp.speeding_up:
            continue
        run = next(m for m in found.motion if m.start <= ramp.segment.start < m.stop)
        passed = np.abs(log.driving_angle - log.driving_angle[run.start])
        assert passed[ramp.segment.start] >= AFTER_REVERSAL
        assert passed[ramp.segment.start - 1] < AFTER_REVERSAL
        want = 1 if ramp.segment.flank == "A" else -1
        assert (flank[ramp.segment.start : ramp.segment.stop] == want).all()
    # Without that degree the second run would begin on the other flank.
    second = next(m for m in found.motion if m.kind == "backward")
    assert flank[second.start] != -1


def test_without_ramps_or_certain_samples_there_are_hardly_any():
    """A motion that starts all but at full speed leaves what smoothing blurs, a few samples."""

    def samples(log: EncoderLog) -> int:
        ramps = find_ramps(log, find_segments(log))
        return sum(ramp.segment.stop - ramp.segment.start for ramp in ramps)

    assert samples(_log(ramp=0.02)) < 0.25 * samples(_log())
    log = _log(reversal=180.5)
    found = find_segments(log)
    assert find_ramps(log, Segments((), found.motion, found.read)) == ()


@pytest.mark.parametrize("column", ["torque", "direction"])
def test_where_a_column_tells_the_flank_there_are_none(column):
    """The motion says nothing about the flank then."""
    plain = _log()
    speed = np.gradient(plain.driving_angle)
    told = np.where(np.abs(speed) < 1e-9, 0.0, np.sign(speed))
    log = _log(torque=told) if column == "torque" else _log(direction=told)
    assert find_segments(log).segments
    assert find_ramps(log, find_segments(log)) == ()
    assert len(find_ramps(plain, find_segments(plain))) == 4
