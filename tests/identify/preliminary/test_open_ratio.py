"""A ratio that is given slightly wrong, on few turns of a drive."""

import numpy as np
import pytest

from tests.identify.drives import drive, drive_log, known, level, there_and_back
from vttig_jax.identify.fitting import fit
from vttig_jax.identify.preliminary import model_selection
from vttig_jax.logs.encoder_log import EncoderLog

PAIR = drive("1/2")
GAP_DEG = 150 / 3600
SLIP = 1.002


@pytest.fixture(scope="module")
def log() -> EncoderLog:
    """Three turns and 4.5 turns both ways at a ratio 0.2 % above that of the pair."""
    return drive_log(
        PAIR,
        there_and_back([60, 90], 3),
        gap=level(150.0),
        error=lambda angle, _: 20 * np.sin(angle + 0.3) + 30 * np.sin(angle / 2 + 1),
        ratio=0.5 * SLIP,
    )


def test_the_ratio_is_fitted_and_the_gap_is_right(log):
    result = fit(log, PAIR)
    (ratio,) = [one for one in result.regressors if one.name == "ratio"]
    assert known(ratio.value) == pytest.approx(0.5 * SLIP, rel=1e-5)
    for found in (
        result.parameters["constant_backlash_deg"],
        result.checks.gap_over_angles_covered,
    ):
        assert known(found.value) == pytest.approx(GAP_DEG, abs=5e-4)


def test_with_a_fixed_ratio_the_gap_is_lost(log, monkeypatch):
    """The slope then passes for noise that remembers for the whole log."""
    monkeypatch.setattr(model_selection, "_has_open_ratio", lambda *_: False)
    gap = fit(log, PAIR).parameters["constant_backlash_deg"]
    low, high = known(gap.low95), known(gap.high95)
    assert low < GAP_DEG < high and high - low > 10 * GAP_DEG


def joint_log(given: str) -> EncoderLog:
    """Twenty turns of a motor that turn the joint by a tenth; read with the ratio `given`."""
    return drive_log(
        drive(given),
        there_and_back([60, 120], 10),
        gap=level(20.0),
        error=lambda angle, _: 20 * np.sin(angle + 0.3),
        delay_s=level(2e-3),
        ratio=1 / 200,
    )


@pytest.mark.parametrize(("given", "freed"), [("1/200", False), ("0.00505", True)])
def test_a_ratio_is_freed_where_a_part_of_a_driven_turn_contradicts_it(given, freed):
    """The first order of the joint hides a slope that is 1 % off."""
    result = fit(joint_log(given), drive(given))
    ratios = [one.value for one in result.regressors if one.name == "ratio"]
    assert ratios == (pytest.approx([1 / 200], rel=1e-5) if freed else [])
    assert any("the ratio comes out" in note for note in result.notes) == freed
    delay = result.parameters["delay_s"]
    assert known(delay.low95) < 2e-3 < known(delay.high95)


def test_a_wrong_ratio_that_is_kept_leaves_its_slope(monkeypatch):
    freed = fit(joint_log("0.00505"), drive("0.00505"))
    monkeypatch.setattr(model_selection, "_demands_a_ratio", lambda *_: False)
    kept = fit(joint_log("0.00505"), drive("0.00505"))
    assert kept.residual_rms_deg > 10 * freed.residual_rms_deg


def arm_log(given: str, *, slip: float = 1.0) -> EncoderLog:
    """Five turns of a motor, two thirds of a turn of the arm that it drives."""
    return drive_log(
        drive(given),
        there_and_back([60, 120, 90], 2.5),
        gap=level(900.0),
        error=lambda angle, _: 100 * np.sin(angle + 0.3) + 140 * np.sin(8.728 * angle),
        ratio=slip / 7.3,
    )


def test_on_few_turns_and_a_part_of_a_driven_turn_the_ratio_is_as_given():
    """A free ratio and the first order of the arm could cancel each other at any size."""
    result = fit(arm_log("10/73"), drive("10/73"))
    assert [one for one in result.regressors if one.name == "ratio"] == []
    assert known(result.checks.gap_over_angles_covered.value) == pytest.approx(0.25, abs=2e-3)


def test_there_a_ratio_that_the_log_contradicts_is_freed():
    result = fit(arm_log("10/73", slip=1.004), drive("10/73"))
    (ratio,) = [one for one in result.regressors if one.name == "ratio"]
    assert known(ratio.value) == pytest.approx(1.004 / 7.3, rel=5e-4)
