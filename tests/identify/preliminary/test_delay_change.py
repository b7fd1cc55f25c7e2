"""A delay that changes within a log, against a ratio that is slightly wrong."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tests.identify.drives import drive, drive_log, level, there_and_back
from vttig_jax.identify import build_result
from vttig_jax.identify.fit_result import Fit
from vttig_jax.identify.fitting import fit
from vttig_jax.identify.preliminary import model_selection
from vttig_jax.identify.preliminary.delay_change import DelayChange, Slope
from vttig_jax.identify.report.estimate import Estimate
from vttig_jax.logs.encoder_log import EncoderLog
from vttig_jax.pair.gear_pair import Drive

Motion = tuple[list[float], list[float]]
PAIR = drive("1/250")
MOTION = there_and_back([700.0, 300.0, 500.0], 1.5)


def _log(
    pair: Drive, motion: Motion, *, first_s: float, late_s: float, **options: Any
) -> EncoderLog:
    """A log whose delay is `first_s` in its first half and larger by `late_s` in the second."""

    def delay_s(time: np.ndarray, _: np.ndarray) -> np.ndarray:
        return first_s + late_s * (time > time.mean())

    return drive_log(pair, motion, delay_s=delay_s, **options)


def _warnings(ratio_ppm: float, late_s: float) -> list[str]:
    """Sentences on the change of the delay in the fit of a log with a wrong ratio."""
    ratio = (1 + 1e-6 * ratio_ppm) / 250
    of_rig = {"gap": level(0.0), "noise_arcsec": 10.0, "rate_hz": 250.0, "ratio": ratio}
    log = _log(PAIR, MOTION, first_s=2e-3, late_s=late_s, **of_rig)
    return [one for one in fit(log, PAIR).warnings if one.startswith("the delay changes by")]


@pytest.fixture
def given_ratio(monkeypatch: pytest.MonkeyPatch) -> None:
    """Keep the given ratio, however clearly a log contradicts it."""
    monkeypatch.setattr(model_selection, "_WRONG_RATIO", np.inf)


def test_a_wrong_ratio_is_named_where_it_explains_more(given_ratio):
    (sentence,) = _warnings(500.0, 0.0)
    assert "a ratio +497 ± 9 ppm off" in sentence and "explains the log better" in sentence


def test_a_delay_that_does_change_names_no_ratio(given_ratio):
    (sentence,) = _warnings(0.0, 1e-3)
    assert sentence.endswith("under changing load does this") and "ratio" not in sentence


def test_right_ratio_and_constant_delay_give_no_sentence(given_ratio):
    assert _warnings(0.0, 0.0) == []


def test_explanations_that_cannot_be_told_apart_are_both_named():
    change = DelayChange(-2.2e-4, 6e-5, Slope(-534.0, 68.0, 1.5))
    assert "-534 ± 68 ppm off" in change.sentence
    assert "explains the log as well (2 ΔlnL = 1.5" in change.sentence
    assert "a clock that drifts" in change.sentence
    apart = replace(change, slope=Slope(-534.0, 68.0, 10.1))
    assert "ratio" not in apart.sentence


@pytest.mark.parametrize(
    ("late_s", "rpms"),
    [(0.0, [200.0, 400.0, 600.0]), (-2e-3, [200.0, 400.0, 600.0]), (-0.5e-3, [600.0, 200.0])],
)
def test_the_gap_contains_that_of_a_fit_with_two_delays(
    late_s: float, rpms: list[float], monkeypatch
):
    """All runs forth precede all runs back, so that a drift takes the place of a changed delay.

    Delays of +1 and −1 ms have the mean zero, which the fit takes for no delay.
    """
    pair = drive("5/6")
    speeds = [*rpms, *(-rpm for rpm in rpms)]
    motion = [0.3, *([0.2, 3.0, 0.2, 0.3] * len(speeds))], [0.0]
    for rpm in speeds:
        motion[1].extend([rpm, rpm, 0.0, 0.0])
    of_rig = {"gap": level(3600.0), "noise_arcsec": 200.0}
    log = _log(pair, motion, first_s=1e-3, late_s=late_s, **of_rig)
    found = fit(log, pair)
    intervals = _intervals(found)
    assert len(intervals) == 2
    for low, high, truth in intervals:
        assert low < truth < high
    assert any("the delay changes by" in one for one in found.warnings) == (late_s != 0)
    delay = found.parameters["delay_s"]
    assert delay.std is not None and 1.96 * delay.std >= 0.29 * abs(late_s)
    monkeypatch.setattr(build_result, "beside", lambda solved, *_, **__: (solved, 1.0))
    monkeypatch.setattr(Estimate, "rivals", ())
    holds = [low < truth < high for low, high, truth in _intervals(fit(log, pair))]
    assert all(holds) == (late_s == 0)


def _intervals(found: Fit) -> list[tuple[float, float, float]]:
    """Interval of the gap and of the constant backlash, deg, each with the truth."""
    gap, constant = found.checks.gap_over_angles_covered, found.parameters["constant_backlash_deg"]
    bounds = [(one.low95, one.high95) for one in (gap, constant)]
    return [(low, high, 1.0) for low, high in bounds if low is not None and high is not None]
