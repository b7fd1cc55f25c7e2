"""Logs without a gap, without noise, and of rounded readings."""

from dataclasses import replace

import numpy as np
import pytest

import vttig_jax
from tests.identify.quick import TRUTH
from vttig_jax.base import DEG
from vttig_jax.identify import fit
from vttig_jax.logs import EncoderLog
from vttig_jax.rig import PassMotion, paper_pair
from vttig_jax.rig.paper import ERN180

RATE = 500.0
COUNTS = ERN180.counts_per_rev / 360 if ERN180.counts_per_rev else 0.0
KINDS = ["angles", "noise", "noisy counts"]


def _log(kind: str, gap_deg: float = 0.0, seed: int = 0) -> EncoderLog:
    """Nineteen reversals; the same transmission error both ways but for `gap_deg`."""
    motion = PassMotion(reversal_deg=1200.0, dwell_s=0.2, ramp_s=0.2, passes=20)
    time = np.arange(int(motion.duration_s * RATE) + 1) / RATE
    driving = motion.driving_angle(time)
    driven = 45 / 80 * driving
    driven = driven + 3e-4 * np.sin(driving + 0.5) + 2e-4 * np.sin(45 / 80 * driving + 1.0)
    backward = np.gradient(driving) < 0
    driven = driven + np.where(backward, gap_deg * DEG, 0.0)
    if kind.startswith("nois"):
        driven = driven + 2e-5 * np.random.default_rng(seed).standard_normal(len(time))
    angles = [(angle - angle[0]) / DEG for angle in (driving, driven)]
    if "counts" in kind:
        counts = [np.floor(angle * COUNTS).astype(np.int64) for angle in angles]
        return EncoderLog.from_arrays(time, *counts, pair=paper_pair())
    return EncoderLog.from_arrays(time, *angles, pair=paper_pair(), unit="deg")


@pytest.mark.portable
@pytest.mark.parametrize(
    ("kind", "seed"), [("angles", 0), ("noise", 0), *(("noisy counts", seed) for seed in range(2))]
)
def test_no_gap_is_reported_where_there_is_none(kind, seed):
    result = fit(_log(kind, seed=seed), paper_pair())
    for name in ("constant_backlash_deg", "delay_s"):
        parameter = result.parameters[name]
        assert parameter.determined and not parameter.significant, name
    gap = result.parameters["constant_backlash_deg"]
    assert seed or abs(gap.value or 0.0) < 2e-4
    assert "drift" not in {one.slug for one in result.findings}
    assert len(result.checks.reversals) == 19


@pytest.mark.parametrize("kind", KINDS)
def test_a_gap_below_a_count_would_be(kind):
    """A count is 0.004°."""
    gap = fit(_log(kind, 3e-3), paper_pair()).parameters["constant_backlash_deg"]
    assert gap.significant
    assert gap.value == pytest.approx(3e-3, abs=max(4 * (gap.std or 0.0), 1e-6))


@pytest.mark.parametrize("turns", [6, 20])
def test_the_truth_comes_back_and_the_lack_of_noise_is_said(clean_rig, turns):
    rig = replace(clean_rig, motion=PassMotion(speed_rpm=180.0, reversal_deg=360.0 * turns))
    result = fit(rig.log(), rig.pair)
    for name, value in TRUTH.items():
        assert result.value(name) == pytest.approx(value, rel=5e-3), name
    assert result.value("driving_encoder_arcsec") == pytest.approx(0.0, abs=0.3)
    assert result.outcome == "ok" and result.residual_rms_deg < 1e-5
    assert "no-noise" in {one.slug for one in result.findings}


def test_rounded_volts_of_one_direction_have_an_answer(tmp_path):
    """The likeliest noise of one pass has no density after the next step of the delay.

    The log is steady and without noise, so that nothing but its rounding could tell a delay.
    """
    row = np.arange(120)
    volts = [np.round(10 * row * share / 360 * 5 % 5, 4) for share in (1.0, 0.5)]
    path = tmp_path / "log.csv"
    table = np.column_stack([0.05 * row, *volts])
    np.savetxt(path, table, "%.4f", ",", header="time_s,motor [V],load [V]", comments="")
    found = vttig_jax.fit(vttig_jax.read_log(path, ratio="2:1", counts=(5, 5)))
    delay = found.parameters["delay_s"]
    assert delay.value is None and delay.reason == "the search ended before it stood still"
    assert "not-settled" in {one.slug for one in found.findings}
