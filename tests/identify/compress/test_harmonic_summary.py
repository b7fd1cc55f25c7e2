"""The summary against the rows it stands for."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from tests.identify.summaries import (
    TERMS,
    lag_products_of,
    lagged_flank,
    looked,
    made_log,
    normal_matrix,
    random_log,
)
from tests.oracles.stationary_noise import quadratic
from vttig_jax.base.numerics.partial_autocorrelation import filter_of
from vttig_jax.identify.compress import harmonic_summary
from vttig_jax.identify.compress.harmonic_summary import needed_lags, summarise
from vttig_jax.identify.compress.regressors import Drift
from vttig_jax.identify.settings import HIGHEST_LAG
from vttig_jax.logs.motion.segments import Segment


def _runs(seed: int, *lengths: int) -> list[np.ndarray]:
    generator = np.random.default_rng(seed)
    return [np.cumsum(generator.standard_normal((n, 5)), axis=0) for n in lengths]


@pytest.mark.parametrize("lengths", [(40,), (17, 60), (33, 21, 90)])
@pytest.mark.parametrize("order", [0, 1, 2, 5, 8])
def test_whitened_equals_the_inverse_covariance(lengths, order):
    """Both ends included: against the dense covariance of the same autoregression."""
    runs = _runs(order, *lengths)
    summary = lagged_flank(runs, 8)
    filter_ = filter_of(np.random.default_rng(order + 1).uniform(-0.8, 0.8, order))
    expected = quadratic(filter_, runs)
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    assert np.abs(normal_matrix(summary, filter_) - expected).max() <= 1e-10 * scale.max()
    np.testing.assert_allclose(normal_matrix(summary, filter_) / scale, expected / scale, atol=1e-9)


def test_rows_with_a_full_history_alone_are_something_else():
    """The conditional likelihood drops the first rows of every run."""
    runs, filter_ = _runs(3, 40, 50), filter_of(np.array([0.6, -0.3]))
    kept = np.concatenate([lfilter(filter_, [1.0], rows, axis=0)[2:] for rows in runs])
    exact = normal_matrix(lagged_flank(runs, 8), filter_)
    assert np.abs(exact - kept.T @ kept).max() > 1e-2


def test_forgetting_an_end_would_be_seen():
    runs = _runs(1, 40, 50)
    filter_ = np.array([1.0, -0.7, 0.1])
    summary = lagged_flank(runs, 8)
    ended = lagged_flank([rows[:-1] for rows in runs], 8)
    assert np.abs(normal_matrix(summary, filter_) - normal_matrix(ended, filter_)).max() > 1e-3
    started = lagged_flank([rows[1:] for rows in runs], 8)
    assert np.abs(normal_matrix(summary, filter_) - normal_matrix(started, filter_)).max() > 1e-3


@pytest.fixture(scope="module")
def linear(noisy_log, noisy_rig):
    return looked(noisy_log, noisy_rig.pair, drift=Drift(1))[1]


def test_a_summary_counts_the_rows_of_its_runs(linear):
    summary = linear.summary
    assert summary.rows == sum(len(run.rows) for run in linear.rows[0].runs)
    assert [f.flank for f in summary.flanks] == ["A", "B"]
    assert summary.columns == linear.rows[0].columns
    lags = {f.lag_products.shape[0] - 1 for f in summary.flanks}
    assert len(lags) == 1 and 1 <= lags.pop() <= HIGHEST_LAG


def test_lag_products_are_those_of_the_runs(linear):
    """y is the last column and 1 stands behind the free ones: both are known from the curves."""
    one = linear.summary.columns.index("offset")
    for flank in linear.summary.flanks:
        runs = [run for run in linear.rows[0].runs if run.segment.flank == flank.flank]
        products = lag_products_of(flank)
        for lag in range(len(products)):
            curves = [run.curve.transmission_error for run in runs]
            own = sum(float(y[lag:] @ y[: len(y) - lag]) for y in curves)
            assert products[lag, -1, -1] == pytest.approx(own, rel=1e-9)
            level = sum(float(y[lag:].sum()) for y in curves)
            assert products[lag, -1, one] == pytest.approx(level, rel=1e-9)


def test_a_run_too_short_to_filter_is_left_out(noisy_rig, noisy_log, linear):
    """Only whole runs are summarised; the fit then says which flanks remain."""
    lags = linear.summary.flanks[0].lag_products.shape[0] - 1
    size = linear.rows[0].size
    for rows, flanks in ((2 * lags, ["A"]), (2 * HIGHEST_LAG + 9, ["A", "B"])):
        short = [
            s if s.flank == "A" else Segment(s.start, s.start + rows * size, s.flank, s.speed)
            for s in linear.inputs[0].segments
        ]
        _, left = looked(noisy_log, noisy_rig.pair, drift=Drift(1), segments=short)
        assert [f.flank for f in left.summary.flanks] == flanks


def test_logs_add_up_each_with_columns_of_its_own():
    """Against the rows of both logs written into one wide table by hand."""
    first = random_log(0, ("offset", "drift_1"), "AB")
    second = random_log(1, ("offset",), "ABA")
    summary = summarise([first, second], TERMS)
    assert summary.columns.own == (("offset", "drift_1"), ("offset",))
    filter_ = np.array([1.0, -0.3])
    for flank in summary.flanks:
        wide = []
        for log, own in ((first, [2, 3]), (second, [4])):
            for run in log.runs:
                if run.segment.flank != flank.flank:
                    continue
                rows = np.zeros((len(run.rows), 10))
                rows[:, :2], rows[:, -5:] = run.rows[:, :2], run.rows[:, -5:]
                rows[:, own] = run.rows[:, 2 : 2 + len(own)]
                wide.append(rows)
        expected = quadratic(filter_, wide)
        np.testing.assert_allclose(normal_matrix(flank, filter_), expected, atol=1e-9)
        assert flank.rows == sum(map(len, wide))
        # One offset for both logs would be another table.
        found = normal_matrix(flank, filter_)
        assert abs(found[2, 4]) < 1e-12 < abs(found[2, 2])


def test_a_flank_of_the_second_log_alone_counts():
    summary = summarise([random_log(0, ("offset",), "A"), random_log(1, ("offset",), "B")], TERMS)
    assert [f.flank for f in summary.flanks] == ["A", "B"]
    empty, own = (summary.flanks[1].square(column) for column in (2, 3))
    assert empty < 1e-18 < 1.0 < own


@pytest.mark.parametrize(
    ("poles", "least", "most"), [([], 2, 3), ([0.8], 2, 5), ([0.6, -0.5, 0.3, 0.3], 5, 8)]
)
def test_lags_follow_the_order_of_the_noise(poles, least, most):
    """The order of the autoregression and two more."""
    rows = random_log(2, ("offset",), "A", 6000).runs[0].rows.copy()
    rows[:, -1] = lfilter([1.0], np.append(1.0, -np.asarray(poles)), rows[:, -1])
    assert least <= needed_lags(made_log([rows], ("offset",), "A")) <= most


def test_short_logs_have_few_lags():
    assert needed_lags(random_log(3, ("offset",), "A", 20)) <= 2
    assert needed_lags(made_log([], ("offset",), "")) == 1


def test_further_runs_are_added_to_the_summary_of_the_first_runs(monkeypatch):
    """The sum is the summary of all runs, and no row of the first runs is read again."""
    whole = random_log(5, ("offset",), "ABAB", count=2000)
    for run in whole.runs:
        run.rows[:, -1] = lfilter([1.0], [1.0, -0.9], run.rows[:, -1])
    first = replace(whole, runs=whole.runs[:2])
    plain, base = summarise([whole], TERMS), summarise([first], TERMS)
    monkeypatch.setattr(harmonic_summary, "_summarised", None)  # the call would fail
    added = summarise([whole], TERMS, base=(base, [first]))
    for one, other, part in zip(plain.flanks, added.flanks, base.flanks, strict=True):
        assert one.lag_products.shape == other.lag_products.shape
        assert one.rows == other.rows > part.rows
        filter_ = filter_of(np.array([-0.8]))
        expected = normal_matrix(one, filter_)
        tolerance = 1e-9 * np.abs(expected).max()
        np.testing.assert_allclose(normal_matrix(other, filter_), expected, atol=tolerance)
        assert np.abs(normal_matrix(part, filter_) - expected).max() > 1e3 * tolerance


def test_runs_that_need_more_lags_are_summarised_anew():
    """White first runs and strongly correlated further ones."""
    whole = random_log(6, ("offset",), "AA", count=2000)
    rows = whole.runs[1].rows
    rows[:, -1] = lfilter([1.0], [1.0, -0.5, 0.3, -0.6], 5 * rows[:, -1])
    first = replace(whole, runs=whole.runs[:1])
    base = summarise([first], TERMS)
    added = summarise([whole], TERMS, base=(base, [first]))
    assert len(added.flanks[0].lag_products) - 1 == needed_lags(whole)
    assert len(base.flanks[0].lag_products) - 1 < needed_lags(whole)
