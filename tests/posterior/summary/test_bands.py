"""Bands: calibrated on the draws, valid for the truth, and the map they make."""

import re

import numpy as np
import pytest

from tests.posterior.made import quick_posterior
from vttig_jax.base.errors import NoAnswerError
from vttig_jax.base.units import DEG
from vttig_jax.identify.backlash import backlash_map
from vttig_jax.posterior.summary.bands import band, band_map, streamed_band

POINTS = np.linspace(0, 2 * np.pi, 120)
BASIS = np.stack([np.ones_like(POINTS), np.cos(POINTS), np.sin(POINTS), np.cos(3 * POINTS)], 1)
FACTOR = np.array([[1, 0, 0, 0], [0.5, 0.8, 0, 0], [0, 0.2, 0.6, 0], [0.1, 0, 0.3, 0.9]])


def _curves(generator: np.random.Generator, count: int, centre: np.ndarray) -> np.ndarray:
    """Gaussian curves with a known covariance, correlated along the angle."""
    return (centre + generator.standard_normal((count, 4)) @ FACTOR.T) @ BASIS.T


def _holds(low: np.ndarray, high: np.ndarray, curves: np.ndarray) -> np.ndarray:
    return np.asarray(((curves >= low) & (curves <= high)).all(axis=-1))


@pytest.mark.parametrize("probability", [0.5, 0.9, 0.95])
def test_the_simultaneous_band_holds_exactly_its_share_of_the_draws(probability):
    draws = _curves(np.random.default_rng(0), 2000, np.zeros(4))
    found = band(draws, probability)
    share = _holds(found.low_simultaneous, found.high_simultaneous, draws).mean()
    assert share == pytest.approx(probability, abs=1 / 2000)
    assert share >= probability
    at_each = ((draws >= found.low) & (draws <= found.high)).mean(axis=0)
    assert at_each == pytest.approx(probability, abs=2e-3)
    # The pointwise band holds whole curves far less often.
    assert _holds(found.low, found.high, draws).mean() < probability - 0.1


def test_coverage_of_the_truth_over_repeated_posteriors():
    generator = np.random.default_rng(1)
    truth, whole, pointwise = np.zeros(4) @ BASIS.T, 0, 0
    repeats = 400
    for _ in range(repeats):
        # A posterior with the right covariance around an estimate that errs by the same.
        estimate = generator.standard_normal(4) @ FACTOR.T
        found = band(_curves(generator, 500, estimate))
        whole += _holds(found.low_simultaneous, found.high_simultaneous, truth)
        pointwise += _holds(found.low, found.high, truth)
    assert 0.91 <= whole / repeats <= 0.98
    assert pointwise / repeats < 0.88  # the check can fail


def test_pieces_give_the_same_band():
    draws = _curves(np.random.default_rng(2), 300, np.zeros(4))
    whole = band(draws)
    pieces = streamed_band(iter(np.split(draws.T, [7, 50])))
    for one, other in zip(vars(whole).values(), vars(pieces).values(), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-12)


def test_the_simultaneous_band_of_skewed_draws_contains_the_pointwise_one():
    """Draws with one common error that is bounded below, as an unknown delay gives it."""
    common = np.maximum(np.random.default_rng(3).uniform(-1.0, 3.0, (2000, 1)), 0.0)
    found = band(common + 1e-3 * np.random.default_rng(4).standard_normal((2000, 20)))
    assert np.all(found.centre + found.critical * found.std < found.high)
    assert np.all(found.high_simultaneous >= found.high)
    assert np.all(found.low_simultaneous <= found.low)


def test_a_wider_probability_is_wider():
    draws = _curves(np.random.default_rng(3), 500, np.zeros(4))
    narrow, wide = band(draws, 0.5), band(draws, 0.99)
    assert wide.critical > narrow.critical
    assert (wide.high > narrow.high).all() and (wide.low < narrow.low).all()


def test_a_point_without_spread_is_a_point():
    draws = _curves(np.random.default_rng(4), 100, np.zeros(4))
    draws[:, 5] = 0.25
    found = band(draws)
    assert found.low_simultaneous[5] == found.high_simultaneous[5] == 0.25
    assert np.isfinite(found.critical)


