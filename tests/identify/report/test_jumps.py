"""Jumps at reversals beside the gap of the fit: where they are read, and whether they agree."""

from dataclasses import replace

import numpy as np
import pytest
from msgspec.structs import replace as changed

from tests.identify.drives import drive, drive_log, level, there_and_back
from vttig_jax.identify.fit_result import Fit
from vttig_jax.identify.fitting import fit
from vttig_jax.identify.report.checks import JumpComparison
from vttig_jax.identify.report.comparisons.closure import reversal_jumps
from vttig_jax.logs.motion.segments import Segment

HALF = drive("1/2")
GAP_DEG, CROSSING_DEG = 0.3, 3.0
"""Gap of a reducer of 10:1 as an angle of the driven and of the driving shaft."""


def _reducer_jump(gap_deg: float) -> list[tuple[float, bool]]:
    """Jump and mark of one reversal at 90°, with teeth that cross the gap after it."""
    driving = np.concatenate([np.linspace(0, 90, 900), np.linspace(90, 0, 900)])
    error = np.concatenate([np.zeros(900), np.minimum(0.1 * np.linspace(0, 90, 900), GAP_DEG)])
    segments = (Segment(0, 900, "A", 1.0), Segment(900, 1800, "B", -1.0))
    jumps = reversal_jumps(np.radians(driving), np.radians(error), segments, 1, gap_deg)
    return [(jump.jump_deg, jump.crossing) for jump in jumps]


def test_a_jump_is_read_behind_the_crossing_of_the_gap():
    ((jump, crossing),) = _reducer_jump(CROSSING_DEG)
    assert jump == pytest.approx(GAP_DEG, abs=1e-9) and not crossing
    ((early, _),) = _reducer_jump(0.0)
    assert early < 0.95 * GAP_DEG


def test_a_jump_within_the_crossing_is_marked():
    ((_, crossing),) = _reducer_jump(80.0)
    assert crossing


def _with_delay(delay: str | float) -> Fit:
    """Four speeds, a gap of 0.1° and a delay of 1 ms, which at 120 rpm looks like 0.7°."""
    motion = there_and_back([30.0, 60.0, 90.0, 120.0], 6.0)
    log = drive_log(HALF, motion, gap=level(360.0), delay_s=level(1e-3))
    return fit(log, HALF, delay=delay)


def test_jumps_agree_with_the_gap_of_a_good_fit():
    result = _with_delay("auto")
    jumps = result.checks.jumps
    assert jumps is not None and jumps.agrees and jumps.count == 7
    assert jumps.median_deg == pytest.approx(0.1, abs=4 * jumps.std_deg)
    assert "the 7 jumps at reversals (median 0.1" in str(result)
    assert "disagree" not in str(result)


def test_jumps_show_that_a_delay_passes_for_a_gap():
    result = _with_delay("off")
    jumps = result.checks.jumps
    assert jumps is not None and not jumps.agrees and jumps.fitted_deg > 2 * jumps.median_deg
    (warning,) = [one for one in result.warnings if "jumps at reversals" in one]
    assert "disagree with the fitted gap there" in warning and "a delay" in warning


def test_the_comparison_allows_three_standard_errors():
    jumps = JumpComparison(5, 0.12, 0.03, 0.24, 0.03)
    assert jumps.agrees and not changed(jumps, std_deg=0.02, fitted_std_deg=0.02).agrees


def test_jumps_within_the_crossing_are_no_test(quick_fit):
    """The section of the checks says so where no other jump is there."""
    marked = tuple(changed(one, crossing=True) for one in quick_fit.checks.reversals)
    checks = changed(quick_fit.checks, reversals=marked, jumps=None)
    assert "no test of it" in str(replace(quick_fit, checks=checks))
    assert "no test of it" not in str(quick_fit)
