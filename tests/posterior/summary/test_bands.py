"""Bands: calibrated on the draws, valid for the truth, and the map they make."""

import re
from dataclasses import replace

import numpy as np
import pytest

from tests.posterior.made import quick_posterior
from vttig_jax.base import DEG, NoAnswerError
from vttig_jax.identify import backlash_map
from vttig_jax.posterior import band, band_map
from vttig_jax.posterior.summary.bands import streamed_band

POINTS = np.linspace(0, 2 * np.pi, 120)
BASIS = np.stack([np.ones_like(POINTS), np.cos(POINTS), np.sin(POINTS), np.cos(3 * POINTS)], 1)
FACTOR = np.array([[1, 0, 0, 0], [0.5, 0.8, 0, 0], [0, 0.2, 0.6, 0], [0.1, 0, 0.3, 0.9]])


def _curves(seed: int, count: int) -> np.ndarray:
    """Gaussian curves with a known covariance, correlated along the angle."""
    return np.random.default_rng(seed).standard_normal((count, 4)) @ FACTOR.T @ BASIS.T


@pytest.mark.parametrize("probability", [0.5, 0.9, 0.95])
def test_the_simultaneous_band_holds_exactly_its_share_of_the_draws(probability):
    draws = _curves(0, 2000)
    found = band(draws, probability)
    whole = (draws >= found.low_simultaneous) & (draws <= found.high_simultaneous)
    share = whole.all(axis=1).mean()
    assert probability <= share == pytest.approx(probability, abs=1 / 2000)
    at_each = (draws >= found.low) & (draws <= found.high)
    assert at_each.mean(axis=0) == pytest.approx(probability, abs=2e-3)
    # The pointwise band holds whole curves far less often.
    assert at_each.all(axis=1).mean() < probability - 0.1


def test_pieces_points_and_skewed_draws_have_their_bands():
    draws = _curves(2, 300)
    whole = band(draws)
    pieces = streamed_band(iter(np.split(draws.T, [7, 50])))
    for one, other in zip(vars(whole).values(), vars(pieces).values(), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-12)
    draws = _curves(4, 100)
    draws[:, 5] = 0.25
    found = band(draws)
    assert found.low_simultaneous[5] == found.high_simultaneous[5] == 0.25
    assert np.isfinite(found.critical)
    common = np.maximum(np.random.default_rng(3).uniform(-1.0, 3.0, (2000, 1)), 0.0)
    found = band(common + 1e-3 * np.random.default_rng(4).standard_normal((2000, 20)))
    assert np.all(found.centre + found.critical * found.std < found.high)
    assert np.all(found.high_simultaneous >= found.high)
    assert np.all(found.low_simultaneous <= found.low)


def test_wrong_arguments_are_named(posterior):
    for probability in (0.0, 1.0, -1.0):
        with pytest.raises(ValueError, match="`probability` must be between 0 and 1"):
            band(np.zeros((3, 2)), probability)
    with pytest.raises(ValueError, match="at least two draws, but has 1"):
        band(np.zeros((1, 2)))
    with pytest.raises(ValueError, match="at least one point"):
        streamed_band([])
    for name, value in (("step_deg", 0.0), ("turns", -1.0), ("turns", np.inf)):
        with pytest.raises(ValueError, match=f"`{name}` must be positive"):
            band_map(posterior, **{name: value})
    with pytest.raises(NoAnswerError, match="only flank A was measured"):
        band_map(replace(posterior, fit=replace(posterior.fit, flanks=("A",))))


@pytest.fixture(scope="module")
def posterior():
    return quick_posterior()


@pytest.fixture(scope="module")
def banded(posterior):
    return band_map(posterior, step_deg=5.0)


@pytest.fixture(scope="module")
def row(banded) -> dict[str, np.ndarray]:
    return banded.columns


def test_the_columns_are_those_of_the_contract_and_millimetres_those_of_the_taper(banded, row):
    assert " ".join([*row][:10]) == (
        "driving_deg backlash_deg backlash_mm axial_mm backlash_first_order_deg low95_deg"
        " high95_deg low95_simultaneous_deg high95_simultaneous_deg axial_low95_mm"
    )
    assert all(len(one) == 16 * 72 and np.isfinite(one).all() for one in row.values())
    per_deg = DEG * 80 / (2 * np.tan(3 * DEG))
    np.testing.assert_allclose(row["axial_mm"], row["backlash_deg"] * per_deg)
    high = row["high95_simultaneous_deg"] * per_deg
    np.testing.assert_allclose(row["axial_high95_simultaneous_mm"], high)
    np.testing.assert_allclose(row["backlash_mm"], row["backlash_deg"] * DEG * 80)


def test_the_map_lies_in_its_bands_and_near_the_fit(banded, row, posterior):
    gap = row["backlash_deg"]
    low, high = (row[f"{end}95_deg"] for end in ("low", "high"))
    lowest, highest = (row[f"{end}95_simultaneous_deg"] for end in ("low", "high"))
    assert (np.diff([lowest, low, gap, high, highest], axis=0) > 0).all()
    fitted = backlash_map(posterior.fit)
    np.testing.assert_allclose(gap, fitted.over(banded.driving_angle) / DEG, atol=5e-4)
    first = fitted.first_order_over(banded.driving_angle) / DEG
    np.testing.assert_allclose(row["backlash_first_order_deg"], first, atol=5e-4)


def test_the_printed_widths_are_those_of_the_bands(banded, row, posterior):
    """Of draws that are normal: 1.96 standard deviations at one angle."""
    half = dict(re.findall(r"95 % (at one angle|of the whole map)\s+± ([0-9.e-]+)°", str(banded)))
    for name, kind in (("at one angle", ""), ("of the whole map", "_simultaneous")):
        width = np.median(row[f"high95{kind}_deg"] - row[f"low95{kind}_deg"])
        assert float(half[name]) == pytest.approx(width / 2, rel=0.05)
    one_std = np.median(banded.band.std) / DEG
    assert float(half["at one angle"]) == pytest.approx(1.96 * one_std, rel=0.1)
    assert banded.map.coverage is not None
    assert banded.map.coverage.share == posterior.fit.coverage.share
    assert "of the 16 driving turns of the hunting period on both flanks" in str(banded)
    found = band_map(posterior, step_deg=30.0, turns=2.0, probability=0.9)
    assert [*found.columns][5] == "low90_deg" and len(found.driving_angle) == 24
    assert "90 % of the whole map" in str(found)
