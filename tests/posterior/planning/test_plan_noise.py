"""Planned noise against brute force: its averages, and counting that is frozen."""

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.linalg import toeplitz

from vttig_jax.base import DEG, REV
from vttig_jax.pair import Drive, Encoder
from vttig_jax.pair.schema import GearTable
from vttig_jax.posterior import PlannedNoise
from vttig_jax.posterior.planning.noise import counting_std, frozen_counts
from vttig_jax.rig import paper_pair

pytestmark = pytest.mark.smoke


def block_averages(noise: PlannedNoise, size: int, rate_hz: float, blocks: int) -> np.ndarray:
    """Covariance of means of `size` samples from the full covariance of all samples."""
    lag_s = np.arange(size * blocks) / rate_hz
    samples = (noise.std_deg * DEG) ** 2 * np.exp(-lag_s / max(noise.correlation_s, 1e-300))
    samples[0] += (noise.white_std_deg * DEG) ** 2
    mean = np.kron(np.eye(blocks), np.full((1, size), 1 / size))
    return mean @ toeplitz(samples) @ mean.T


CORRELATIONS_S = [0.0, 1e-4, 2e-3, 0.05, 10.0, 1e6]


@given(st.integers(1, 12), st.sampled_from(CORRELATIONS_S), st.floats(0.0, 0.01))
def test_averages_of_the_noise_are_those_of_its_samples(size, correlation_s, white_std_deg):
    noise = PlannedNoise(0.003, correlation_s, white_std_deg)
    expected = block_averages(noise, size, 1000.0, 5)
    found = noise.autocovariance(size, 1000.0, 4)
    np.testing.assert_allclose(found, expected[0], rtol=1e-9, atol=1e-9 * expected[0, 0])
    counting = PlannedNoise(0.003, correlation_s).autocovariance(
        size, 1000.0, 4, white_std_deg * DEG
    )
    np.testing.assert_allclose(counting, found, rtol=1e-14)


def test_counting_error_is_that_of_both_encoders_and_impossible_noise_is_refused():
    generator = np.random.default_rng(1)
    step = REV / 90_000
    errors = step * (generator.uniform(size=200_000) - 9 / 16 * generator.uniform(size=200_000))
    assert counting_std(paper_pair()) == pytest.approx(errors.std(), rel=0.01)
    assert counting_std(Drive(Fraction(1, 2))) == 0.0
    for name in ("std_deg", "correlation_s", "white_std_deg"):
        for value in (-1.0, np.nan, np.inf):
            with pytest.raises(ValueError, match=name):
                PlannedNoise(**{name: value})


def test_frozen_counts_are_told_with_a_better_rate():
    (sentence,) = frozen_counts(paper_pair(), [60.0], 2000.0)
    assert "45 counts of the driving encoder" in sentence
    assert "1987 Hz" in sentence
    assert frozen_counts(paper_pair(), [60.0], 1987.0) == []
    assert frozen_counts(paper_pair(), [59.3], 2000.0) == []
    assert frozen_counts(paper_pair(), [60.0, 40.0], 2000.0)[1:] == [
        sentence.replace("60 rpm", "40 rpm").replace(" 45 counts", " 30 counts")
    ]
    drive = Drive(ratio=Fraction(1), driving=GearTable(encoder=Encoder(counts_per_rev=3600)))
    for rate_hz, frozen in ((1200.0, True), (900.0, True), (1193.0, False), (877.0, False)):
        assert bool(frozen_counts(drive, [60.0], rate_hz)) == frozen
