"""Start angles that no order tells, and a delay that changes within a log."""

import json

import numpy as np
import pytest

from tests.identify.drives import Curve, drive, drive_log, known, level, there_and_back
from vttig_jax.identify.fit_result import Fit
from vttig_jax.identify.fitting import fit

PAIR = drive("1/2")
START_DEG = 90.0


def _driving(angle, _):
    return 20 * np.sin(angle + 0.3)


def _both(angle, rpm):
    return _driving(angle, rpm) + 30 * np.sin(angle / 2 + 1)


def _two_logs(error: Curve) -> Fit:
    """Two logs, of which the second starts a quarter turn further."""
    logs = [
        drive_log(
            PAIR,
            there_and_back([60, 90], 5),
            gap=level(150.0),
            error=error,
            seed=number,
            start_turns=number * START_DEG / 360,
        )
        for number in (0, 1)
    ]
    return fit(logs, PAIR)


@pytest.fixture(scope="module")
def driving_only() -> Fit:
    return _two_logs(_driving)


def test_an_order_in_both_logs_tells_the_start(driving_only):
    start = _two_logs(_both).logs[1].start
    assert abs(known(start.driving_deg) - START_DEG) < 4 * known(start.driving_std_deg) < 1
    assert abs(known(start.driven_deg) - START_DEG / 2) < 4 * known(start.driven_std_deg) < 1
    alone = driving_only.logs[1].start
    assert abs(known(alone.driving_deg) - START_DEG) < 4 * known(alone.driving_std_deg) < 1


def test_without_an_order_the_start_is_unknown(driving_only):
    start = driving_only.logs[1].start
    assert (start.driven_deg, start.driven_std_deg) == (None, None)
    (line,) = [
        one for one in str(driving_only).splitlines() if one.strip().startswith("start of log 2")
    ]
    assert line.endswith("driven unknown") and "driving unknown" not in line
    record = json.loads(json.dumps(driving_only.to_json(), allow_nan=False))
    assert record["logs"][1]["start"]["driven_deg"] is None


def _with_delay(delay_s: Curve) -> Fit:
    motion = there_and_back([60, 90, 60, 90], 6)
    return fit(drive_log(PAIR, motion, gap=level(150.0), error=_both, delay_s=delay_s), PAIR)


def _told(result: Fit) -> list[str]:
    return [note for note in result.notes if note.startswith("the delay changes by")]


def test_a_delay_that_moves_is_told_and_widens_the_interval():
    """The step of 0.3 ms is in the dwell between the two halves."""
    before, after = 4e-4, 7e-4
    result = _with_delay(lambda time, _: np.where(time < time.mean(), before, after))
    (note,) = _told(result)
    assert note.startswith("the delay changes by +0.3 ± ")
    delay = result.parameters["delay_s"]
    assert (known(delay.high95) - known(delay.low95)) / 2 >= 0.3 * (after - before) * 0.99


def test_a_constant_delay_gives_no_note():
    result = _with_delay(level(5.5e-4))
    assert _told(result) == []
    delay = result.parameters["delay_s"]
    assert abs(known(delay.value) - 5.5e-4) < 4 * known(delay.std) < 1e-6
