"""Logs with a torque column: the flank by the torque where it tells it, by the motion elsewhere."""

import numpy as np
import pytest

from tests.logs.profiles import geared, trapezoid
from vttig_jax.identify.fitting import fit
from vttig_jax.logs.encoder_log import EncoderLog
from vttig_jax.logs.motion.flank_assignment import assigned_segments
from vttig_jax.logs.motion.segments import Segments

RATE, GAP = 500.0, 0.04
NOTE = "flanks assigned by the motion"


def _to_and_fro():
    """Driving angle, driven angle with its flank by the sense of motion, and the sense; degrees."""
    time, angle, _ = trapezoid(rate=RATE, reversal=1800.0, dwell=0.5)
    driven, _ = geared(angle, gap=GAP, noise=5e-4)
    sense = np.sign(np.gradient(angle))
    return time, angle, driven, sense


def _overrunning(seed: int = 0):
    """Always forward; every 1.7 s the load overtakes, and the gears change flank against it."""
    time = np.arange(int(20 * RATE)) / RATE
    angle = 360.0 * time
    load = np.where((time // 1.7) % 2 == 0, 1.0, -1.0)
    shift = 45 / 80 * angle * np.pi / 180
    turn = angle * np.pi / 180
    on_b = 45 / 80 * angle + 0.02 * np.sin(turn - 0.3) + 0.015 * np.sin(shift + 0.3) + GAP
    on_a = 45 / 80 * angle + 0.02 * np.sin(turn + 0.3) + 0.015 * np.sin(shift - 0.3)
    generator = np.random.default_rng(seed)
    driven = np.where(load > 0, on_a, on_b) + 5e-4 * generator.standard_normal(len(time))
    return time, angle, driven, load


def _log(time, angle, driven, pair, torque=None) -> EncoderLog:
    return EncoderLog.from_arrays(time, angle, driven, pair=pair, unit="deg", torque=torque)


def _agreement(found: Segments, flank: np.ndarray) -> float:
    """Share of the certain samples whose flank is right."""
    right = total = 0
    for segment in found.segments:
        part = flank[segment.start : segment.stop]
        right += int(np.sum(part == (1 if segment.flank == "A" else -1)))
        total += len(part)
    return right / total


def test_an_overrunning_load_is_seen_by_the_torque_alone(paper_pair):
    time, angle, driven, load = _overrunning()
    torque = load * (0.3 + np.abs(np.sin(2.9 * time)))
    log = _log(time, angle, driven, paper_pair, torque)
    found = assigned_segments(log)
    assert _agreement(found, load) == 1.0
    assert found.forward > 1000 < found.backward
    assert not any(note.startswith(NOTE) for note in found.notes)
    # The motion takes all of it for flank A.
    plain = assigned_segments(_log(time, angle, driven, paper_pair))
    assert _agreement(plain, load) < 0.7 and plain.backward == 0


def test_the_gap_is_found_through_the_torque(paper_pair):
    """The torque changes its size as well: a torque of one size could pass for wind-up."""
    time, angle, driven, load = _overrunning()
    torque = load * (0.3 + np.abs(np.sin(2.9 * time)))
    result = fit(_log(time, angle, driven, paper_pair, torque), paper_pair)
    gap = result.parameters["backlash_plus_delay_deg"]  # at one speed and without a delay
    assert result.flanks == ("A", "B")
    assert gap.value == pytest.approx(GAP, abs=4 * (gap.std or 0.0))
    assert gap.std is not None and gap.std < 2e-3


@pytest.mark.parametrize("kind", ["noise", "own rhythm"])
def test_a_torque_that_tells_nothing_leaves_it_to_the_motion(paper_pair, kind):
    time, angle, driven, sense = _to_and_fro()
    torque = np.random.default_rng(2).standard_normal(len(time))
    if kind == "own rhythm":
        torque = np.where((time // 0.9) % 2 == 0, 1.0, -1.0) + 0.1 * torque
    log = _log(time, angle, driven, paper_pair, torque)
    found = assigned_segments(log)
    assert _agreement(found, sense) == 1.0
    assert [note for note in found.notes if note.startswith(NOTE)] == [
        "flanks assigned by the motion: the sign of the torque column does not tell them better,"
        " so the column is only a regressor"
    ]
    bare = assigned_segments(_log(time, angle, driven, paper_pair))
    assert found.segments == bare.segments
    gap = fit(log, paper_pair).parameters["constant_backlash_deg"]
    assert gap.value == pytest.approx(GAP, abs=4 * (gap.std or 0.0))


def test_a_torque_along_the_motion_needs_no_second_look(paper_pair):
    time, angle, driven, sense = _to_and_fro()
    found = assigned_segments(_log(time, angle, driven, paper_pair, 2.0 * sense))
    assert _agreement(found, sense) == 1.0
    assert not any(note.startswith(NOTE) for note in found.notes)


def test_without_a_torque_there_is_no_question(paper_pair):
    time, angle, driven, sense = _to_and_fro()
    found = assigned_segments(_log(time, angle, driven, paper_pair))
    assert _agreement(found, sense) == 1.0 and found.notes == ()


def test_a_direction_column_wins(paper_pair):
    time, angle, driven, sense = _to_and_fro()
    noise = np.random.default_rng(3).standard_normal(len(time))
    log = EncoderLog.from_arrays(
        time, angle, driven, pair=paper_pair, unit="deg", torque=noise, direction=sense
    )
    assert not any(note.startswith(NOTE) for note in assigned_segments(log).notes)
