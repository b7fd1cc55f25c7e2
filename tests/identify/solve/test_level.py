"""What is taken off a transmission error, and how it comes back."""

from dataclasses import replace

import numpy as np
import pytest

from tests.identify.summaries import lag_products_of, looked
from vttig_jax.base.units import DEG
from vttig_jax.identify.compress.harmonic_summary import summarise
from vttig_jax.identify.compress.regressors import level_of
from vttig_jax.identify.solve.least_squares import Solution
from vttig_jax.identify.solve.residuals import lifted, restored

LEVEL = 120 * DEG


def test_level_in_whole_degrees(quick_log):
    assert level_of(quick_log) == 0.0
    moved = replace(quick_log, driven=_mounted(quick_log, 30_001))
    assert level_of(moved) == pytest.approx(LEVEL, abs=1e-15)
    reading = moved.driven.reading.copy()
    reading[0] -= 30_001  # the first sample alone says nothing
    assert level_of(replace(moved, driven=replace(moved.driven, reading=reading))) == level_of(
        moved
    )


def _mounted(log, counts: int):
    return replace(log.driven, reading=log.driven.reading + counts)


def test_rows_have_no_level_and_curves_have_it(quick_log, quick_rig):
    moved = replace(quick_log, driven=_mounted(quick_log, 30_000))
    (_, plain), (_, linear) = (looked(log, quick_rig.pair) for log in (quick_log, moved))
    assert plain.levels == (0.0,) and linear.levels == (pytest.approx(LEVEL),)
    for run, other in zip(linear.rows[0].runs, plain.rows[0].runs, strict=True):
        np.testing.assert_allclose(run.rows[:, -1], other.rows[:, -1], atol=1e-12)
        np.testing.assert_allclose(
            run.curve.transmission_error - LEVEL, other.curve.transmission_error, atol=1e-12
        )
    assert np.abs(linear.rows[0].runs[0].rows[:, -1]).max() < DEG


def test_a_lifted_summary_is_that_of_rows_with_the_level_in_them(quick_log, quick_rig):
    _, linear = looked(quick_log, quick_rig.pair)
    assert lifted(linear.summary, (0.0,)) is linear.summary
    rows = linear.rows[0]
    runs = []
    for run in rows.runs:
        whole = run.rows.copy()
        whole[:, -1] += LEVEL
        runs.append(replace(run, rows=whole))
    whole = summarise([replace(rows, runs=tuple(runs))], linear.model.terms)
    found = lifted(linear.summary, (LEVEL,))
    for flank, other in zip(found.flanks, whole.flanks, strict=True):
        lags = min(len(flank.lag_products), len(other.lag_products))
        products, expected = lag_products_of(flank)[:lags], lag_products_of(other)[:lags]
        largest = np.abs(expected).max()
        np.testing.assert_allclose(products, expected, atol=1e-12 * largest)
        assert flank.rows == other.rows
        bare = next(f for f in linear.summary.flanks if f.flank == flank.flank)
        assert np.abs(products[0] - lag_products_of(bare)[0]).max() > 0.1 * largest


def test_every_log_gets_its_own_level_back():
    solution = Solution(
        ("offset_of_1", "offset_of_2", "driven_x"),
        np.array([1e-3, 2e-3, 0.02]),
        np.eye(3),
        np.ones(3, bool),
        np.zeros((1, 2)),
        np.zeros((1, 2, 3)),
        True,
        5,
    )
    found = restored(solution, (LEVEL, -LEVEL))
    np.testing.assert_allclose(found.values, [1e-3 + LEVEL, 2e-3 - LEVEL, 0.02])
    assert solution.values[0] == 1e-3
