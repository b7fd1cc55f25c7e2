"""Counts of the driving shaft that are locked to the clock: one rounding error in every run."""

import numpy as np
import pytest

from tests.logs.profiles import played
from vttig_jax.identify import fit
from vttig_jax.logs import EncoderLog
from vttig_jax.pair import parse_pair_spec
from vttig_jax.pair.gear_pair import pair_from_spec

pytestmark = pytest.mark.slow

COUNTS, GAP_DEG, RATIO = 10_000, 0.0951, 23 / 64
ENCODERS = {
    shaft: {"encoder": {"counts_per_rev": size}}
    for shaft, size in (("driving", COUNTS), ("driven", 65536))
}
DRIVE = pair_from_spec(parse_pair_spec({"drive": {"ratio": "23/64"}} | ENCODERS))


def log_of(seed, counts_per_sample):
    """Return eight passes at a thousand samples a second, a servo's ramps between them."""
    draw, turns, parts = np.random.default_rng(seed), 0.0, []
    turns = draw.uniform() / COUNTS
    for k in range(8):
        step = counts_per_sample * draw.choice([1.0, 1.5, 2.0]) * (-1) ** k / COUNTS
        ramp = np.linspace(0.0, 1.0, 60)
        speed = step * np.concatenate([ramp, np.ones(int(5 / abs(step))), ramp[::-1], np.zeros(40)])
        parts.append(turns + np.cumsum(speed))
        turns = parts[-1][-1] + draw.uniform() / COUNTS
    driving = np.concatenate(parts)
    angle = 2 * np.pi * driving
    wave = (130 * np.sin(angle + 0.2) + 95 * np.sin(RATIO * angle + 2.7)) / 3600
    low = RATIO * 360 * driving + wave - GAP_DEG / 2
    driven = played(low, GAP_DEG) + draw.normal(0, 2 / 3600, len(low))
    counts = np.floor(driving * COUNTS).astype(int), np.floor(driven / 360 * 65536).astype(int)
    time = np.arange(len(low)) / 1000.0
    return EncoderLog.from_arrays(time, *counts, pair=DRIVE, unit="counts")


@pytest.mark.parametrize("seed", range(3))
def test_gap_and_delay_hold_the_truth_and_the_lock_is_told(seed):
    """Without the offsets of the runs the gap was four to six standard errors off, unsaid."""
    found = fit(log_of(seed, 30.0), DRIVE)
    assert "counts-locked" in {one.slug for one in found.findings}
    gap, delay = (found.parameters[name] for name in ("constant_backlash_deg", "delay_s"))
    assert gap.value is not None and gap.std is not None
    assert abs(gap.value - GAP_DEG) < 3.5 * gap.std
    assert not delay.significant


def test_counts_that_are_not_locked_tell_gap_and_delay():
    found = fit(log_of(0, 30.3819), DRIVE)
    gap = found.parameters["constant_backlash_deg"]
    assert "counts-locked" not in {one.slug for one in found.findings}
    assert gap.value is not None and gap.std is not None
    assert abs(gap.value - GAP_DEG) < 3.5 * gap.std < 0.005
