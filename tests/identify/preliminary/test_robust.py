"""Weights, scale and variance factor against integrals under the Gaussian, and words."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad
from scipy.stats import norm

from vttig_jax.identify.preliminary.robust import (
    BISQUARE,
    HUBER,
    Outliers,
    has_outliers,
    scale_of,
    variance_factor,
    weights_of,
)
from vttig_jax.identify.report.checks import Checks
from vttig_jax.identify.settings import Loss

ROBUST: tuple[Loss, ...] = ("huber", "bisquare")
LOSSES: tuple[Loss, ...] = ("square", *ROBUST)


def _weight(u: float, loss: Loss) -> float:
    """By the definitions, one residual at a time."""
    if loss == "huber":
        return 1.0 if abs(u) <= 1.345 else 1.345 / abs(u)
    if loss == "bisquare":
        return (1 - (u / 4.685) ** 2) ** 2 if abs(u) < 4.685 else 0.0
    return 1.0


def _mean(function) -> float:
    """Expectation under the standard normal."""
    edges = [-HUBER, HUBER, -BISQUARE, BISQUARE]
    return quad(lambda u: function(u) * norm.pdf(u), -12, 12, points=edges, limit=200)[0]


@pytest.mark.parametrize("loss", LOSSES)
def test_weights_follow_their_definition(loss):
    residual = np.linspace(-20, 20, 401)
    found = weights_of(residual, 2.0, loss)
    np.testing.assert_allclose(found, [_weight(r / 2.0, loss) for r in residual], atol=1e-15)


@given(scale=st.floats(1e-9, 1e9), u=st.floats(0, 1e3))
def test_weights_fall_with_distance_and_know_no_unit(scale, u):
    for loss in LOSSES:
        near, far, other = weights_of(np.array([u, 1.1 * u, -u]) * scale, scale, loss)
        assert 0 <= far <= near <= 1
        assert near == other
        assert near == pytest.approx(_weight(u, loss), abs=1e-9)


def test_scale_is_the_standard_deviation_of_gaussian_noise():
    noise = 3.0 + 0.2 * np.random.default_rng(0).standard_normal(200_000)
    middle, scale = scale_of(noise)
    assert middle == pytest.approx(3.0, abs=2e-3)
    assert scale == pytest.approx(0.2, rel=5e-3)
    # A tenth of outliers on one side hardly moves it; a standard deviation is far off.
    noise[::10] += 50.0
    assert scale_of(noise)[1] == pytest.approx(0.2, rel=0.25)
    assert noise.std() > 10 * 0.2


def test_scale_is_never_zero():
    middle, scale = scale_of(np.full(10, 0.25))
    assert middle == 0.25 and 0 < scale < 1e-9


@pytest.mark.parametrize("loss", ROBUST)
def test_constants_keep_95_percent_of_the_efficiency(loss):
    """(E ψ′)²/E ψ² under the Gaussian, by integration."""
    psi_square = _mean(lambda u: (_weight(u, loss) * u) ** 2)
    # E ψ′ = E u ψ under the Gaussian.
    slope = _mean(lambda u: _weight(u, loss) * u * u)
    assert slope**2 / psi_square == pytest.approx(0.95, abs=2e-3)


@pytest.mark.parametrize("loss", ROBUST)
def test_variance_factor_is_the_ratio_of_integrals(loss):
    psi_square = _mean(lambda u: (_weight(u, loss) * u) ** 2)
    slope = _mean(lambda u: _weight(u, loss) * u * u)
    share = _mean(lambda u: _weight(u, loss))
    # Evenly spaced quantiles are a Gaussian sample without chance.
    sample = norm.ppf((np.arange(400_000) + 0.5) / 400_000)
    if loss == "huber":  # the samples are moved to their ψ, and every row counts
        single = means = psi_square / slope**2 / psi_square
    else:
        single = psi_square / slope**2 / (slope / share**2)
        means = psi_square / slope**2 / (psi_square / share**3)
    for size, expected in ((1, single), (8, means)):
        assert variance_factor(sample, 1.0, loss, size) == pytest.approx(expected, rel=2e-3)
        assert variance_factor(7.0 * sample, 7.0, loss, size) == pytest.approx(expected, rel=2e-3)
    assert variance_factor(sample, 1.0, "square", 1) == 1.0


@pytest.mark.parametrize("size", [1, 8])
@pytest.mark.parametrize(
    ("loss", "spoiled"),
    [("huber", False), ("huber", True), ("bisquare", False), ("bisquare", True)],
)
def test_variance_factor_mends_weighted_least_squares(loss, spoiled, size):
    """Monte Carlo of a mean: what the rows of a fit call its variance, times the factor."""
    generator = np.random.default_rng(1)
    found, claimed = [], []
    for _ in range(800):
        sample = generator.standard_normal(400)
        if spoiled:
            bad = generator.random(400) < 0.1
            sample[bad] += generator.choice([-30.0, 30.0], bad.sum())
        level, scale = scale_of(sample)
        weight = np.ones(400)
        for _ in range(40):
            weight = weights_of(sample - level, scale, loss)
            level = float(weight @ sample / weight.sum())
        rest = sample - level
        kept = np.ones(400) if loss == "huber" else weight
        share = kept.reshape(-1, size).mean(axis=1)
        rows = (weight * rest).reshape(-1, size).mean(axis=1) / np.sqrt(np.maximum(share, 1e-9))
        variance = rows @ rows / share.sum()
        found.append(level)
        factor = variance_factor(rest, scale, loss, size)
        claimed.append(variance * factor / share.sum())
    assert np.std(found) == pytest.approx(np.sqrt(np.mean(claimed)), rel=0.09)


@pytest.mark.parametrize(
    ("share", "distance", "expected"), [(0.0, 0, False), (0.01, 30, True), (5e-4, 30, False)]
)
def test_outliers_are_suspected_by_their_share(share, distance, expected):
    generator = np.random.default_rng(2)
    noise = generator.standard_normal(20_000)
    noise[generator.permutation(20_000)[: int(share * 20_000)]] += distance
    assert has_outliers([noise]) is expected


def test_broad_tails_are_no_outliers():
    generator = np.random.default_rng(3)
    assert not has_outliers([generator.laplace(size=20_000)])
    assert has_outliers([generator.standard_cauchy(20_000)])


def test_a_wrong_model_is_no_outlier():
    """Far residuals side by side, as a missed delay leaves them, are none; the same alone are."""
    generator = np.random.default_rng(5)
    noise = generator.standard_normal(4000)
    wave = np.where(np.arange(4000) % 1000 < 100, 20.0, 0.0)
    assert not has_outliers([noise + wave])
    assert has_outliers([noise + generator.permutation(wave)])
    assert not has_outliers([]) and not has_outliers([np.zeros(0)])


def _outliers(**changes) -> Outliers:
    fields = {
        "loss": "bisquare",
        "passes": 7,
        "share": 0.1,
        "positive": 1.0,
        "scale_deg": 0.002,
        "largest_deg": 3.9,
        "first": ((0.5, 180.0), (0.6, 216.0)),
    }
    return Outliers(**(fields | changes))


@pytest.mark.parametrize(
    ("positive", "side"), [(1.0, "above"), (0.0, "below"), (0.5, "on both sides of")]
)
def test_outliers_in_words(positive, side):
    text = _outliers(positive=positive).sentence
    assert text.startswith(
        "bisquare loss: 10.00% of the samples do not follow the model and count less than half"
    )
    assert f"they stand {side} the fit by up to 3.9°" in text
    assert "the first at 0.5 s (driving 180.0°)" in text


def test_no_outliers_in_words_and_the_record():
    none = _outliers(share=0.0, positive=0.0, first=())
    assert none.sentence == "bisquare loss: no sample stands off the fit"
    (record,) = Checks(outliers=(_outliers(),)).to_json()["outliers"]
    assert record["first"] == [[0.5, 180.0], [0.6, 216.0]]
    assert record["share"] == 0.1 and record["loss"] == "bisquare"
