"""Ornstein–Uhlenbeck noise at unequal times, against dense covariances."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import lfilter

from tests.identify.summaries import TERMS, irregular_flank, lagged_flank, normal_matrix
from vttig_jax.identify.compress.harmonic_summary import HarmonicSummary
from vttig_jax.identify.compress.irregular_flank import IrregularFlank, whitened_run
from vttig_jax.identify.fitting import fit
from vttig_jax.identify.model.column_layout import OFFSET, ColumnLayout
from vttig_jax.identify.noise.reml import restricted_partial
from vttig_jax.identify.settings import NoiseSettings
from vttig_jax.logs.encoder_log import EncoderLog
from vttig_jax.rig.imperfections import Noise
from vttig_jax.rig.motion import PassMotion
from vttig_jax.rig.paper import paper_rig

DISTANCE_S = 0.01


def _runs(seed: int, *counts: int) -> tuple[list[np.ndarray], list[np.ndarray]]:
    generator = np.random.default_rng(seed)
    rows = [generator.standard_normal((count, 5)) for count in counts]
    times = [np.cumsum(generator.exponential(DISTANCE_S, count)) for count in counts]
    return rows, times


def _dense(time: np.ndarray, rho: float) -> np.ndarray:
    apart = np.abs(np.subtract.outer(time, time)) / DISTANCE_S
    return rho**apart / (1 - rho**2)


@settings(max_examples=20, deadline=None)
@given(st.floats(0.02, 0.998), st.integers(0, 1000))
def test_the_nodes_give_every_correlation_time(rho, seed):
    rows, times = _runs(seed, 60, 45)
    flank = irregular_flank(rows, times, DISTANCE_S)
    expected, determinant = np.zeros((5, 5)), 0.0
    for one, time in zip(rows, times, strict=True):
        dense = _dense(time, rho)
        expected += one.T @ np.linalg.solve(dense, one)
        determinant += np.linalg.slogdet(dense)[1]
    found = normal_matrix(flank, np.array([1.0, -rho]))
    assert np.abs(found - expected).max() <= 1e-9 * np.abs(expected).max()
    assert flank.log_determinant(np.array([rho])) == pytest.approx(determinant, abs=1e-7)


def test_equal_times_make_it_an_autoregression():
    rows, _ = _runs(0, 50, 70)
    times = [DISTANCE_S * np.arange(len(one)) for one in rows]
    irregular = irregular_flank(rows, times, DISTANCE_S)
    regular = lagged_flank(rows, 1)
    filter_ = np.array([1.0, -0.7])
    np.testing.assert_allclose(
        normal_matrix(irregular, filter_), normal_matrix(regular, filter_), atol=1e-9
    )
    assert irregular.log_determinant(np.array([0.7])) == pytest.approx(
        regular.log_determinant(np.array([0.7]))
    )
    # Unequal times are another thing.
    times = [time**1.2 for time in times]
    other = irregular_flank(rows, times, DISTANCE_S)
    assert np.abs(normal_matrix(other, filter_) - normal_matrix(regular, filter_)).max() > 0.1


def test_sums_selections_and_transformations():
    rows, times = _runs(1, 40, 50)
    both = irregular_flank(rows, times, DISTANCE_S)
    parts = [
        irregular_flank([one], [time], DISTANCE_S) for one, time in zip(rows, times, strict=True)
    ]
    filter_ = np.array([1.0, -0.8])
    np.testing.assert_allclose(
        normal_matrix(parts[0] + parts[1], filter_), normal_matrix(both, filter_)
    )
    keep = np.array([0, 3, 4])
    selected = both.selected(keep)
    np.testing.assert_allclose(
        normal_matrix(selected, filter_), normal_matrix(both, filter_)[np.ix_(keep, keep)]
    )
    matrix = np.random.default_rng(0).standard_normal((7, 5))
    turned = both.transformed(matrix)
    assert isinstance(turned, IrregularFlank)
    np.testing.assert_allclose(
        normal_matrix(turned, filter_), matrix @ normal_matrix(both, filter_) @ matrix.T, atol=1e-9
    )


def test_whitened_rows_are_white():
    time = np.cumsum(np.random.default_rng(2).exponential(DISTANCE_S, 4000))
    path = _ornstein_uhlenbeck(time, 0.03, 3)
    rho = float(np.exp(-DISTANCE_S / 0.03))
    white = whitened_run(path[:, None], time, rho, DISTANCE_S)[0][:, 0]
    assert abs(white[1:] @ white[:-1]) / (white @ white) < 0.05
    assert abs(path[1:] @ path[:-1]) / (path @ path) > 0.5


def _ornstein_uhlenbeck(time: np.ndarray, correlation_s: float, seed: int) -> np.ndarray:
    shocks = np.random.default_rng(seed).standard_normal(len(time))
    path = shocks.copy()
    for place, ratio in enumerate(np.exp(-np.diff(time) / correlation_s), 1):
        path[place] = ratio * path[place - 1] + np.sqrt(1 - ratio**2) * shocks[place]
    return path


def test_the_correlation_time_is_found():
    found = []
    for seed in range(12):
        rows, times = [], []
        for part in range(2):
            time = np.cumsum(np.random.default_rng([seed, part]).exponential(DISTANCE_S, 1500))
            path = _ornstein_uhlenbeck(time, 0.05, 1000 * seed + part)
            rows.append(np.column_stack([np.ones(1500), time - time.mean(), path]))
            times.append(time)
        summary = HarmonicSummary(
            (irregular_flank(rows, times, DISTANCE_S),),
            TERMS,
            ColumnLayout((), (), ((OFFSET, "drift_1"),)),
            DISTANCE_S,
            noise=NoiseSettings("ou"),
        )
        found.append(-DISTANCE_S / np.log(restricted_partial(summary)[0]))
    spread = np.std(found) / np.sqrt(len(found))
    assert np.mean(found) == pytest.approx(0.05, abs=4 * spread)
    assert spread < 0.003


@pytest.fixture(scope="module")
def thinned():
    """A log of which every other sample is lost at random, with slow noise far above a count."""
    rig = paper_rig(motion=PassMotion(reversal_deg=2520.0))
    rig = type(rig)(**{**vars(rig), "noise": Noise(0.01, 0.05)})
    log = rig.log()
    keep = np.sort(np.random.default_rng(0).permutation(len(log))[: len(log) // 2])
    assert log.driven is not None
    return rig, EncoderLog.from_arrays(
        log.time[keep], log.driving.reading[keep], log.driven.reading[keep], pair=rig.pair
    )


def test_a_log_at_random_times_is_fitted(thinned):
    rig, log = thinned
    result = fit(log, rig.pair, noise="ou")
    assert result.noise.name == "Ornstein–Uhlenbeck"
    assert "Ornstein–Uhlenbeck" in str(result)
    assert result.noise.correlation_s == pytest.approx(0.05, rel=0.4)
    truth = {"driving": 0.0226, "driven": 0.0273}
    for shaft, true in truth.items():
        name = f"{shaft}_eccentricity_mm"
        std = result.parameters[name].std
        assert std and abs(result.value(name) - true) < 4 * std
    white = fit(log, rig.pair, noise="white")
    tests = (result.checks.whiteness, white.checks.whiteness)
    assert tests[0] is not None and tests[1] is not None
    assert tests[0].probability > tests[1].probability


def test_the_filter_of_equal_times_is_lfilter():
    """`whitened_run` at equal times, row by row."""
    rows, _ = _runs(4, 30)
    time = DISTANCE_S * np.arange(30)
    white, _ = whitened_run(rows[0], time, 0.6, DISTANCE_S)
    expected = np.asarray(lfilter([1.0, -0.6], [1.0], rows[0], axis=0))
    np.testing.assert_allclose(white[1:], expected[1:], atol=1e-12)
