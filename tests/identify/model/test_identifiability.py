"""Logs too short for what is asked of them: no answer, or undetermined with a reason."""

from dataclasses import replace

import equinox as eqx
import numpy as np
import pytest

from tests.identify.drives import known
from vttig_jax.base.errors import NoAnswerError
from vttig_jax.identify.fitting import fit
from vttig_jax.logs.encoder_log import EncoderLog
from vttig_jax.pair.schema import HarmonicOrders
from vttig_jax.rig.motion import PassMotion


def _turns(rig, turns: float, **changes) -> EncoderLog:
    motion = PassMotion(reversal_deg=360.0 * turns, ramp_s=0.1, **changes)
    return replace(rig, motion=motion).log()


@pytest.mark.parametrize("turns", [0.1, 0.8])
def test_under_one_turn_only_the_gap_is_determined(noisy_rig, turns):
    log = _turns(noisy_rig, turns)
    result = fit(log, noisy_rig.pair, delay="off")
    assert result.outcome == "not_determined"
    gap = result.checks.gap_over_angles_covered
    low, high = known(gap.low95), known(gap.high95)
    assert low <= _mean_gap(noisy_rig, log, gap.covered_deg) <= high
    assert high - low < 0.3
    assert "tells only the gap over" in result.warnings[0] and gap.in_words in result.warnings[0]


def _mean_gap(rig, log: EncoderLog, covered_deg: float) -> float:
    """Return the mean of the true gap over the middle `covered_deg` degrees of the log, deg."""
    middle = (log.driving_angle.max() + log.driving_angle.min()) / 2
    half = np.radians(covered_deg) / 2
    angles = middle + np.linspace(-half, half, 200)
    return float(np.degrees(np.mean(rig.flank_model().backlash(angles))))


def test_under_one_turn_one_direction_has_no_answer(noisy_rig):
    with pytest.raises(NoAnswerError, match="no shaft turned a full revolution") as caught:
        fit(_turns(noisy_rig, 0.8), noisy_rig.pair, flank="A")
    assert caught.value.exit_code == 4


@pytest.mark.parametrize("turns", [1.2, 1.7, 2.2])
def test_too_short_to_hold_the_shafts_apart(noisy_rig, turns):
    """Nothing is reported rather than a wrong number with a small error."""
    result = fit(_turns(noisy_rig, turns), noisy_rig.pair)
    assert result.outcome == "not_determined"
    for shaft in ("driving", "driven"):
        reason = result.parameters[f"{shaft}_eccentricity_mm"].reason or ""
        assert "neither shaft's first order is resolved" in reason
    assert "turned too little to tell" in (result.parameters["constant_backlash_deg"].reason or "")


def test_a_slow_shaft_that_turned_too_little_does_not_bias_the_fast_one(clean_rig):
    """1/5: the driving gear turns four times, the driven one 0.7 times steadily."""
    pair = eqx.tree_at(
        lambda p: (p.driving, p.driven, p.centre_distance_mm),
        clean_rig.pair,
        (
            replace(clean_rig.pair.driving, teeth=20),
            replace(clean_rig.pair.driven, teeth=100),
            np.asarray(120.1),
        ),
    )
    rig = replace(clean_rig, pair=pair, motion=PassMotion(reversal_deg=1460.0))
    result = fit(rig.log(), pair)
    short = result.parameters["driven_eccentricity_mm"]
    assert not short.determined and "turned 0.7" in (short.reason or "")
    assert not result.parameters["constant_backlash_deg"].determined
    assert result.value("driving_eccentricity_mm") == pytest.approx(0.0226, rel=1e-3)
    assert result.value("driving_phase_deg") == pytest.approx(49.5, abs=0.1)
    assert float(result.eccentricities().driven_mm) == 0.0
    assert {order.shaft for order in result.orders} == {"driving", "mesh"}


@pytest.mark.parametrize("rate_hz", [11.0, 15.4])
def test_more_coefficients_than_rows_is_no_answer(noisy_rig, rate_hz):
    orders = tuple(range(1, 9))
    options = HarmonicOrders(driving_orders=orders, driven_orders=orders, mesh_orders=1)
    log = replace(noisy_rig, rate_hz=rate_hz, motion=PassMotion(reversal_deg=1300.0)).log()
    with pytest.raises(NoAnswerError, match=r"are too few for \d+ coefficients") as caught:
        fit(log, noisy_rig.pair, orders=options)
    assert caught.value.exit_code == 4
