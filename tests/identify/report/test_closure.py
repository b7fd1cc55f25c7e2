"""Closure and reversal jumps: the checks that do not use the fitted model."""

from dataclasses import replace

import numpy as np
import pytest

import vttig_jax
from vttig_jax.base.units import DEG, REV
from vttig_jax.identify.report.checks import Reversal
from vttig_jax.identify.report.comparisons.closure import closure, reversal_jumps
from vttig_jax.kinematics.te_curve import TECurve
from vttig_jax.logs.encoder_log import EncoderLog
from vttig_jax.logs.motion.segments import find_segments


def _jumps(log: EncoderLog) -> list[Reversal]:
    segments = find_segments(log).segments
    return reversal_jumps(log.driving_angle, log.transmission_error, segments)


def _curve(turns: float, function) -> TECurve:
    angle = np.linspace(0, turns * REV, 20_000)
    return TECurve("A", angle, function(angle), angle)


def test_closure_of_a_periodic_curve(paper_pair):
    found = closure((_curve(20, lambda x: np.sin(x * 9 / 16)),), paper_pair)
    assert found is not None
    assert found.period_deg == 5760
    assert found.overlap_deg == pytest.approx(4 * 360)
    assert found.rms_deg < 1e-4
    assert abs(found.mean_deg) < 1e-4


def test_closure_shows_what_does_not_come_back(paper_pair):
    found = closure((_curve(20, lambda x: 0.001 * x / REV),), paper_pair)
    assert found is not None
    assert found.mean_deg == pytest.approx(0.016 / DEG)
    assert found.rms_deg == pytest.approx(0.016 / DEG)


def test_a_backward_curve_closes_as_well(paper_pair):
    forward = _curve(20, lambda x: 0.001 * x / REV)
    parts = (forward.driving_angle[::-1], forward.transmission_error[::-1], forward.time)
    found = closure((TECurve("B", *parts),), paper_pair)
    assert found is not None and found.mean_deg == pytest.approx(0.016 / DEG)


def test_no_closure_below_one_period(paper_pair):
    assert closure((_curve(15.9, np.sin),), paper_pair) is None


def test_jump_is_the_true_backlash_before_the_turn(clean_rig, clean_log):
    (jump,) = _jumps(clean_log)
    assert jump.turn_deg == pytest.approx(6600.0, abs=0.5)
    assert jump.driving_deg == pytest.approx(6600.0 - 3.5, abs=0.5)
    grid = np.linspace(-2.5, 2.5, 11) + jump.driving_deg
    true = clean_rig.flank_model().backlash(grid * DEG)
    assert jump.jump_deg == pytest.approx(float(np.mean(np.asarray(true))) / DEG, abs=2e-5)
    elsewhere = float(clean_rig.flank_model().backlash((jump.driving_deg - 180) * DEG)) / DEG
    assert abs(jump.jump_deg - elsewhere) > 1e-3


def test_every_reversal_has_its_jump(clean_rig):
    motion = replace(clean_rig.motion, passes=4, reversal_deg=2000.0)
    log = replace(clean_rig, motion=motion).log()
    jumps = _jumps(log)
    np.testing.assert_allclose([j.turn_deg for j in jumps], [2000, 0, 2000], atol=0.5)
    true = [float(clean_rig.flank_model().backlash(j.driving_deg * DEG)) / DEG for j in jumps]
    np.testing.assert_allclose([j.jump_deg for j in jumps], true, atol=5e-5)
    assert min(true) > 0


def test_the_papers_way_to_the_constant_backlash(clean_fit, clean_rig):
    (jump,) = clean_fit.checks.reversals
    start = vttig_jax.exact_transmission_error(0.0, clean_rig.pair, clean_rig.eccentricities)
    variable = []
    for mounting_deg in (-float(start) / DEG, 0.0):  # e₂ stands at φ₂ + θ₂, not at i φ₁ + θ₂
        rig = vttig_jax.Eccentricities(0.0226, 49.5, 0.0273, 79.3 + mounting_deg, 0.0)
        gap = vttig_jax.backlash(jump.driving_deg * DEG, clean_rig.pair, rig)
        variable.append(float(gap) / DEG)
    assert jump.variable_backlash_deg == pytest.approx(variable[0], abs=3e-7)
    assert abs(jump.variable_backlash_deg - variable[1]) > 1.2e-6
    assert jump.constant_backlash_deg == pytest.approx(0.038, abs=1e-4)


def test_checks_of_a_fit(clean_fit, clean_rig):
    checks = clean_fit.checks
    assert checks.closure is not None and checks.closure.rms_deg < 1e-4
    assert checks.drawing_backlash_deg == pytest.approx(0.0628, abs=1e-4)
    amplitudes = {(o.shaft, o.flank): o.amplitude_arcsec for o in checks.order_spectrum}
    gain = 1 / float(clean_rig.pair.base_radii[1, 0]) / DEG * 3600
    for flank in ("A", "B"):
        assert amplitudes["driving", flank] == pytest.approx(gain * 0.0226, rel=1e-3)
        assert amplitudes["driven", flank] == pytest.approx(gain * 0.0273, rel=1e-3)
    assert len(amplitudes) == 4
