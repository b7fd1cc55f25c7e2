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
