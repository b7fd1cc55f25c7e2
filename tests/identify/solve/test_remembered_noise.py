"""Noise that remembers from run to run: its likelihood, and intervals of weighted rows."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import stdtrit
from scipy.stats import t as stats_t

from vttig_jax.base.numerics.quantiles import NORMAL_95
from vttig_jax.identify.noise.freedom import FEWEST, satterthwaite
from vttig_jax.identify.solve import remembered_noise
from vttig_jax.identify.solve.remembered_noise import RememberedNoise, Run, _half_width

TAU, WHITE = 0.5, 0.2
"""Correlation time in s, and share of the white noise."""


def covariance(time: np.ndarray, memory_s: float = TAU) -> np.ndarray:
    matrix = (1 - WHITE) * np.exp(-np.abs(np.subtract.outer(time, time)) / memory_s)
    return matrix + WHITE * np.eye(len(time))


def runs_of(seed: int, *, memory_s: float = TAU, share: float = 1.0) -> list[Run]:
    """Two runs of 80 rows of 0.05 s, each with a level of its own."""
    time = np.arange(160) * 0.05
    time[80:] += 0.3
    noise = np.linalg.cholesky(covariance(time, memory_s)) @ np.random.default_rng(seed).normal(
        size=160
    )
    level = np.repeat(np.eye(2), 80, axis=0)
    full = np.full(160, share)
    whole = (time, full, share * level, share * (noise + 3.0))
    return [Run(*(part[k : k + 80] for part in whole)) for k in (0, 80)]


def difference(runs: list[Run]) -> list[np.ndarray]:
    """Weights of the difference of the mean values of two runs."""
    return [np.full((80, 1), sign / 80 / runs[0].share[0]) for sign in (-1.0, 1.0)]


def half_width(runs: list[Run], weights: list[np.ndarray] | None = None) -> float:
    weights = difference(runs) if weights is None else weights
    return float(RememberedNoise.of(runs).half_widths(weights)[0])


def error(runs: list[Run]) -> float:
    """Return the difference of the mean values of two runs of one level."""
    return float(sum(w[:, 0] @ run.value for w, run in zip(difference(runs), runs, strict=True)))


def test_the_interval_holds():
    """It holds in 95 % of the logs without knowing the noise, and white noise alone does not."""
    logs = [runs_of(seed) for seed in range(40)]
    found = np.array([half_width(runs) for runs in logs])
    errors = np.abs([error(runs) for runs in logs])
    assert 0.9 <= np.mean(errors < found) <= 1.0
    time = np.concatenate([run.time for run in logs[0]])
    weights = np.concatenate(difference(logs[0]))[:, 0]
    known = NORMAL_95 * np.sqrt(weights @ covariance(time) @ weights)
    assert 0.8 < np.median(found) / known < 2.2
    assert np.mean(errors < NORMAL_95 * np.linalg.norm(weights)) < 0.6


def test_a_mixture_of_one_noise_is_students_interval():
    std, probability = np.array([2.0, 5.0]), np.array([1.0, 0.0])
    student = float(stdtrit(4.0, 0.975))
    assert _half_width(std, probability, 4.0) == pytest.approx(2 * student)
    mixed = _half_width(std, np.array([0.5, 0.5]), 4.0)
    assert stats_t.sf(mixed / std, 4.0).mean() == pytest.approx(0.025, rel=1e-4)
    assert _half_width(np.zeros(2), probability, 4.0) == 0.0


def test_runs_that_follow_each_other_share_their_noise():
    """The noise of two near runs is partly the same, and cancels in their difference."""
    runs = runs_of(1)
    away = [runs[0], Run(runs[1].time + 1e6, runs[1].share, runs[1].design, runs[1].value)]
    sums = [np.abs(part) for part in difference(runs)]
    assert spread(runs, sums) > 1.02 * spread(away, sums)
    assert spread(runs, difference(runs)) < 0.98 * spread(away, difference(runs))


def spread(runs: list[Run], weights: list[np.ndarray]) -> float:
    """Return the variance of a function where only the true noise is probable, over e^s."""
    noise = RememberedNoise.of(runs)
    only = replace(
        noise,
        memory_s=np.array([TAU]),
        white=np.array([WHITE]),
        scale=np.ones((1, 1)),
        probability=np.ones((1, 1)),
    )
    return float(only.half_widths(weights)[0]) ** 2


def test_longer_memory_is_seen_and_widens_the_interval():
    logs = [[runs_of(seed, memory_s=memory) for seed in range(12)] for memory in (0.1, 1.0)]
    noises = [[RememberedNoise.of(runs) for runs in own] for own in logs]
    short, long = (
        np.median([one.probability.sum(axis=1) @ np.log(one.memory_s) for one in own])
        for own in noises
    )
    assert long - short > 0.7
    short, long = (np.median([half_width(runs) for runs in own]) for own in logs)
    assert long > 1.5 * short


def test_averaged_rows_have_the_same_interval(monkeypatch):
    logs = [runs_of(seed) for seed in range(9)]
    fine = [half_width(runs) for runs in logs]
    monkeypatch.setattr(remembered_noise, "_MOST_ROWS", 55)
    noise = RememberedNoise.of(logs[0])
    assert noise.size == 3
    assert len(noise.rows.value) == 54
    ratio = np.array([half_width(runs) for runs in logs]) / fine
    assert np.median(ratio) == pytest.approx(1.0, abs=0.2)


def test_a_row_counts_by_its_share():
    """Rows of equal weight are the same rows in another unit; a row without weight is none."""
    gone = np.arange(80) % 7 == 0
    weights = [np.where(gone, 0.0, sign / 68)[:, None] for sign in (-1.0, 1.0)]
    ratio = []
    for seed in range(9):
        plain = runs_of(seed)
        expected = half_width(plain)
        assert half_width(runs_of(seed, share=0.7)) == pytest.approx(expected, rel=1e-6)
        zeroed = [without(run, gone) for run in plain]
        assert len(RememberedNoise.of(zeroed).rows.value) == 2 * 68
        ratio.append(half_width(zeroed, weights) / expected)
    assert np.median(ratio) == pytest.approx(1.0, abs=0.2)


def without(run: Run, gone: np.ndarray) -> Run:
    """Return the run with a share of 0 for some rows."""
    share, design, value = (
        np.where(gone if part.ndim == 1 else gone[:, None], 0.0, part)
        for part in (run.share, run.design, run.value)
    )
    return Run(run.time, share, design, value)


def test_white_noise_alone_has_the_interval_of_white_noise():
    generator = np.random.default_rng(0)
    run = Run(np.arange(200.0), np.ones(200), np.ones((200, 1)), generator.normal(size=200))
    alternating = np.resize([1.0, -1.0], 200)[:, None] / 200
    assert half_width([run], [alternating]) == pytest.approx(NORMAL_95 / np.sqrt(200), rel=0.15)


def test_a_known_variance_has_its_degrees_of_freedom():
    """v = e^s with H = N: ν = 2 / (2/N) = N; what H leaves open has the fewest."""
    one = np.ones(1)
    assert satterthwaite(one, np.ones((1, 1)), np.array([[30.0]]))[0] == pytest.approx(30.0)
    assert satterthwaite(one, np.ones((1, 1)), np.array([[1e-9]]))[0] == FEWEST
