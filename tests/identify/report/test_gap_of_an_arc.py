"""Logs in which both shafts make a part of a turn: only the gap over the covered angles is told."""

from fractions import Fraction

import numpy as np
import pytest

from tests.identify.drives import drive, drive_log, known, level, there_and_back
from vttig_jax.identify.compress.block_rows import samples_per_row
from vttig_jax.identify.fitting import fit
from vttig_jax.identify.model.harmonics import plan_terms
from vttig_jax.logs.encoder_log import EncoderLog
from vttig_jax.logs.motion.segments import Segment

GAP_DEG = 0.2
SPEED_RPM = 5.0


def arc_log(
    arc_deg: float, ratio: str, *, trips: int = 3, rate_hz: float = 100.0, ramp_s: float = 0.05
) -> EncoderLog:
    """Log of a drive that swings over an arc, with orders 1 to 3 of both shafts and a gap."""
    share = float(Fraction(ratio))

    def error(angle, _):
        waves = [np.sin(k * a + k) / k**2 for k in (1, 2, 3) for a in (angle, angle * share)]
        return 180 * np.sum(waves, axis=0)

    return drive_log(
        drive(ratio),
        there_and_back([SPEED_RPM] * trips, arc_deg / (6 * SPEED_RPM), ramp_s),
        gap=level(3600 * GAP_DEG),
        error=error,
        noise_arcsec=4.0,
        rate_hz=rate_hz,
    )


@pytest.mark.parametrize(
    ("arc_deg", "ratio", "trips"),
    [(20, "1", 4), (100, "9/16", 1), (187, "1/6", 5), (300, "9/16", 5), (500, "9/16", 5)],
)
def test_the_gap_is_told_although_no_order_is(arc_deg, ratio, trips):
    result = fit(arc_log(arc_deg, ratio, trips=trips), drive(ratio), delay="off")
    gap = result.checks.gap_over_angles_covered
    assert result.outcome == "not_determined" and not result.orders
    low, high = known(gap.low95), known(gap.high95)
    assert low <= GAP_DEG <= high
    assert high - low < (0.3 if trips > 1 else 3) * GAP_DEG


def test_a_log_of_a_few_samples_tells_its_gap():
    """Ten samples a flank: the runs are too short to show how their noise scatters."""
    result = fit(arc_log(10, "1", trips=1, rate_hz=40.0), drive("1"), delay="off")
    gap = result.checks.gap_over_angles_covered
    assert result.samples["used"] == 20
    assert known(gap.low95) <= GAP_DEG <= known(gap.high95)


@pytest.mark.parametrize(("turns", "rows"), [(0.1, 32), (0.5, 32), (1.0, 32), (4.0, 128)])
def test_a_part_of_a_turn_has_as_many_rows_as_a_turn(turns, rows):
    driving = np.linspace(0.0, 2 * np.pi * turns, 6401)
    whole = [Segment(0, len(driving), "A", 1.0)]
    terms = plan_terms(
        Fraction(9, 16), driving_orders=(1,), driven_orders=(1,), mesh_orders=0, driving_teeth=None
    )
    found = len(driving) / samples_per_row(driving, whole, terms)
    assert rows <= found < 1.1 * rows