@pytest.mark.parametrize("probability", [0.0, 1.0, -1.0])
def test_a_probability_outside_is_refused(probability):
    with pytest.raises(ValueError, match="`probability` must be between 0 and 1"):
        band(np.zeros((3, 2)), probability)


def test_too_few_draws_or_points_are_refused():
    with pytest.raises(ValueError, match="at least two draws, but has 1"):
        band(np.zeros((1, 2)))
    with pytest.raises(ValueError, match="at least one point"):
        streamed_band([])


@pytest.fixture(scope="module")
def posterior():
    return quick_posterior()


@pytest.fixture(scope="module")
def banded(posterior):
    return band_map(posterior, step_deg=5.0)


def test_the_columns_are_those_of_the_contract(banded):
    assert tuple(banded.columns)[:9] == (
        "driving_deg",
        "backlash_deg",
        "backlash_mm",
        "axial_mm",
        "backlash_first_order_deg",
        "low95_deg",
        "high95_deg",
        "low95_simultaneous_deg",
        "high95_simultaneous_deg",
    )
    assert list(banded.columns)[9] == "axial_low95_mm"
    table = np.stack(list(banded.columns.values()), axis=1)
    assert table.shape == (16 * 72, len(banded.columns))
    assert np.isfinite(table).all()


def test_the_map_lies_in_its_bands_and_near_the_fit(banded, posterior):
    row = banded.columns
    gap = row["backlash_deg"]
    edges = [row[f"{end}95{kind}_deg"] for end in ("low", "high") for kind in ("_simultaneous", "")]
    for lower, upper in (
        (edges[0], edges[1]),
        (edges[1], gap),
        (gap, edges[3]),
        (edges[3], edges[2]),
    ):
        assert (lower < upper).all()
    fitted = backlash_map(posterior.fit)
    np.testing.assert_allclose(gap, fitted.over(banded.driving_angle) / DEG, atol=5e-4)
    first = fitted.first_order_over(banded.driving_angle) / DEG
    np.testing.assert_allclose(row["backlash_first_order_deg"], first, atol=5e-4)


def test_axial_millimetres_are_the_backlash_over_the_taper(banded, posterior):
    row = banded.columns
    per_deg = DEG * 80 / (2 * np.tan(3 * DEG))
    np.testing.assert_allclose(row["axial_mm"], row["backlash_deg"] * per_deg)
    np.testing.assert_allclose(
        row["axial_high95_simultaneous_mm"], row["high95_simultaneous_deg"] * per_deg
    )
    np.testing.assert_allclose(row["backlash_mm"], row["backlash_deg"] * DEG * 80)


def test_another_probability_names_its_columns(posterior):
    found = band_map(posterior, step_deg=30.0, turns=2.0, probability=0.9)
    assert list(found.columns)[5] == "low90_deg" and len(found.driving_angle) == 24
    assert "90 % of the whole map" in str(found)


@pytest.mark.parametrize(("name", "value"), [("step_deg", 0.0), ("turns", -1.0), ("turns", np.inf)])
def test_a_step_or_span_that_is_not_positive_is_refused(posterior, name, value):
    with pytest.raises(ValueError, match=f"`{name}` must be positive"):
        band_map(posterior, **{name: value})


def test_one_flank_has_no_map(posterior):
    from dataclasses import replace

    with pytest.raises(NoAnswerError, match="only flank A was measured"):
        band_map(replace(posterior, fit=replace(posterior.fit, flanks=("A",))))


def test_the_printed_widths_are_those_of_the_bands(banded):
    """Of draws that are normal: 1.96 standard deviations at one angle."""
    half = dict(re.findall(r"95 % (at one angle|of the whole map)\s+± ([0-9.e-]+)°", str(banded)))
    row = banded.columns
    widths = {
        "at one angle": row["high95_deg"] - row["low95_deg"],
        "of the whole map": row["high95_simultaneous_deg"] - row["low95_simultaneous_deg"],
    }
    for name, width in widths.items():
        assert float(half[name]) == pytest.approx(np.median(width) / 2, rel=0.05)
    one_std = np.median(banded.band.std) / DEG
    assert float(half["at one angle"]) == pytest.approx(1.96 * one_std, rel=0.1)
