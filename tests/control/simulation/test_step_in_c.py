"""The whole step against the same formulas in C: state and metrics after a whole reversal."""

import numpy as np
import pytest

from benchmarks.simulation_cases import BASE, cases_of, periods_for
from benchmarks.step_in_c import CC, FAST, StepInC, difference, scanned
from vttig_jax.base.runtime import enable_x64

enable_x64()

LANES = 256

pytestmark = pytest.mark.skipif(CC is None, reason="no C compiler (`cc`) on this machine")


def test_the_scan_is_what_c_makes_of_the_same_formulas(tmp_path):
    # With this margin some lanes close too far, others bounce in what is left open.
    short = {"motion.dwell_s": 0.05, "motion.ramp_s": 0.2, "judgement.margin_mm": 0.05}
    cases = cases_of(LANES, {**BASE, **short}, turns=(120.0, 240.0))
    periods, program = periods_for(cases), StepInC(tmp_path, FAST)
    found, expected = program.run(program.prepared(cases), periods), scanned(cases, periods)
    differs = difference(found, expected)
    assert max(differs.values()) <= 1e-9, differs
    # Subnormal numbers are left in the process.
    smallest = np.finfo(np.float64).tiny
    assert float(smallest) / 2 > 0 and (np.full(8, smallest) / 2 > 0).all()
