"""Late readings that follow long sampling intervals: all readings of a slow bus are left out."""

import numpy as np
import pytest

from tests.identify.drives import drive, known
from vttig_jax.identify.fit_result import Fit
from vttig_jax.identify.fitting import fit
from vttig_jax.identify.preliminary import robust
from vttig_jax.identify.preliminary.robust import slow_readings
from vttig_jax.logs.encoder_log import EncoderLog

PAIR = drive("1/1")
COUNT = 4000


def _time(seed: int = 0, share: float = 0.2) -> tuple[np.ndarray, np.ndarray]:
    """Stamps of which a share follows an interval of 1.6 usual ones, and a mask of those."""
    long = np.random.default_rng(seed).random(COUNT) < share
    return np.cumsum(np.where(long, 0.016, 0.01)), long


def _weight(doubtful: np.ndarray) -> np.ndarray:
    return np.where(doubtful, 0.1, 0.9)


def test_slow_readings_are_those_after_long_intervals():
    time, long = _time()
    late = long & (np.random.default_rng(1).random(COUNT) < 0.3)
    np.testing.assert_array_equal(slow_readings(time, _weight(late)), long)


@pytest.mark.parametrize(
    ("share", "of_long", "of_others"),
    [
        (0.2, 0.02, 0.0),  # too few
        (0.2, 0.1, 0.1),  # as many among the others
        (0.5, 0.3, 0.0),  # too many samples would be lost
        (0.0, 0.3, 0.05),  # even stamps
        (0.002, 0.5, 0.02),  # chance
    ],
)
def test_without_evidence_nothing_is_left_out(share, of_long, of_others):
    time, long = _time(share=share)
    drawn = np.random.default_rng(1).random(COUNT)
    doubtful = np.where(long, drawn < of_long, drawn < of_others)
    assert not slow_readings(time, _weight(doubtful)).any()


def _fit(seed: int = 0) -> Fit:
    """Reversals up to 5 turns a second without a gap, half the slow readings late by 1 to 9 ms."""
    generator = np.random.default_rng(seed)
    time, long = _time(seed)
    fine = np.arange(0.0, time[-1] + 0.1, 1e-3)
    legs = np.repeat(generator.normal(size=200), 300)[: len(fine)]
    window = np.hanning(201) / np.hanning(201).sum()
    turned = np.cumsum(np.convolve(legs, window, "same")) * 1e-3 * 2.5 * 360
    late = np.where(long & (generator.random(COUNT) < 0.5), generator.uniform(1e-3, 9e-3, COUNT), 0)
    driving = np.interp(time + late, fine, turned)
    driven = np.interp(time, fine, turned) + 0.4 * generator.normal(size=COUNT)
    log = EncoderLog.from_arrays(time, driving, driven, pair=PAIR, unit="deg")
    return fit(log, PAIR)


def test_late_readings_make_no_gap(monkeypatch):
    result = _fit()
    (note,) = [note for note in result.notes if "slow bus" in note]
    assert ("follow a long sampling interval" in note and "19." in note) or "20." in note
    gap = result.checks.gap_over_angles_covered
    assert known(gap.low95) < 0 < known(gap.high95)
    monkeypatch.setattr(robust, "slow_readings", lambda time, _: np.zeros(len(time), bool))
    other = _fit()
    assert not any("slow bus" in note for note in other.notes)
    assert known(other.checks.gap_over_angles_covered.value) > known(gap.value) + 0.01
