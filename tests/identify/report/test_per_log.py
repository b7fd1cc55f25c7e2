"""Logs of one rig that do not say the same about what they share."""

import numpy as np
import pytest

from tests.identify.quick import quick_rig
from vttig_jax.identify.fit_result import Fit
from vttig_jax.identify.fitting import fit
from vttig_jax.identify.report.per_log import differences
from vttig_jax.logs.encoder_log import EncoderLog


@pytest.fixture(scope="module")
def rig():
    return quick_rig(0, 2e-3, ramp_s=0.5)


def _shifted(log: EncoderLog, pair, counts: int) -> EncoderLog:
    """The log with the driven readings of the way back moved: another gap."""
    assert log.driven is not None
    back = np.arange(len(log)) > int(np.argmax(log.driving_angle))
    driven = log.driven.reading + np.where(back, counts, 0)
    return EncoderLog.from_arrays(log.time, log.driving.reading, driven, pair=pair, source="moved")


def _gaps(result: Fit) -> np.ndarray:
    """The gap that each log alone shows, and its standard error; a row for every log."""
    return np.array([(one.alone.gap_deg, one.alone.gap_std_deg) for one in result.logs], float)


def test_logs_that_agree_say_nothing(rig):
    result = fit([rig.log(0), rig.log(1)], rig.pair, same_zero=True)
    gaps, stds = _gaps(result).T
    spread = np.hypot(*stds)
    assert abs(gaps[0] - gaps[1]) < 5 * spread < 0.01
    assert not any("alone shows" in note for note in result.notes)


def test_another_gap_is_told(rig):
    moved = _shifted(rig.log(1), rig.pair, 25)  # 0.1 deg
    result = fit([rig.log(0), moved], rig.pair, same_zero=True)
    gaps, _ = _gaps(result).T
    assert gaps[1] - gaps[0] == pytest.approx(0.1, abs=0.005)
    assert any("log 1 alone shows a gap between the flanks" in note for note in result.notes)
    assert any("a gap" in sentence for sentence in differences(result.logs, of_gaps=True))
    assert not any("a gap" in sentence for sentence in differences(result.logs, of_gaps=False))


def test_another_delay_is_told():
    """Two speeds on each flank: every log tells its own delay."""
    logs = []
    for seed, delay_s in ((0, 2e-3), (1, 3e-3)):
        fast, slow = (quick_rig(0, delay_s, speed_rpm=rpm, dwell_s=0.0) for rpm in (60.0, 30.0))
        first, second = fast.log(seed), slow.log(seed + 9)
        assert first.driven is not None and second.driven is not None
        logs.append(
            EncoderLog.from_arrays(
                np.append(first.time, second.time + first.time[-1] + 1.0),
                np.append(first.driving.reading, second.driving.reading),
                np.append(first.driven.reading, second.driven.reading),
                pair=fast.pair,
                source=f"run {seed}",
            )
        )
    result = fit(logs, quick_rig(0).pair, same_zero=True)
    found = [one.alone.delay_s for one in result.logs]
    assert found == pytest.approx([2e-3, 3e-3], abs=5e-5)
    assert any("alone shows a delay" in note for note in result.notes)
