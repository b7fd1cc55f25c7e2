"""Draws of the gap: against the flank model itself, its smallest value, and what binds."""

from dataclasses import replace
from fractions import Fraction

import msgspec
import numpy as np
import pytest

from tests.posterior.made import quick_posterior
from vttig_jax.base import DEG, REV, NoAnswerError
from vttig_jax.kinematics import BacklashMap
from vttig_jax.model import Parameter
from vttig_jax.pair import Drive, Gear, GearPair
from vttig_jax.posterior.summary.draws import SmallestGap, batches
from vttig_jax.posterior.summary.gap_draws import GapDraws
from vttig_jax.posterior.summary.posterior import flank_draws, gap_draws

ANGLES = np.linspace(0, 16 * REV, 301)


def drawn(pair, rng: np.random.Generator) -> GapDraws:
    """Return draws around an estimate of a gap that is 1e-3 rad at every angle.

    The estimate and the draws have the same error of 1e-5 rad in each of 24 coefficients.
    """
    terms = tuple((order, 0) for order in range(1, 7))
    parts = 1e-5 * (rng.standard_normal((2, 6, 2)) + rng.standard_normal((200, 2, 6, 2)))
    offset = np.broadcast_to([0.0, 1e-3], (200, 2))
    return GapDraws(pair, terms, offset, parts[..., 0], parts[..., 1], np.arange(200))


@pytest.fixture(scope="module")
def posterior():
    """Draws with a part of their spread, so that no gap is closed."""
    whole = quick_posterior()
    parts = {name: getattr(whole, name) for name in ("offset", "cosine", "sine")}
    narrow = {
        name: part.mean(axis=0) + 0.05 * (part - part.mean(axis=0)) for name, part in parts.items()
    }
    return replace(whole, **narrow)


@pytest.fixture(scope="module")
def draws(posterior):
    return flank_draws(posterior)


@pytest.mark.parametrize("draw", [0, 123, 399])
def test_a_draw_is_its_own_flank_model_with_its_own_smallest_gap(draws, posterior, draw):
    model = posterior.model(draw)
    np.testing.assert_allclose(draws.over(ANGLES)[:, draw], model.backlash(ANGLES), atol=3e-9)
    for flank in ("A", "B"):
        exact = model.transmission_error(ANGLES, flank)
        np.testing.assert_allclose(draws.errors(ANGLES, flank)[:, draw], exact, atol=3e-9)

    found = draws.smallest
    expected = BacklashMap(model, None, draws.pair).smallest
    assert found.gap[draw] == pytest.approx(expected.backlash, abs=1e-12)
    assert found.driving_angle[draw] == pytest.approx(expected.driving_angle, abs=1e-5)


@pytest.mark.parametrize("spread", [0.0, 1e-3])
def test_no_angle_lies_below_the_smallest_gap_and_a_grid_alone_stays_above(posterior, spread):
    """Also where a wide spread of the level leaves no place out."""
    common = np.random.default_rng(0).standard_normal((len(posterior.offset), 1))
    draws = flank_draws(replace(posterior, offset=posterior.offset + common * [0.0, spread]))
    angle = np.arange(0, 16 * 360, 0.5) * DEG
    lowest = np.min([piece.min(axis=0) for piece in draws.chunks(angle)], axis=0)
    assert (draws.smallest.gap <= lowest + 3e-9).all()
    coarse = draws.over(np.arange(0, 16 * 360, 4.0) * DEG).min(axis=0)
    assert np.median(coarse - draws.smallest.gap) > 1e-6


def test_safe_closing_and_the_chance_to_bind(posterior, draws):
    smallest = gap_draws(posterior).smallest
    closing = smallest.safe_closing_mm
    np.testing.assert_allclose(closing, smallest.gap * 80 / (2 * np.tan(3 * DEG)))
    share = posterior.probability_of_binding(float(np.median(closing)))
    assert share.value == pytest.approx(0.5, abs=0.01)
    assert 0.5 / np.sqrt(len(closing)) <= share.std_error + 1e-4 < 0.08
    for far, value in ((closing.min() - 1e-6, 0.0), (closing.max() + 1e-6, 1.0)):
        sure = posterior.probability_of_binding(float(far))
        assert sure.value == value and 0 < sure.std_error < 0.01
    found = draws.smallest
    closed = replace(found, gap=found.gap - 1.01 * found.interval[0])
    safe, none = (dict(one.rows())["safe axial closing"] for one in (found, closed))
    assert "mm binds somewhere with probability 2.5 %" in safe
    assert none == "none, because the smallest gap may already be zero"


def test_batches_are_stretches_of_ensembles_whose_disagreement_is_an_error(draws):
    count = len(draws.smallest.gap)
    low = np.arange(count) < count // 2
    both = replace(draws.smallest, gap=np.where(low, 0.001, 0.002))
    mixed, closing = np.random.default_rng(0).integers(0, 8, count), both.safe_closing_mm.mean()
    errors = [
        replace(both, batch=batch).probability_of_binding(float(closing)).std_error
        for batch in (mixed, low.astype(int))
    ]
    assert errors[0] < 0.06 and errors[1] > 0.4
    found = batches((2, 8, 3))
    np.testing.assert_array_equal(found, np.repeat(np.arange(16), 3))
    assert len(set(batches((2, 6, 3)))) == 12
    np.testing.assert_array_equal(batches((2, 16, 1)), np.repeat(np.arange(16), 2))


def test_the_place_of_most_draws(paper_pair):
    """Both sides of the zero of the period are one place."""
    for first, second, place in ((1.0, 50.0, (1.0, 0.6)), (1e-3, 16 * REV - 1e-3, (1e-3, 1.0))):
        angle = np.array([first] * 6 + [second] * 4)
        found = SmallestGap(paper_pair, np.full(10, 1e-4), angle, np.zeros(10, int), 1e-4)
        assert found.place == place


def test_the_interval_of_the_smallest_gap_holds_where_orders_are_uncertain():
    """Quantiles of the draws alone never reach the truth: every draw has dips of its own."""
    pair = Drive(Fraction(1, 2))
    by_interval, by_quantiles = 0, 0
    for seed in range(40):
        found = drawn(pair, np.random.default_rng(seed)).smallest
        by_interval += found.interval[0] <= 1e-3 <= found.interval[2]
        by_quantiles += bool(np.quantile(found.gap, 0.975) >= 1e-3)
    assert by_interval >= 34 and by_quantiles <= 10


def test_one_flank_no_gap_and_no_taper_have_no_answer(posterior, draws):
    fit = posterior.fit
    with pytest.raises(NoAnswerError, match="only flank B was measured"):
        gap_draws(replace(posterior, fit=replace(fit, flanks=("B",))))
    unknown = Parameter("constant_backlash_deg", "deg", reason="turned too little")
    checks = msgspec.structs.replace(fit.checks, gap_over_angles_covered=unknown)
    parameters = fit.parameters | {"constant_backlash_deg": unknown}
    open_fit = replace(fit, parameters=parameters, checks=checks)
    with pytest.raises(NoAnswerError, match=r"undetermined \(turned too little\)"):
        gap_draws(replace(posterior, fit=open_fit))
    spur = GearPair(Gear(45), Gear(80), module_mm=2.0, pressure_angles_deg=20.0)
    for pair, words in ((spur, "gears without taper"), (Drive(spur.ratio), "a drive without")):
        found = replace(draws.smallest, pair=pair)
        with pytest.raises(NoAnswerError, match=words):
            found.probability_of_binding(0.1)
        assert found.to_json()["safe_closing_mm"] is None
        assert [name for name, _ in found.rows()] == ["smallest gap"]
