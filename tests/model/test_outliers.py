"""Outliers: a mixture where readings stand alone, and none where the noise is only large."""

import numpy as np
import pytest

from vttig_jax.model import is_heavy, weights_of


def _noise(kind: str, seed: int, count: int = 2000) -> np.ndarray:
    rng = np.random.default_rng(seed)
    white = rng.normal(size=count)
    if kind == "white":
        return white
    if kind == "slow":  # a large deviation of many rows
        return white + 30 * (np.abs(np.arange(count) - 900) < 100)
    if kind == "remembered":
        slow = np.zeros(count)
        for k in range(1, count):
            slow[k] = 0.98 * slow[k - 1] + rng.normal()
        return slow
    if kind == "uniform":
        return rng.uniform(-1, 1, count)
    alone = rng.choice(count, count // 50, replace=False)
    size = {"few": 15.0, "one_sided": 20.0}[kind]
    white[alone] += size * (1 if kind == "one_sided" else rng.choice([-1, 1], len(alone)))
    return white


@pytest.mark.parametrize("seed", range(5))
def test_readings_that_stand_alone_are_outliers_and_noise_has_none(seed):
    for kind in ("white", "slow", "remembered", "uniform", "few", "one_sided"):
        for unit in (1.0, 1e-6):
            heavy = is_heavy(unit * _noise(kind, seed))
            assert heavy == (kind in ("few", "one_sided")), (kind, unit)


@pytest.mark.parametrize("wrong", [1, 6])
def test_one_reading_of_thousands_may_be_an_outlier(wrong):
    noise = np.random.default_rng(wrong).normal(size=6000)
    noise[500 :: 6000 // wrong] += 100.0
    assert is_heavy(noise)


@pytest.mark.parametrize("kind", ["few", "one_sided"])
def test_weights_find_them_and_the_fit_is_that_of_the_others(kind):
    noise = _noise(kind, 1)
    clean = np.abs(noise) < 5
    x = np.c_[np.ones(len(noise)), np.linspace(-1, 1, len(noise))]
    y = x @ [3.0, 2.0] + noise
    weight, share = weights_of(x, y)
    assert weight[~clean].max() < 0.01
    assert np.mean(weight[clean]) > 0.99
    assert share == pytest.approx(np.mean(~clean), abs=0.01)
    robust = np.linalg.lstsq(x * weight[:, None], y * weight, rcond=None)[0]
    expected = np.linalg.lstsq(x[clean], y[clean], rcond=None)[0]
    np.testing.assert_allclose(robust, expected, atol=0.02)
    if kind == "one_sided":
        assert np.abs(np.linalg.lstsq(x, y, rcond=None)[0] - expected).max() > 0.2
