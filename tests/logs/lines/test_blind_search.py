"""The blind search on whole logs: periods that nobody named are found, and none without one."""

import numpy as np
import pytest

from vttig_jax.logs.encoder_log import EncoderLog
from vttig_jax.logs.inspection import inspect_log
from vttig_jax.logs.lines.search import blind_lines
from vttig_jax.logs.motion.segments import find_segments
from vttig_jax.pair.pair_file import parse_pair_spec

DRIVE = parse_pair_spec({"drive": {"ratio": "1/2"}})
ARCSEC = 1 / 3600


def _log(amplitude_arcsec: float, *, delay_s: float = 0.0, drift_arcsec: float = 0.0) -> EncoderLog:
    """Twelve turns forth and back at two speeds, a line at 2.37 cycles a revolution."""
    time = np.arange(3000) / 100.0
    speed = np.where(time < 15.0, 1.0, -1.0) * np.where((time % 15.0) < 7.0, 360.0, 220.0)
    driving = np.cumsum(speed) / 100.0
    line = amplitude_arcsec * np.sin(np.radians(2.37 * driving) + 0.3)
    noise = np.random.default_rng(0).normal(0.0, 1.0, len(time))
    slow = drift_arcsec * (time / 30.0) ** 2
    driven = driving / 2 + ARCSEC * (line + noise + slow) - delay_s * speed / 2
    return EncoderLog.from_arrays(time, driving, driven, pair=DRIVE, unit="deg")


def test_a_line_is_found_beside_delay_and_drift_which_are_none():
    log = _log(4.0, delay_s=2e-3, drift_arcsec=50.0)
    [line] = blind_lines(log, find_segments(log).segments)
    assert line.cycles_per_rev == pytest.approx(2.37, abs=0.01)
    assert line.amplitude_arcsec == pytest.approx(4.0, abs=0.5)
    assert line.false_alarm < 1e-9
    without = _log(0.0, delay_s=2e-3, drift_arcsec=50.0)
    assert blind_lines(without, find_segments(without).segments) == blind_lines(log, ()) == ()


def test_the_report_names_the_line():
    report = inspect_log(_log(4.0), DRIVE)
    assert "line found blind" in str(report)
    [line] = report.to_json()["lines"]
    assert line["cycles_per_rev"] == pytest.approx(2.37, abs=0.01)
