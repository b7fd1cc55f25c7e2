"""Ramps beyond the steady motion, where the error of a shaft that hardly turns is unknown."""

import numpy as np

from tests.identify.drives import drive, drive_log, known, level
from vttig_jax.identify.fitting import fit
from vttig_jax.identify.preliminary.ramps import is_among_steady
from vttig_jax.logs.motion.flank_assignment import assigned_segments, find_ramps

PAIR = drive("1/100")
GAP_DEG = 0.02
MOTION = (0.3, 4, 6, 4, 0.3, 4, 6, 4, 0.3), (0, 120, 120, 0, 0, -120, -120, 0, 0)
"""Ramps of eight turns beside twelve steady turns, which are 0.12 turn of the driven shaft."""


def test_the_delay_is_not_told_by_ramps_at_other_angles():
    """The error of the driven shaft bends there, as a delay would."""
    log = drive_log(
        PAIR,
        MOTION,
        gap=level(3600 * GAP_DEG),
        error=lambda angle, _: 150.0 * np.sin(angle / 100 - 0.8),
    )
    found = assigned_segments(log)
    ramps = find_ramps(log, found)
    assert len(ramps) == 4
    assert not any(is_among_steady(log, ramp, found.segments) for ramp in ramps)
    result = fit(log, PAIR, drift_order=0)
    assert not any("count for the delay" in note for note in result.notes)
    gap = result.checks.gap_over_angles_covered
    assert known(gap.low95) < GAP_DEG < known(gap.high95)
