"""Orthogonal factors against arbitrary precision, and where Cholesky factors would fail."""

import mpmath
import numpy as np
import pytest

from tests.identify.summaries import lagged_flank, normal_matrix
from vttig_jax.identify.compress.lagged_flank import LaggedFlank
from vttig_jax.identify.compress.orthogonal import (
    PSEUDO_OBSERVATION,
    ConditionedRuns,
    least_squares,
    orthonormal,
    residual_weights,
    triangle_of,
)

pytestmark = pytest.mark.smoke


def _near(angle: float, count: int = 200) -> np.ndarray:
    """Two columns that enclose a small angle, scaled ten decades apart, and y of both."""
    place = np.linspace(0, 6, count)
    first = np.cos(place)
    second = 1e-10 * (first + angle * np.sin(place))
    return np.column_stack([first, second, 2.0 * first + 3e10 * second])


@pytest.mark.portable
def test_factors_are_orthonormal_and_give_the_rows_back():
    rows = np.random.default_rng(0).standard_normal((50, 4)) * [1.0, 1e-8, 1e8, 1.0]
    found = orthonormal(rows)
    whole = np.vstack([found.rows, found.pseudo])
    np.testing.assert_allclose(whole.T @ whole, np.eye(4), atol=1e-14)
    np.testing.assert_allclose(found.rows @ found.triangle, rows, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(found.triangle, triangle_of(rows), rtol=1e-12)
    assert np.all(np.tril(found.triangle, -1) == 0) and np.all(np.diag(found.triangle) > 0)


@pytest.mark.portable
@pytest.mark.parametrize("angle", [1.0, 1e-4, 1e-8, 0.0])
def test_conditioned_rows_are_well_conditioned_and_give_the_rows_back(angle: float):
    """Whatever the rows are: with two equal columns, and with a y that they explain exactly."""
    rows = _near(angle)
    found = ConditionedRuns.of([rows[:30], rows[30:]], np.empty((0, rows.shape[1])))
    first, second = found.part(0, 0, 30), found.part(1, 0, len(rows) - 30)
    whole = np.vstack([first, second, found.pseudo])
    singular = np.linalg.svd(whole, compute_uv=False)
    assert singular[-1] > 0.5e-4 and singular[0] < 1 + 1e-9
    size = np.linalg.norm(rows, axis=0)
    assert np.all(np.abs(whole[: len(rows)] @ found.triangle - rows).max(axis=0) <= 1e-15 * size)
    assert np.all(np.tril(found.triangle, -1) == 0) and np.all(np.diag(found.triangle) > 0)
    # The factors of the conditioned rows are those of the rows.
    again, expected = triangle_of(whole) @ found.triangle, triangle_of(rows)
    np.testing.assert_allclose(again / size, expected / size, atol=3e-10)


@pytest.mark.portable
@pytest.mark.parametrize("angle", [1e-2, 1e-4])
def test_coefficients_of_nearly_equal_columns_are_those_of_arbitrary_precision(angle: float):
    rows = _near(angle)
    with mpmath.workdps(60):
        x, y = mpmath.matrix(rows[:, :2].tolist()), mpmath.matrix(rows[:, 2].tolist())
        exact = mpmath.lu_solve(x.T * x, x.T * y)
        expected = np.array([float(value) for value in exact])
    found = least_squares(triangle_of(rows))
    # The rounding of the columns themselves moves the coefficients by 1e-16 / angle.
    np.testing.assert_allclose(found, expected, rtol=1e-14 / angle**2)
    np.testing.assert_allclose(residual_weights(triangle_of(rows)), [*-found, 1.0])


@pytest.mark.portable
def test_squares_of_nearly_equal_columns_would_lose_them():
    """The negative control: what the factors are for."""
    rows = _near(1e-9)
    size = np.linalg.norm(rows[:, :2], axis=0)
    scaled = rows[:, :2] / size
    assert np.linalg.eigvalsh(scaled.T @ scaled)[0] < 1e-14
    pivot = triangle_of(rows)[1, 1] / size[1]
    assert 5e-10 < pivot < 2e-9


@pytest.mark.portable
def test_what_the_data_leave_open_is_decided_by_a_pseudo_observation():
    place = np.linspace(0, 6, 100)
    equal, none = np.cos(place), np.zeros(100)
    rows = np.column_stack([equal, equal, none, 2.0 * equal])
    triangle = triangle_of(rows)
    size = np.linalg.norm(equal)
    assert triangle[1, 1] == pytest.approx(PSEUDO_OBSERVATION * size, rel=0.5)
    assert triangle[2, 2] == pytest.approx(PSEUDO_OBSERVATION)
    found = least_squares(triangle)
    assert found[0] + found[1] == pytest.approx(2.0, abs=1e-9) and abs(found[2]) < 1e-6


@pytest.mark.portable
def test_an_exact_y_leaves_rounding():
    rows = _near(1e-2)
    assert triangle_of(rows)[-1, -1] < 1e-9 * np.linalg.norm(rows[:, -1])
    rows[:, -1] += 1e-6 * np.sin(17 * np.arange(200.0))
    assert triangle_of(rows)[-1, -1] > 1e-6


@pytest.mark.portable
@pytest.mark.parametrize("order", [0, 1, 3])
def test_a_summary_of_products_is_that_of_the_rows(order: int):
    generator = np.random.default_rng(order)
    runs = [np.cumsum(generator.standard_normal((n, 4)), axis=0) for n in (40, 70)]
    whole = lagged_flank(runs, 3)
    lagged = np.array(
        [sum(rows[lag:].T @ rows[: len(rows) - lag] for rows in runs) for lag in range(4)]
    )
    heads, tails = (np.stack([rows[part] for rows in runs]) for part in (slice(3), slice(-3, None)))
    found = LaggedFlank.of_products("A", 110, lag_products=lagged, heads=heads, tails=tails)
    filter_ = np.array([1.0, -0.5, 0.2, 0.1])[: order + 1]
    expected = normal_matrix(whole, filter_)
    np.testing.assert_allclose(normal_matrix(found, filter_), expected, rtol=1e-9)
    np.testing.assert_allclose(
        found.factor(filter_), whole.factor(filter_), rtol=1e-7, atol=1e-9 * np.abs(expected).max()
    )
    assert found.rows == whole.rows == 110
