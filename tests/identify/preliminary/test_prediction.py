"""Residuals of single samples against NumPy, and their rms."""

from dataclasses import replace

import numpy as np
import pytest

from tests.identify.summaries import looked
from vttig_jax.identify.compress.regressors import Drift
from vttig_jax.identify.preliminary.linear_fit import LinearFit, linear_fit, residual_of
from vttig_jax.identify.solve.residuals import (
    curves_and_residuals,
    sample_residual_rms,
    weights_of_logs,
)
from vttig_jax.pair.gear_pair import Flank

BOTH: tuple[Flank, ...] = ("A", "B")


@pytest.fixture(scope="module")
def linear(quick_log, quick_rig) -> LinearFit:
    return looked(quick_log, quick_rig.pair, drift=Drift(2), regressors=("delay",))[1]


def _weights(linear: LinearFit, seed: int = 0) -> np.ndarray:
    """An arbitrary model, (−β, 1)."""
    values = np.random.default_rng(seed).standard_normal(linear.rows[0].columns.width)
    values[-1] = 1.0
    return values


def _direct(linear: LinearFit, number: int, weights: np.ndarray) -> np.ndarray:
    channels, columns = linear.channels[0], linear.rows[0].columns
    segment = linear.rows[0].runs[number].segment
    part = slice(segment.start, segment.stop)

    def harmonics(terms):
        for first, second in terms:
            phase = first * channels.driving[part] + second * channels.driven[part]
            yield np.cos(phase)
            yield np.sin(phase)

    error = channels.error[segment.flank][part]
    own = [channels.own[name][part] for name in columns.own[0][1:]]
    every = [*harmonics(columns.free), np.ones_like(error), *own, *harmonics(columns.tied), error]
    return np.stack(every, axis=1) @ weights


@pytest.mark.parametrize("number", [0, 1])
@pytest.mark.parametrize("stride", [1, 7])
def test_residuals_of_samples_are_the_rows_times_the_weights(linear, number, stride):
    weights, columns = _weights(linear), linear.rows[0].columns
    segment = linear.rows[0].runs[number].segment
    found = residual_of(linear.channels[0], segment, columns, weights, stride)
    expected = _direct(linear, number, weights)[::stride]
    np.testing.assert_allclose(found, expected, atol=1e-8)
    # Every column takes part.
    for cell in range(columns.width - 1):
        other = weights.copy()
        other[cell] += 1e-3
        moved = residual_of(linear.channels[0], segment, columns, other, stride)
        assert np.abs(moved - found).max() > 1e-5, cell


def test_residuals_of_a_layout_without_harmonics(linear):
    columns = replace(linear.rows[0].columns, free=(), tied=())
    segment = linear.rows[0].runs[0].segment
    weights = np.array([-0.3, -0.1, -0.2, -0.05, 1.0])
    found = residual_of(linear.channels[0], segment, columns, weights)
    part = slice(segment.start, segment.stop)
    channels = linear.channels[0]
    own = [channels.own[name][part] for name in columns.own[0][1:]]
    expected = channels.error["A"][part] + weights[:-1] @ [np.ones_like(own[0]), *own]
    np.testing.assert_allclose(found, expected, atol=1e-12)


def test_means_of_residuals_are_residuals_of_means(linear):
    """Rows and samples speak of the same model."""
    (rows,) = linear.rows
    for run, residual in zip(rows.runs, linear.residuals(0), strict=True):
        means = residual[: len(run.rows) * rows.size].reshape(-1, rows.size).mean(axis=1)
        expected = run.rows @ linear.residual_rows[0][run.segment.flank]
        np.testing.assert_allclose(means, expected, atol=1e-10)


def test_rms_of_samples(linear):
    weights = dict.fromkeys(BOTH, _weights(linear))
    every = np.concatenate([_direct(linear, number, weights["A"]) for number in (0, 1)])
    found = sample_residual_rms(linear, [weights])
    assert found == pytest.approx(float(np.sqrt(np.mean(every**2))), rel=1e-6)


def test_rms_counts_samples_by_their_weight(linear, quick_log):
    share = np.random.default_rng(1).uniform(0, 1, len(quick_log))
    share[1000:1200] = 0.0
    weighed = linear_fit(linear.inputs, linear.model, 0.0, [share], linear.block_s)
    weights = dict.fromkeys(BOTH, _weights(linear))
    every = np.concatenate([_direct(weighed, number, weights["A"]) for number in (0, 1)])
    each = np.concatenate(
        [share[run.segment.start : run.segment.stop] for run in linear.rows[0].runs]
    )
    expected = float(np.sqrt(each @ every**2 / each.sum()))
    assert sample_residual_rms(weighed, [weights]) == pytest.approx(expected, rel=1e-9)
    assert sample_residual_rms(linear, [weights]) != pytest.approx(expected, rel=1e-4)


def test_means_without_weight_are_left_out_of_the_curves(quick_log, quick_rig):
    """Without a delay, whose column follows the speed of the samples that count."""
    linear = looked(quick_log, quick_rig.pair, drift=Drift(2))[1]
    share = np.ones(len(quick_log))
    (rows,) = linear.rows
    first = rows.runs[0].segment
    share[first.start + rows.size : first.start + 4 * rows.size] = 0.0
    share[first.start + 10 * rows.size : first.start + 11 * rows.size] = 0.25
    weighed = linear_fit(linear.inputs, linear.model, 0.0, [share], linear.block_s)
    own = linear.residual_rows[0]
    plain, left = curves_and_residuals(linear, [own])
    curves, residuals = curves_and_residuals(weighed, [own])
    keep = np.delete(np.arange(len(plain[0])), [1, 2, 3])
    np.testing.assert_allclose(residuals[0], left[0][keep], atol=1e-12)
    for name in ("driving_angle", "transmission_error", "time"):
        before, after = getattr(plain[0], name), getattr(curves[0], name)
        np.testing.assert_allclose(after, before[keep], atol=1e-12)
    np.testing.assert_allclose(residuals[1], left[1], atol=1e-12)


def test_a_column_that_was_not_chosen_gets_no_coefficient(linear):
    wide = linear.rows[0].columns
    narrow = linear.summary.keeping([("offset", "delay")])
    values = np.arange(1.0, narrow.columns.width)
    (weights,) = weights_of_logs(narrow, [values, 2 * values])
    for size, flank in enumerate(BOTH, 1):
        row = weights[flank]
        assert row[wide.index("drift_1")] == row[wide.index("drift_2")] == 0.0
        assert row[-1] == 1.0
        for name in ("offset", "delay"):
            assert row[wide.index(name)] == -size * values[narrow.columns.index(name)]
        for position in range(len(wide.free + wide.tied)):
            place = wide.cosine(position)
            assert row[place] == -size * values[narrow.columns.cosine(position)]
