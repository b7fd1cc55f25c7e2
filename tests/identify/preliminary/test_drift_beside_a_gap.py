"""A drift in time that resembles the gap: one way out and back with a shaft that hardly turns."""

import numpy as np
import pytest

from tests.identify.drives import drive, drive_log, known, level, there_and_back
from tests.logs.profiles import played
from vttig_jax.identify.fitting import fit
from vttig_jax.logs.encoder_log import EncoderLog
from vttig_jax.logs.motion.crossing import crossed_gap
from vttig_jax.logs.motion.flank_assignment import assigned_segments

PAIR = drive("1/500")
GAP_ARCSEC = 60.0


MOTION = (0.3, 0.2, 20, 0.2, 0.3, 0.2, 14, 0.2), (0, 30, 30, 0, 0, -30, -30, 0)
"""Ten driving turns out and seven back; ten turns are 1/50 turn of the driven shaft."""


def _slow(angle: np.ndarray, speed: np.ndarray) -> np.ndarray:
    """A part of the first order of the driven shaft."""
    return 200.0 * np.sin(2 * (angle - angle.min()) / np.ptp(angle))


def _log(seed, motion=MOTION, error=_slow):
    return drive_log(
        PAIR, motion, gap=level(GAP_ARCSEC), error=error, noise_arcsec=5.0, rate_hz=50.0, seed=seed
    )


def _notes(result) -> list[str]:
    return [note for note in result.warnings if "resembles the backlash" in note]


@pytest.mark.parametrize("seed", range(2))
def test_the_gap_stays_and_its_interval_contains_the_drift(seed):
    log = _log(seed)
    result = fit(log, PAIR, delay="off")
    assert result.checks.drift_order == 2 and len(_notes(result)) == 1
    gap = result.checks.gap_over_angles_covered
    fixed = [
        fit(log, PAIR, delay="off", drift_order=order).checks.gap_over_angles_covered
        for order in (0, 2)
    ]
    assert gap.value == pytest.approx(fixed[1].value) and known(gap.std) > known(fixed[1].std)
    assert abs(known(fixed[1].value) - known(fixed[0].value)) * 3600 > 30
    for value in (known(fixed[0].value), GAP_ARCSEC / 3600):
        assert known(gap.low95) < value < known(gap.high95)


def test_a_drift_that_the_user_asks_for_is_taken():
    result = fit(_log(0), PAIR, delay="off", drift_order=1)
    assert result.checks.drift_order == 1 and not _notes(result)


def test_with_more_legs_the_drift_is_chosen_as_before():
    def bend(time: np.ndarray) -> np.ndarray:
        return 40.0 * (time / time.max())

    log = _log(0, there_and_back([30.0, 30.0, 30.0], 20.0), level(0.0))
    drifting = log.__class__.from_arrays(
        log.time,
        np.degrees(log.driving_angle),
        np.degrees(log.driven_angle) + bend(log.time) / 3600,
        pair=PAIR,
        unit="deg",
    )
    result = fit(drifting, PAIR, delay="off")
    assert result.checks.drift_order >= 1 and not _notes(result)
    gap = result.checks.gap_over_angles_covered
    assert known(gap.low95) < GAP_ARCSEC / 3600 < known(gap.high95)


REDUCER = drive("1/100")
WIDE_DEG = 1.0


def _crossing_log(gap_deg: float, wander_deg: float = 0.0) -> EncoderLog:
    """Ten driving turns out and seven back of a reducer whose teeth cross the gap after the turn.

    The level of the transmission error wanders by `wander_deg` over the log.
    """
    durations, rpms = MOTION
    fine = np.arange(0.0, sum(durations), 2e-3)
    knots = np.cumsum([0.0, *durations])
    place = np.cumsum(np.interp(fine, knots, [0.0, *rpms]) * 6 * 2e-3)
    lower = place / 100 + 0.3 * np.sin(2 * (place - place.min()) / np.ptp(place))
    driven = played(lower, gap_deg)
    driven += wander_deg * fine / fine[-1]
    driven += 0.002 * np.random.default_rng(1).standard_normal(len(fine))
    rows = slice(None, None, 5)
    return EncoderLog.from_arrays(fine[rows], place[rows], driven[rows], pair=REDUCER, unit="deg")


@pytest.mark.parametrize("wander_deg", [0.0, 0.5])
def test_crossings_show_the_gap_beside_a_drift(wander_deg):
    """The drift is left out, and the interval contains the gap of the crossings beside it."""
    log = _crossing_log(WIDE_DEG, wander_deg)
    result = fit(log, REDUCER, delay="off")
    assert result.checks.drift_order == 0
    assert len(_notes(result)) == 1 and "is left out" in _notes(result)[0]
    gap = result.checks.gap_over_angles_covered
    assert 0 < known(gap.low95) < WIDE_DEG < known(gap.high95)


def test_crossings_are_not_seen_without_a_gap():
    log = _crossing_log(0.0)
    assert crossed_gap(log, assigned_segments(log), 2) == 0.0
