"""Replicates: calm about a log of the model, alarmed by one that is not."""

from dataclasses import replace

import numpy as np
import pytest

from tests.posterior.made import made_posterior, quick_fit
from vttig_jax.base.numerics.partial_autocorrelation import filter_of
from vttig_jax.base.units import ARCSEC, DEG
from vttig_jax.posterior.summary import predictive as module
from vttig_jax.posterior.summary.predictive import (
    Statistic,
    autocorrelation,
    autoregressive,
    predictive,
)


@pytest.fixture(scope="module")
def posterior():
    return made_posterior(quick_fit(), chosen=500)


@pytest.fixture(scope="module")
def found(posterior):
    return predictive(posterior, 200)


def _with_curves(posterior, change):
    """The posterior beside another log: `change` adds to the measured TE, and to the residual."""
    fit = posterior.fit
    moved = [change(k, curve) for k, curve in enumerate(fit.curves)]
    curves = tuple(
        replace(c, transmission_error=c.transmission_error + m)
        for c, m in zip(fit.curves, moved, strict=True)
    )
    residuals = tuple(r + m for r, m in zip(fit.residuals, moved, strict=True))
    return replace(posterior, fit=replace(fit, curves=curves, residuals=residuals))


def test_a_log_of_the_model_is_as_predicted(found):
    assert 0.93 < found.inside < 0.975
    assert found.share.p_value > 0.05 and found.rms.p_value > 0.05
    assert found.rms.low < found.rms.measured < found.rms.high
    assert found.outside_lags <= 8
    (jump,) = found.jumps
    assert jump.step.low < jump.step.measured < jump.step.high and jump.step.p_value > 0.05
    assert jump.step.predicted / DEG == pytest.approx(0.04, abs=0.005)
    assert "as the model predicts" in str(found) and "hardly" not in str(found)


def test_the_interval_is_around_the_fitted_curve(found, posterior):
    fit = posterior.fit
    runs = zip(fit.curves, fit.residuals, found.centre, found.high, found.low, strict=True)
    for curve, residual, centre, high, low in runs:
        fitted = curve.transmission_error - residual
        np.testing.assert_allclose(centre, fitted, atol=1.0 * ARCSEC)
        np.testing.assert_allclose(high - centre, centre - low)
        assert (high - centre > 1.96 * 0.95 * fit.noise.std).all()


def test_other_noise_than_the_model_has_is_seen(posterior):
    generator = np.random.default_rng(0)
    louder = _with_curves(posterior, lambda _, c: 1e-5 * 3 * generator.standard_normal(len(c)))
    seen = predictive(louder, 100)
    assert seen.inside < 0.93 and seen.rms.p_value < 0.02 and seen.share.p_value < 0.02
    assert "the model would hardly give this" in str(seen)


def test_a_line_no_order_explains_is_seen_in_the_memory(posterior):
    wave = lambda _, c: 8 * ARCSEC * np.sin(11.3 * c.driving_angle)  # noqa: E731
    assert predictive(_with_curves(posterior, wave), 100).outside_lags > 15


def test_a_jump_the_model_does_not_make_is_seen(posterior, found):
    step = lambda k, c: np.full(len(c), 0.01 * DEG * k)  # noqa: E731
    (jump,) = predictive(_with_curves(posterior, step), 100).jumps
    assert jump.step.p_value < 0.02
    assert jump.step.measured - found.jumps[0].step.measured == pytest.approx(0.01 * DEG)
    assert jump.step.predicted == pytest.approx(found.jumps[0].step.predicted, abs=5e-4 * DEG)


def test_errors_beyond_the_noise_model_are_in_the_replicates(posterior):
    """Draws as wide as such errors need replicates that have them, too."""
    wide = {
        name: part.mean(axis=0) + 20 * (part - part.mean(axis=0))
        for name in ("offset", "cosine", "sine")
        for part in [getattr(posterior, name)]
    }
    assert posterior.widening == 1.0 and posterior.fit.evidence is not None
    evidence = posterior.fit.evidence
    evidence = replace(evidence, widening=np.full_like(evidence.widening, 20.0))
    told = replace(posterior, **wide, fit=replace(posterior.fit, evidence=evidence))
    seen, known = predictive(replace(posterior, **wide), 200), predictive(told, 200)
    assert seen.rms.p_value < 0.01 and seen.outside_lags > 10
    assert known.rms.p_value > 0.1 and known.share.p_value > 0.1 and known.outside_lags < 5
    assert all(jump.step.p_value > 0.05 for jump in known.jumps)


