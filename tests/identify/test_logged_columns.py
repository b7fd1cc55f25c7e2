"""Further columns of a log: an axial position, and a transmission error instead of an angle."""

from dataclasses import replace

import equinox as eqx
import numpy as np
import pytest

from vttig_jax.base import ARCSEC, DEG
from vttig_jax.identify import fit
from vttig_jax.logs import EncoderLog
from vttig_jax.rig import PassMotion

SHIFT_MM = 0.05
MOTION = PassMotion(speed_rpm=180.0, reversal_deg=7200.0)


def test_a_logged_axial_position_is_taken_out(clean_rig):
    """The constant backlash is that of s = 0 with the column, of the position without it."""
    tapered = eqx.tree_at(
        lambda p: (p.driving.helix_right_deg, p.driven.helix_right_deg),
        clean_rig.pair,
        (np.asarray(2.0), np.asarray(2.0)),
    )
    moved = eqx.tree_at(lambda e: e.axial_mm, clean_rig.eccentricities, np.asarray(SHIFT_MM))
    log = replace(clean_rig, pair=tapered, eccentricities=moved, motion=MOTION).log()
    closed = SHIFT_MM * (np.tan(3 * DEG) + np.tan(2 * DEG)) / 80.0 / DEG
    assert closed > 1e-4
    column = replace(log, axial_mm=np.full(len(log), SHIFT_MM))
    for one, gap in ((log, 0.038 - closed), (column, 0.038)):
        found = fit(one, tapered).value("constant_backlash_deg")
        assert found == pytest.approx(gap, abs=2e-5)


@pytest.mark.portable
def test_an_axial_position_that_changes_is_followed(clean_rig):
    """Each flank by its own helix: s moves flank A up by s tan β_L/R₂, flank B down."""
    log = replace(clean_rig, motion=MOTION).log()
    axial = 0.05 * np.sin(np.linspace(0, 20, len(log)))
    slope = np.tan(3 * DEG) / 80.0
    turning_back = np.arange(len(log)) > np.argmax(log.driving_angle)
    driven = log.driven_angle + np.where(turning_back, -slope, slope) * axial
    angles = log.driving_angle / DEG, driven / DEG
    shaken = EncoderLog.from_arrays(
        log.time, *angles, pair=clean_rig.pair, unit="deg", axial_mm=axial
    )
    result = fit(shaken, clean_rig.pair)
    assert result.residual_rms_deg < 1e-5
    # Gear 2's offset turns a little further with s: 1e-6° in the gap.
    assert result.value("constant_backlash_deg") == pytest.approx(0.038, abs=2e-5)
    unaware = fit(replace(shaken, axial_mm=None), clean_rig.pair)
    assert unaware.residual_rms_deg > 1e-4


def test_a_curve_of_transmission_error_gives_the_same_fit(noisy_log, noisy_rig, noisy_fit):
    curve = EncoderLog.from_arrays(
        noisy_log.time,
        noisy_log.driving_angle / DEG,
        pair=noisy_rig.pair,
        unit="deg",
        transmission_error=noisy_log.transmission_error / ARCSEC,
    )
    result = fit(curve, noisy_rig.pair)
    assert result.flanks == ("A", "B")
    for name in ("driving_eccentricity_mm", "driven_phase_deg", "constant_backlash_deg"):
        parameter, other = result.parameters[name], noisy_fit.parameters[name]
        assert parameter.value is not None and other.value is not None and other.std is not None
        assert abs(parameter.value - other.value) < 0.5 * other.std, name
    assert result.zero_readings["driven"] is None
