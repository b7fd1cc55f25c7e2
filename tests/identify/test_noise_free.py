"""Logs without noise, as a simulation makes them: recognised, fitted, and said in one line."""

from dataclasses import replace

import numpy as np
import pytest

from vttig_jax.base.errors import LogError
from vttig_jax.base.units import DEG
from vttig_jax.identify.identification import fit
from vttig_jax.logs.encoder_log import EncoderLog
from vttig_jax.rig.imperfections import Noise
from vttig_jax.rig.motion import PassMotion

pytestmark = pytest.mark.portable

SENTENCE = "the log holds no noise"
MOTIONS = {
    "a hunting period": PassMotion(speed_rpm=180.0, reversal_deg=5800.0, dwell_s=0.5),
    "a few turns": PassMotion(speed_rpm=60.0, reversal_deg=1440.0, dwell_s=0.2),
    "four passes": PassMotion(speed_rpm=180.0, reversal_deg=1800.0, passes=4),
}
TRUTH = {
    "driving_eccentricity_mm": 0.0226,
    "driving_phase_deg": 49.5,
    "driven_eccentricity_mm": 0.0273,
    "driven_phase_deg": 79.3,
    "constant_backlash_deg": 0.038,
}


@pytest.mark.parametrize("motion", MOTIONS)
def test_the_truth_comes_back_and_nothing_else(clean_rig, motion):
    rig = replace(clean_rig, motion=MOTIONS[motion])
    result = fit(rig.log(), rig.pair)
    assert result.outcome == "ok" and result.noise.is_rounding
    for name, truth in TRUTH.items():
        assert result.value(name) == pytest.approx(truth, rel=1e-6), name
        assert 0 < (result.parameters[name].std or 0.0) < 1e-5 * truth, name
    for name in ("driving_encoder_arcsec", "driven_encoder_arcsec"):
        assert not result.parameters[name].significant
    assert not result.checks.lines and result.checks.whiteness is None
    assert sum(SENTENCE in note for note in result.notes) == 1
    assert "changes by" not in str(result) and "noise                none" in str(result)


def test_one_flank_alone(clean_rig):
    result = fit(clean_rig.log(), clean_rig.pair, flank="A")
    assert result.outcome == "partly_determined" and result.noise.is_rounding
    assert result.value("driving_eccentricity_mm") == pytest.approx(0.0226, rel=1e-5)


@pytest.mark.parametrize("columns", [{"drift_order": 4}, {"drift_knots_s": 2.0}])
def test_columns_that_explain_nothing_do_no_harm(clean_rig, columns):
    rig = replace(clean_rig, motion=MOTIONS["four passes"])
    result = fit(rig.log(), rig.pair, **columns)
    assert result.noise.is_rounding
    assert result.value("constant_backlash_deg") == pytest.approx(0.038, rel=1e-5)


def test_a_torque_that_never_changes_is_the_offset(clean_rig):
    """Its column and that of the offset are one: no coefficient of it can be told."""
    log = replace(clean_rig, motion=MOTIONS["a few turns"]).log()
    sign = np.where(np.gradient(log.driving_angle) < 0, -1.0, 1.0)
    loaded = replace(log, torque=2.0 * sign)
    result = fit(loaded, clean_rig.pair)
    assert result.value("driving_eccentricity_mm") == pytest.approx(0.0226, rel=1e-5)
    assert not any(one.significant for one in result.regressors)


def test_noise_far_below_any_encoder_is_noise(clean_rig):
    """The negative control: 0.0004″ where the transmission error has 130″."""
    rig = replace(clean_rig, motion=MOTIONS["a few turns"], noise=Noise(1e-7, 0.0))
    result = fit(rig.log(), rig.pair)
    assert not result.noise.is_rounding
    assert not any(SENTENCE in note for note in result.notes)


def test_readings_of_many_digits_are_a_log_without_noise(clean_rig):
    """As a table prints them: sixteen digits of degrees."""
    log = replace(clean_rig, motion=MOTIONS["a few turns"]).log()
    angles = [
        np.array([float(f"{value:.16g}") for value in angle / DEG])
        for angle in (log.driving_angle, log.driven_angle)
    ]
    printed = EncoderLog.from_arrays(log.time, *angles, pair=clean_rig.pair, unit="deg")
    assert fit(printed, clean_rig.pair).noise.is_rounding


def test_a_perfect_gear_has_a_transmission_error_of_rounding_alone(paper_pair):
    """No slip is seen in the last digits, and nothing is significant."""
    time = np.arange(9000) / 500.0
    driving = 360.0 * np.concatenate([time[:4500], time[4500] - (time[4500:] - time[4500])])
    log = EncoderLog.from_arrays(time, driving, 9 / 16 * driving, pair=paper_pair, unit="deg")
    result = fit(log, paper_pair)
    assert result.noise.is_rounding
    assert not any(one.significant for one in result.parameters.values())
    stepped = 9 / 16 * driving + 1e-6 * (time > 5.0)
    with pytest.raises(LogError, match="slipped"):
        fit(EncoderLog.from_arrays(time, driving, stepped, pair=paper_pair, unit="deg"), paper_pair)
