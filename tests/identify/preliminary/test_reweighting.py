"""Robust passes on logs of which a tenth is wild, against the same logs before."""

import numpy as np
import pytest

from tests.identify.quick import errors, quick_rig, scores
from vttig_jax.identify.fitting import fit
from vttig_jax.logs.encoder_log import EncoderLog

SEEDS = (0, 1, 3)
"""With the last one the very first sample is wild."""

SHARE = 0.1
COUNTS = 90_000 / 360


def _wild(seed: int, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Which samples, and by how many counts: 1° to 4°, always one way."""
    generator = np.random.default_rng(seed)
    hit = generator.random(count) < SHARE
    return hit, np.rint(np.where(hit, generator.uniform(1, 4, count), 0) * COUNTS).astype(np.int64)


def _spoiled(log: EncoderLog, pair, seed: int, channel: str) -> EncoderLog:
    _, off = _wild(seed, len(log))
    assert log.driven is not None
    driving, driven = log.driving.reading, log.driven.reading
    if channel == "driven":
        driven = driven - off
    else:
        driving = driving - off
    return EncoderLog.from_arrays(log.time, driving, driven, pair=pair)


@pytest.fixture(scope="module")
def clean():
    found = {}
    for delay_s in (0.0, 3e-3):
        for seed in SEEDS:
            rig = quick_rig(seed, delay_s)
            log = rig.log(seed)
            found[delay_s, seed] = rig, log, fit(log, rig.pair)
    return found


def _relative(results, references) -> float:
    """Rms error of all parameters over all seeds, in standard errors of the clean logs."""
    parts = [
        error / (reference.parameters[name].std or np.nan)
        for result, reference in zip(results, references, strict=True)
        for name, error in errors(result).items()
    ]
    return float(np.sqrt(np.mean(np.square(parts))))


CASES = [
    ("auto", "driven", 0.0),
    ("auto", "driving", 3e-3),
    ("huber", "driven", 0.0),
    pytest.param("auto", "driving", 0.0, marks=pytest.mark.slow),
    pytest.param("auto", "driven", 3e-3, marks=pytest.mark.slow),
    pytest.param("huber", "driving", 0.0, marks=pytest.mark.slow),
]
"""Each loss, channel and delay is in a quick case; the slow ones are the other combinations."""


@pytest.mark.parametrize(("loss", "channel", "delay_s"), CASES)
def test_a_tenth_of_wild_readings_costs_little(clean, loss, channel, delay_s):
    rigs, logs, before = zip(*(clean[delay_s, seed] for seed in SEEDS), strict=True)
    spoiled = [
        _spoiled(log, rig.pair, seed, channel)
        for rig, log, seed in zip(rigs, logs, SEEDS, strict=True)
    ]
    results = [fit(log, rig.pair, loss=loss) for log, rig in zip(spoiled, rigs, strict=True)]
    assert _relative(results, before) <= 1.3 * _relative(before, before)
    for result in results:
        if loss == "auto":
            delay = result.parameters["delay_s"]
            assert delay.value == pytest.approx(delay_s, abs=1.5e-5)
            assert max(abs(score) for score in scores(result).values()) < 4.5


def test_standard_errors_of_a_huber_fit_know_the_wild_readings(clean):
    rig, log, before = clean[0.0, 0]
    result = fit(_spoiled(log, rig.pair, 0, "driven"), rig.pair, loss="huber")
    for name in ("driving_eccentricity_mm", "constant_backlash_deg"):
        assert (result.parameters[name].std or 0.0) > 0.9 * (before.parameters[name].std or 0.0)


def test_a_loss_named_outright_is_the_one_auto_takes(clean):
    rig, log, _ = clean[0.0, 0]
    bad = _spoiled(log, rig.pair, 0, "driven")
    auto, named = (fit(bad, rig.pair, loss=loss) for loss in ("auto", "bisquare"))
    assert auto.parameters == named.parameters
    assert auto.checks.outliers == named.checks.outliers
    huber = fit(bad, rig.pair, loss="huber")
    assert huber.checks.outliers[0].loss == "huber"
    assert huber.parameters != named.parameters


def test_squares_do_visibly_worse(clean):
    """What the bound of 1.3 above is worth; wild driving readings are bridged under any loss."""
    for seed in SEEDS[:2]:
        rig, log, before = clean[0.0, seed]
        bad = fit(_spoiled(log, rig.pair, seed, "driven"), rig.pair, loss="square")
        assert bad.checks.outliers == ()
        assert not _relative([bad], [before]) < 20 * _relative([before], [before])
        assert bad.residual_rms_deg > 100 * before.residual_rms_deg


def test_wild_driving_readings_are_bridged(clean):
    rig, log, before = clean[0.0, 0]
    bad = _spoiled(log, rig.pair, 0, "driving")
    result = fit(bad, rig.pair, loss="square")
    assert _relative([result], [before]) <= 1.5 * _relative([before], [before])
    assert any("a fit interpolates them" in note for note in result.notes)


def test_what_is_told_of_them(clean):
    """A driven reading too low stands below the fit."""
    rig, log, _ = clean[0.0, 0]
    bad = _spoiled(log, rig.pair, 0, "driven")
    result = fit(bad, rig.pair)
    (found,) = result.checks.outliers
    hit, off = _wild(0, len(log))
    assert found.loss == "bisquare" and 1 < found.passes <= 20
    # A Gaussian residual counts less than half in one case of a hundred.
    assert found.share == pytest.approx(np.mean(hit) + 0.01, abs=0.012)
    assert found.positive == pytest.approx(0.0, abs=0.1)
    assert found.scale_deg == pytest.approx(0.0025, rel=0.2)
    largest = off.max() / COUNTS
    assert found.largest_deg == pytest.approx(largest, abs=0.02)
    assert len(found.first) == 5
    for time_s, angle_deg in found.first:
        place = int(np.argmin(np.abs(bad.time - time_s)))
        assert bad.time[place] == time_s
        assert np.degrees(bad.driving_angle[place]) == pytest.approx(angle_deg)
    marked = [hit[int(np.argmin(np.abs(bad.time - time_s)))] for time_s, _ in found.first]
    assert sum(marked) >= 4
    (sentence,) = [note for note in result.notes if note.startswith("bisquare loss")]
    assert f"{found.share:.2%} of the samples" in sentence and "count less than half" in sentence
    assert (sentence in result.warnings) == found.are_many == (found.share >= 0.1)
    assert "below" in sentence or "both sides" in sentence


def test_a_clean_log_keeps_its_squares(quick_log, quick_rig, quick_fit):
    assert quick_fit.checks.outliers == ()
    assert not any("loss" in note for note in quick_fit.notes)
    assert quick_fit.parameters == fit(quick_log, quick_rig.pair, loss="square").parameters


@pytest.mark.parametrize("loss", ["huber", "bisquare"])
def test_a_robust_loss_on_a_clean_log_costs_five_percent(quick_log, quick_rig, quick_fit, loss):
    """Asked for, it is used: the same parameters, the same standard errors but for 5 %."""
    result = fit(quick_log, quick_rig.pair, loss=loss)
    (found,) = result.checks.outliers
    assert found.loss == loss and found.share < 0.03
    for name in ("driving_eccentricity_mm", "driven_phase_deg", "constant_backlash_deg"):
        one, other = result.parameters[name], quick_fit.parameters[name]
        assert one.std == pytest.approx(other.std, rel=0.15)
        assert abs((one.value or 0.0) - (other.value or 0.0)) < (other.std or 0.0)
