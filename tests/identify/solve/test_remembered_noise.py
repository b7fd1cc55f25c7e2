"""Noise that remembers from run to run: its likelihood, and the variances of weighted rows."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from vttig_jax.identify.noise.freedom import FEWEST, satterthwaite
from vttig_jax.identify.solve import remembered_noise
from vttig_jax.identify.solve.remembered_noise import RememberedNoise, Run

TAU, WHITE = 0.5, 0.2
"""Correlation time in s, and share of the white noise."""


def covariance(time: np.ndarray) -> np.ndarray:
    matrix = (1 - WHITE) * np.exp(-np.abs(np.subtract.outer(time, time)) / TAU)
    return matrix + WHITE * np.eye(len(time))


def runs_of(seed: int, *, pause_s: float = 0.3, share: float = 1.0) -> list[Run]:
    """Two runs of 80 rows of 0.05 s, each with a level of its own."""
    time = np.arange(160) * 0.05
    time[80:] += pause_s
    noise = np.linalg.cholesky(covariance(time)) @ np.random.default_rng(seed).normal(size=160)
    level = np.repeat(np.eye(2), 80, axis=0)
    full = np.full(160, share)
    whole = (time, full, share * level, share * (noise + 3.0))
    return [Run(*(part[k : k + 80] for part in whole)) for k in (0, 80)]


def difference(runs: list[Run]) -> list[np.ndarray]:
    """Weights of the difference of the mean values of two runs."""
    return [np.full((80, 1), sign / 80 / runs[0].share[0]) for sign in (-1.0, 1.0)]


def test_the_variance_is_that_of_the_covariance():
    """The geometric mean over logs; its spread is that of the degrees of freedom."""
    found = []
    for seed in range(25):
        runs = runs_of(seed)
        variance, freedom = RememberedNoise.of(runs).variances(difference(runs))
        found.append((float(variance[0]), float(freedom[0])))
    time = np.concatenate([run.time for run in runs_of(0)])
    weights = np.concatenate(difference(runs_of(0)))[:, 0]
    truth = float(weights @ covariance(time) @ weights)
    variance, freedom = np.array(found).T
    assert np.median(variance) / truth == pytest.approx(1.0, rel=0.3)
    assert 3 <= np.median(freedom) <= 40
    inside = chi2.cdf(freedom * variance / truth, freedom)
    assert np.mean((inside > 0.005) & (inside < 0.995)) > 0.85


def test_runs_that_follow_each_other_share_their_noise():
    """The noise of two near runs is partly the same, and cancels in their difference."""
    runs = runs_of(1)
    away = [runs[0], Run(runs[1].time + 1e6, runs[1].share, runs[1].design, runs[1].value)]
    near, far = at_the_truth(runs), at_the_truth(away)
    sums = [np.abs(part) for part in difference(runs)]
    assert covariance_ratio(near, sums) > 1.02 * covariance_ratio(far, sums)
    assert covariance_ratio(near, difference(runs)) < 0.98 * covariance_ratio(far, difference(runs))


def at_the_truth(runs: list[Run]) -> RememberedNoise:
    """The noise with the shape that the rows were drawn with."""
    shape = np.array([np.log(TAU), np.log(WHITE / (1 - WHITE))])
    return replace(RememberedNoise.of(runs), shape=shape)


def covariance_ratio(noise: RememberedNoise, weights: list[np.ndarray]) -> float:
    """Variance over that of a single row."""
    whole = np.concatenate(weights)[:, 0]
    return float(whole @ noise.likelihood.covariance(noise.shape) @ whole)


def test_averaged_rows_have_the_same_variance(monkeypatch):
    runs = runs_of(2)
    fine = RememberedNoise.of(runs)
    monkeypatch.setattr(remembered_noise, "_MOST_ROWS", 55)
    coarse = RememberedNoise.of(runs)
    assert coarse.size == 3
    assert len(coarse.likelihood.value) == 54
    found = [one.variances(difference(runs))[0][0] for one in (fine, coarse)]
    assert found[1] == pytest.approx(found[0], rel=0.4)


def test_a_row_counts_by_its_share():
    """Rows of equal weight are the same rows in another unit; a row without weight is none."""
    plain, scaled = runs_of(3), runs_of(3, share=0.7)
    expected = RememberedNoise.of(plain).variances(difference(plain))[0][0]
    found = RememberedNoise.of(scaled).variances(difference(scaled))[0][0]
    assert found == pytest.approx(expected, rel=1e-6)
    gone = np.arange(80) % 7 == 0
    zeroed = [
        Run(
            run.time,
            np.where(gone, 0.0, run.share),
            np.where(gone[:, None], 0.0, run.design),
            np.where(gone, 0.0, run.value),
        )
        for run in plain
    ]
    weights = [np.where(gone, 0.0, sign / 68)[:, None] for sign in (-1.0, 1.0)]
    assert len(RememberedNoise.of(zeroed).likelihood.value) == 2 * 68
    assert RememberedNoise.of(zeroed).variances(weights)[0][0] == pytest.approx(expected, rel=0.4)


def test_white_noise_alone_has_nearly_all_degrees_of_freedom():
    generator = np.random.default_rng(0)
    run = Run(np.arange(200.0), np.ones(200), np.ones((200, 1)), generator.normal(size=200))
    alternating = np.resize([1.0, -1.0], 200)[:, None] / 200
    variance, freedom = RememberedNoise.of([run]).variances([alternating])
    assert variance[0] == pytest.approx(1 / 200, rel=0.3)
    assert freedom[0] > 50


def test_a_known_variance_has_its_degrees_of_freedom():
    """v = e^s with H = N: ν = 2 / (2/N) = N; what H leaves open has the fewest."""
    one = np.ones(1)
    assert satterthwaite(one, np.ones((1, 1)), np.array([[30.0]]))[0] == pytest.approx(30.0)
    assert satterthwaite(one, np.ones((1, 1)), np.array([[1e-9]]))[0] == FEWEST