def test_one_flank_has_no_jump(posterior):
    fit = posterior.fit
    alone = replace(fit, flanks=("A",), curves=fit.curves[:1], residuals=fit.residuals[:1])
    nothing = np.array([1.0, np.nan])
    one = replace(
        posterior,
        fit=alone,
        offset=posterior.offset * nothing,
        cosine=posterior.cosine * nothing[:, None],
        sine=posterior.sine * nothing[:, None],
    )
    seen = predictive(one, 60)
    assert seen.jumps == () and 0.92 < seen.inside < 0.98 and np.isfinite(seen.rms.measured)


def test_the_same_seed_gives_the_same_numbers(posterior):
    one, again, other = (predictive(posterior, 40, seed) for seed in (1, 1, 2))
    assert one.to_json() == again.to_json() != other.to_json()


def test_json_is_in_border_units(found):
    record = found.to_json()
    assert record["residual_rms_arcsec"]["measured"] == pytest.approx(found.rms.measured / ARCSEC)
    assert record["jumps"][0]["driving_deg"] == pytest.approx(1696, abs=5)
    assert record["jumps"][0]["step_deg"]["predicted"] == pytest.approx(0.04, abs=0.005)


def test_too_few_replicates_are_refused(posterior):
    with pytest.raises(ValueError, match="`replicates` must be at least 40, but is 3"):
        predictive(posterior, 3)


@pytest.mark.parametrize("partial", [[], [0.6], [0.9, -0.3], [0.995]])
def test_autoregressive_noise_is_stationary_with_its_filter(partial):
    partial = np.array(partial)
    filter_ = np.asarray(filter_of(partial))
    generator = np.random.default_rng(0)
    runs = [autoregressive(generator, filter_, 2.0, 50) for _ in range(3000)]
    expected = 2.0 / np.sqrt(np.prod(1 - partial**2))
    for part in (slice(0, 5), slice(-5, None)):  # no warm-up is left at the start
        assert np.std([run[part] for run in runs]) == pytest.approx(expected, rel=0.05)
    white = np.concatenate([np.convolve(run, filter_, "valid") for run in runs])
    assert white.std() == pytest.approx(2.0, rel=0.02)
    assert np.abs(autocorrelation([white], 5)).max() < 0.02


def test_autocorrelation_stays_inside_runs():
    one, other = np.array([1.0, 2.0, 3.0]), np.array([5.0, 7.0])
    expected = [(2 + 6 + 35) / 88, 3 / 88]
    assert autocorrelation([one, other], 2) == pytest.approx(expected)
    assert autocorrelation([np.concatenate([one, other])], 2)[0] != pytest.approx(expected[0])


def test_a_statistic_counts_both_sides():
    made = np.arange(1000.0)
    assert Statistic.of(made, 499.5).p_value == pytest.approx(1.0, abs=2e-3)
    assert Statistic.of(made, 974.5).p_value == pytest.approx(0.05, abs=2e-3)
    assert Statistic.of(made, 24.5).p_value == pytest.approx(0.05, abs=2e-3)
    assert 0 < Statistic.of(made, -1.0).p_value < 2e-3


@pytest.mark.parametrize(
    ("measured", "extreme"),
    [(1000.0, 0), (-1.0, 0), (974.5, 25), (24.5, 25), (999.0, 1), (0.0, 1), (990.0, 10)],
)
def test_the_p_value_counts_half_a_replicate_more_on_the_rarer_side(measured, extreme):
    """Twice (n + 1/2) of 1001, where n of the 1000 replicates are at least as extreme."""
    found = Statistic.of(np.arange(1000.0), measured).p_value
    assert found == pytest.approx((2 * extreme + 1) / 1001, rel=1e-12)


def test_the_band_of_every_lag_leaves_out_a_fortieth_of_the_replicates_on_each_side(
    posterior, monkeypatch
):
    drawn = []

    def kept(runs, lags):
        drawn.append(autocorrelation(runs, lags))
        return drawn[-1]

    monkeypatch.setattr(module, "autocorrelation", kept)
    found = predictive(posterior, 80)
    log, replicates = np.array(drawn[::2]), np.array(drawn[1::2])
    np.testing.assert_allclose(found.correlation, log.mean(axis=0))
    assert (np.sum(replicates < found.correlation_low, axis=0) == 2).all()
    assert (np.sum(replicates > found.correlation_high, axis=0) == 2).all()
