"""Logs in which both shafts make a part of a turn: only the gap over the covered angles is told."""

from fractions import Fraction

import numpy as np
import pytest

from tests.identify.drives import known
from vttig_jax.identify.compress.block_rows import samples_per_row
from vttig_jax.identify.fitting import fit
from vttig_jax.identify.model.harmonics import plan_terms
from vttig_jax.logs.encoder_log import EncoderLog
from vttig_jax.logs.motion.segments import Segment
from vttig_jax.pair.gear_pair import Drive

GAP_DEG = 0.2


def arc_log(
    arc_deg: float,
    ratio: Fraction,
    *,
    trips: int = 3,
    rate_hz: float = 100.0,
    speed_deg_s: float = 30.0,
    error_deg: float = 0.05,
    noise_deg: float = 0.001,
    seed: int = 0,
) -> EncoderLog:
    """Log of a drive that swings over an arc, with orders 1 to 3 of both shafts and a gap."""
    rng = np.random.default_rng(seed)
    count = int(arc_deg / speed_deg_s * rate_hz)
    forth = np.linspace(0.0, arc_deg, count)
    driving = np.tile(np.concatenate([forth, forth[::-1]]), trips)
    phase = rng.uniform(0, 2 * np.pi, (2, 3))
    middle = driving * float(ratio)
    for k in (1, 2, 3):
        angles = np.radians([driving, driving * float(ratio)])
        middle += error_deg / k**2 * np.sin(k * angles + phase[:, k - 1, None]).sum(axis=0)
    driven = np.empty_like(middle)
    driven[0] = middle[0] - GAP_DEG / 2
    for k in range(1, len(middle)):
        low, high = middle[k] - GAP_DEG / 2, middle[k] + GAP_DEG / 2
        driven[k] = min(max(driven[k - 1], low), high)
    noise = rng.normal(0, noise_deg, (2, len(middle)))
    time = np.arange(len(middle)) / rate_hz
    return EncoderLog.from_arrays(
        time, driving + noise[0], driven + noise[1], pair=Drive(ratio), unit="deg"
    )


@pytest.mark.parametrize(
    ("arc_deg", "ratio", "trips"),
    [(20, "1", 4), (100, "9/16", 1), (187, "1/6", 3), (300, "9/16", 5), (500, "9/16", 5)],
)
def test_the_gap_is_told_although_no_order_is(arc_deg, ratio, trips):
    result = fit(
        arc_log(arc_deg, Fraction(ratio), trips=trips), Drive(Fraction(ratio)), delay="off"
    )
    gap = result.checks.gap_over_angles_covered
    assert result.outcome == "not_determined" and not result.orders
    low, high = known(gap.low95), known(gap.high95)
    assert low <= GAP_DEG <= high
    assert high - low < (0.3 if trips > 1 else 3) * GAP_DEG


def test_a_log_of_a_few_samples_has_a_wide_gap_and_no_traceback():
    """Eight samples a flank: the runs are too short to show how their noise scatters."""
    result = fit(arc_log(10, Fraction(1), trips=1), Drive(Fraction(1)), delay="off")
    short = fit(arc_log(10, Fraction(1), trips=1, rate_hz=30.0), Drive(Fraction(1)), delay="off")
    widths = []
    for one in (result, short):
        gap = one.checks.gap_over_angles_covered
        low, high = known(gap.low95), known(gap.high95)
        assert low <= GAP_DEG <= high
        widths.append(high - low)
    assert short.samples["used"] == 16
    assert widths[1] > widths[0]


@pytest.mark.parametrize(("turns", "rows"), [(0.1, 32), (0.5, 32), (1.0, 32), (4.0, 128)])
def test_a_part_of_a_turn_has_as_many_rows_as_a_turn(turns, rows):
    driving = np.linspace(0.0, 2 * np.pi * turns, 6401)
    whole = [Segment(0, len(driving), "A", 1.0)]
    terms = plan_terms(
        Fraction(9, 16), driving_orders=(1,), driven_orders=(1,), mesh_orders=0, driving_teeth=None
    )
    found = len(driving) / samples_per_row(driving, whole, terms)
    assert rows <= found < 1.1 * rows
