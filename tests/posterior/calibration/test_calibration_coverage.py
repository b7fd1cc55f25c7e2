"""Coverage, rank histograms and their tests, on ranks whose truth is known."""

import numpy as np
import pytest
from scipy import stats
from vttig_jax.posterior.calibration.coverage import (
    Cell,
    Coverage,
    CoverageDisc,
    amplitude_ranks,
    coverage,
    coverage_p_value,
    histogram,
    histogram_p_value,
    normal_ranks,
    rejected,
    uniformity,
)

pytestmark = pytest.mark.smoke


def z_values(count: int = 4000, width: float = 1.0) -> np.ndarray:
    return width * np.random.default_rng(3).standard_normal((count, 1))


def ranks_of(z: np.ndarray) -> np.ndarray:
    return normal_ranks(z, np.zeros_like(z), np.ones_like(z))[:, 0]


@pytest.mark.parametrize("level", [0.5, 0.68, 0.9, 0.95])
def test_coverage_counts_intervals_that_hold_the_truth(level):
    z = z_values()
    held = np.abs(z) <= stats.norm.ppf(0.5 + level / 2)
    found = coverage(ranks_of(z), level)
    assert found.hits == held.sum()
    assert found.low < level < found.high


def test_bounds_are_those_of_clopper_and_pearson():
    found = coverage(np.array([0.5] * 17 + [1.0] * 3), 0.9)
    expected = stats.binomtest(17, 20).proportion_ci(method="exact")
    assert (found.low, found.high) == pytest.approx((expected.low, expected.high))
    assert coverage(np.full(9, 0.5), 0.5).high == 1.0
    assert coverage(np.ones(9), 0.5).low == 0.0


def test_a_fit_that_failed_is_a_miss():
    assert coverage(np.array([0.5, np.nan]), 0.95).share == 0.5


def test_rank_histograms_are_flat_only_for_the_right_width():
    assert uniformity(ranks_of(z_values())) > 0.01
    for width in (0.85, 1.2):
        assert uniformity(ranks_of(z_values(width=width))) < 1e-6
    assert uniformity(ranks_of(z_values() + 0.2)) < 1e-6
    assert sum(histogram(ranks_of(z_values()))) == 4000


def test_tolerated_unevenness_is_that_of_the_band():
    edge = 1.7805 / 1.95996  # 95 % intervals that hold in 92.5 %
    assert coverage(ranks_of(z_values(40_000, 1 / edge)), 0.95).share == pytest.approx(
        0.925, abs=0.004
    )
    for width in (1.0, 0.96, 1 / edge):
        assert histogram_p_value(ranks_of(z_values(40_000, width))) > 0.05
    for width in (0.8, 1.2):
        assert histogram_p_value(ranks_of(z_values(40_000, width))) < 1e-6
    assert histogram_p_value(ranks_of(z_values(40_000) + 0.4)) < 1e-6


def test_amplitude_ranks_are_uniform_for_vectors_drawn_from_the_disc():
    generator = np.random.default_rng(0)
    count, radius, std = 1500, 1.0, 0.2
    turn = generator.uniform(0, 2 * np.pi, count)
    size = radius * np.sqrt(generator.uniform(size=count))
    truth = np.stack([size * np.cos(turn), size * np.sin(turn)], axis=1)
    values = truth + std * generator.standard_normal(truth.shape)
    discs = [CoverageDisc("offset", 0, 1, radius)]

    def ranks(claimed: float) -> np.ndarray:
        spread = np.tile(claimed**2 * np.eye(2), (count, 1, 1))
        return amplitude_ranks(truth, values, spread, discs)["offset"]

    assert uniformity(ranks(std)) > 0.01
    assert uniformity(ranks(0.7 * std)) < 1e-6
    # Draws outside the disc belong to no rig.
    anywhere = [CoverageDisc("offset", 0, 1, np.inf)]
    spread = np.tile(std**2 * np.eye(2), (count, 1, 1))
    assert uniformity(amplitude_ranks(truth, values, spread, anywhere)["offset"]) < 1e-6


def test_amplitudes_of_a_fit_that_failed_have_no_rank():
    spread = np.full((1, 2, 2), np.nan)
    found = amplitude_ranks(
        np.zeros((1, 2)), np.zeros((1, 2)), spread, [CoverageDisc("e", 0, 1, 1.0)]
    )
    assert np.isnan(found["e"][0])


def of(share: float, rigs: int = 2000) -> Coverage:
    return Coverage(0.95, round(share * rigs), rigs, 0.0, 1.0)


def test_only_a_coverage_clearly_beyond_the_band_fails():
    band = (0.925, 0.975)
    assert coverage_p_value(of(0.95), band) > 0.99
    assert coverage_p_value(of(0.925), band) == pytest.approx(0.5, abs=0.05)
    assert coverage_p_value(of(0.90), band) == pytest.approx(stats.binom.cdf(1800, 2000, 0.925))
    assert coverage_p_value(of(0.99), band) == pytest.approx(stats.binom.sf(1979, 2000, 0.975))


def test_holm_steps_down():
    cells = [Cell("c", str(p), "", p) for p in (0.2, 0.0049, 0.0001, 0.003)]
    # 0.0001 ≤ 0.01/4, 0.003 ≤ 0.01/3, 0.0049 ≤ 0.01/2, 0.2 > 0.01.
    assert [cell.probability for cell in rejected(cells)] == [0.0001, 0.003, 0.0049]
    assert rejected([Cell("c", "", "", 0.004) for _ in range(3)]) == []
    assert rejected([]) == []


def test_a_probability_that_is_no_number_does_not_pass_for_a_failure_of_others():
    assert [c.name for c in rejected([Cell("c", "bad", "", 0.0), Cell("c", "x", "", 1.0)])] == [
        "bad"
    ]


@pytest.mark.parametrize(("true", "low", "high"), [(0.0, 0.0, 0.02), (2.0, 0.98, 1.0)])
def test_a_truth_beyond_all_draws_has_the_outermost_rank(true, low, high):
    """Of 49 draws around 1, none is below 0 or above 2: the rank is in the first or last 1/50."""
    rigs = 200
    truth, values = np.tile([true, 0.0], (rigs, 1)), np.tile([1.0, 0.0], (rigs, 1))
    spread = np.tile(1e-4 * np.eye(2), (rigs, 1, 1))
    discs = [CoverageDisc("e", 0, 1, np.inf)]
    ranks = amplitude_ranks(truth, values, spread, discs, draws=49)["e"]
    assert low <= ranks.min() < low + 0.002
    assert high - 0.002 < ranks.max() <= high
