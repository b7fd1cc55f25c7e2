"""Simulated logs without noise: the truth comes back, and the fit says that there is no noise."""

from dataclasses import replace

import numpy as np
import pytest

import vttig_jax
from tests.identify.quick import TRUTH
from vttig_jax.identify.identification import fit
from vttig_jax.rig.motion import PassMotion

STAYS = "the largest density of ten turns has noise, and a drift and a delay that are not there"


@pytest.mark.parametrize(
    "turns", [6, pytest.param(10, marks=pytest.mark.xfail(reason=STAYS, strict=True)), 20]
)
def test_the_truth_comes_back_and_the_lack_of_noise_is_said(clean_rig, turns):
    rig = replace(clean_rig, motion=PassMotion(speed_rpm=180.0, reversal_deg=360.0 * turns))
    result = fit(rig.log(), rig.pair)
    for name, value in TRUTH.items():
        if not name.endswith("phase_deg"):
            assert result.value(name) == pytest.approx(value, rel=5e-3), name
    assert "no-noise" in {one.slug for one in result.findings}


@pytest.mark.parametrize("flank", ["A", "B"])
def test_one_flank_alone(clean_rig, flank):
    rig = replace(clean_rig, motion=PassMotion(speed_rpm=180.0, reversal_deg=3600.0))
    result = fit(rig.log(), rig.pair, flank=flank)
    assert result.value("driving_eccentricity_mm") == pytest.approx(0.0226, rel=5e-3)


def test_rounded_volts_of_one_direction_have_an_answer(tmp_path):
    """The likeliest noise of one pass has no density after the next step of the delay."""
    row = np.arange(120)
    volts = [np.round(10 * row * share / 360 * 5 % 5, 4) for share in (1.0, 0.5)]
    path = tmp_path / "log.csv"
    table = np.column_stack([0.05 * row, *volts])
    np.savetxt(path, table, "%.4f", ",", header="time_s,motor [V],load [V]", comments="")
    found = vttig_jax.fit(vttig_jax.read_log(path, ratio="2:1", counts=(5, 5)))
    delay_s = found.parameters["delay_s"].value
    assert delay_s is not None and abs(delay_s) < 0.05
