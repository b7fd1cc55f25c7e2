"""The density, its derivatives and the way to it, against independent computations."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import mpmath
import numpy as np
import pytest

from tests.model.small import (
    Small,
    autocovariance,
    dense_density,
    drawn,
    scaled,
    theta_near,
    whole,
)
from vttig_jax.model import density
from vttig_jax.model.columns import FLAT, KNOWN
from vttig_jax.model.density import FIRST, LAGS, SECOND, whitening
from vttig_jax.model.windows import windows

solved, log_density = jax.jit(density.solved), jax.jit(density.log_density)

PARTIALS = [
    np.array([0.9, -0.3, 0.2, 0.1, -0.1, 0.05, 0.0, 0.02]),
    np.array([0.999, -0.95, 0.7, -0.6, 0.5, -0.4, 0.3, 0.9]),
    np.zeros(LAGS),
]


def _by_yule_walker(partial: np.ndarray) -> list[mpmath.mpf]:
    """Filter whose autocovariances give these partial autocorrelations, in 60 digits.

    By definition: the k-th partial autocorrelation is the last coefficient of the best prediction
    from k values. The autocovariance of lag k is chosen so, order by order.
    """
    with mpmath.workdps(60):
        levels = [mpmath.mpf(1)]
        phi = mpmath.matrix(0, 1)
        for k, one in enumerate(partial, 1):
            # last coefficient = (c_k − Σ φ_j c_{k−j}) / (c_0 − Σ φ_j c_j)
            ahead = mpmath.fsum(phi[j] * levels[k - 1 - j] for j in range(k - 1))
            left = levels[0] - mpmath.fsum(phi[j] * levels[j + 1] for j in range(k - 1))
            levels.append(ahead + mpmath.mpf(float(one)) * left)
            square = mpmath.matrix(k, k)
            for i in range(k):
                for j in range(k):
                    square[i, j] = levels[abs(i - j)]
            phi = mpmath.lu_solve(square, mpmath.matrix(levels[1 : k + 1]))
        return [mpmath.mpf(1), *(-phi[j] for j in range(len(partial)))]


@pytest.mark.parametrize("partial", PARTIALS)
def test_the_filter_predicts_best(partial):
    expected = np.array([float(one) for one in _by_yule_walker(partial)])
    found = np.asarray(whitening(jnp.asarray(partial)))
    np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-13)
    wrong = np.asarray(whitening(jnp.asarray(partial + 1e-6)))
    assert np.abs(wrong - expected).max() > 1e-8


def test_the_filtered_noise_is_white():
    partial = PARTIALS[0]
    taps = np.asarray(whitening(jnp.asarray(partial)))
    levels = autocovariance(partial, 2.0, 40).astype(float)
    lags = np.abs(np.subtract.outer(np.arange(9), np.arange(9)))
    for shift in (0, 1, 5):
        both = taps @ levels[np.abs(shift + np.subtract.outer(np.arange(9), np.arange(9)))] @ taps
        assert both == pytest.approx(4.0 if shift == 0 else 0.0, abs=1e-9)
    assert taps @ levels[lags + 1] @ taps != pytest.approx(0.0, abs=1e-3)


def test_windows_are_direct_sums():
    rng = np.random.default_rng(1)
    lengths = [10, 31, 9]
    rows = rng.normal(size=(sum(lengths), 4))
    last = np.cumsum(lengths) - 1
    first = last - np.array(lengths) + 1
    found = windows(rows, first, last)
    expected = np.zeros_like(found)
    for place, (i, j) in enumerate(zip(FIRST, SECOND, strict=True)):
        for a, b in zip(first, last, strict=True):
            for k in range(a, b + 1 - (j - i)):
                # in a run of fewer than 2 i rows the first and the last i rows overlap
                times = 1 - (k < a + i) - (k > b - (j - i) - i)
                product = times * np.outer(rows[k], rows[k + j - i])
                expected[place] += product if i == j else product + product.T
    np.testing.assert_allclose(found, expected, atol=1e-12)
    joined = windows(rows, first[:1], last[-1:])
    assert np.abs(joined - expected).max() > 0.1


def test_windows_and_filter_are_the_inverse_covariance():
    rng = np.random.default_rng(2)
    lengths = [12, 20]
    rows = rng.normal(size=(sum(lengths), 3))
    last = np.cumsum(lengths) - 1
    first = last - np.array(lengths) + 1
    partial, sigma = PARTIALS[0], 0.7
    taps = np.asarray(whitening(jnp.asarray(partial)))
    found = np.tensordot(taps[FIRST] * taps[SECOND], windows(rows, first, last), 1) / sigma**2
    expected = np.zeros((3, 3))
    for a, b in zip(first, last, strict=True):
        own = rows[a : b + 1]
        levels = autocovariance(partial, sigma, len(own)).astype(float)
        apart = np.abs(np.subtract.outer(np.arange(len(own)), np.arange(len(own))))
        expected += own.T @ np.linalg.solve(levels[apart], own)
    np.testing.assert_allclose(found, expected, rtol=1e-9)


@pytest.mark.parametrize("seed", range(4))
def test_the_density_is_that_of_dense_matrices(seed):
    lengths = [((14, 11), (12, 17)), ((10, 10, 10, 10),), ((30,), (25, 9)), ((60, 40),)][seed]
    small = drawn(seed, lengths)
    problem = small.problem
    found, expected = [], []
    for number in range(5):
        theta = theta_near(100 * seed + number, problem)
        found.append(float(log_density(jnp.asarray(theta), problem.compressed)))
        expected.append(dense_density(small, theta))
    np.testing.assert_allclose(found, expected, rtol=2e-6)
    assert np.ptp(found) > 1


def test_another_covariance_has_another_density():
    small = drawn(0)
    problem = small.problem
    theta = theta_near(1, problem)
    moved = theta + np.eye(len(theta))[LAGS + 2] * 1e-3
    found = float(log_density(jnp.asarray(theta), problem.compressed))
    assert abs(found - dense_density(small, moved)) > 1e-5


def test_little_noise_under_wide_priors_costs_no_digits():
    """The marginal covariance is solved in 50 digits: its condition number is 1e10 here."""
    small = drawn(3, ((22, 19),), noise=1e-2)
    problem = small.problem
    theta = theta_near(2, problem, 0.1)
    theta[LAGS] = -1.0
    found = float(log_density(jnp.asarray(theta), problem.compressed))
    assert found == pytest.approx(dense_density(small, theta, 50), rel=1e-6)
    assert float(log_density(jnp.asarray(theta + 1e-3), problem.compressed)) != pytest.approx(
        found, rel=1e-6
    )


@pytest.mark.parametrize("seed", range(3))
def test_derivatives_are_those_of_the_density(seed):
    problem = drawn(seed).problem
    theta = jnp.asarray(theta_near(seed, problem))
    negative = lambda t: -log_density(t, problem.compressed)  # noqa: E731
    told = solved(theta, problem.compressed)
    assert float(told.value) == pytest.approx(float(negative(theta)), rel=1e-10)
    gradient, hessian = jax.grad(negative)(theta), jax.hessian(negative)(theta)
    np.testing.assert_allclose(told.gradient, gradient, atol=1e-6)
    np.testing.assert_allclose(told.hessian, hessian, atol=1e-5)
    steps = 1e-4 * np.eye(len(theta))
    values = [(negative(theta + s) - negative(theta - s)) / 2e-4 for s in steps]
    np.testing.assert_allclose(told.gradient, np.array(values), atol=1e-5)
    near = solved(theta + 1e-3, problem.compressed)
    assert np.abs(np.asarray(told.hessian - near.hessian)).max() > 1e-4


@pytest.mark.parametrize("seed", range(2))
def test_coefficients_and_their_slopes(seed):
    """β̂ maximises the joint density: least squares with the priors; its slopes by differences."""
    problem = drawn(seed).problem
    theta = jnp.asarray(theta_near(seed, problem))
    told = solved(theta, problem.compressed)
    at = lambda t: np.asarray(solved(t, problem.compressed).beta)  # noqa: E731
    h = 1e-5
    expected = np.array(
        [(at(theta + h * e) - at(theta - h * e)) / (2 * h) for e in np.eye(len(theta))]
    )
    found = -np.asarray(told.spread @ told.slopes).T
    np.testing.assert_allclose(found, expected, atol=1e-6 * np.abs(expected).max())
    assert np.abs(expected).max() > 1e-3


def test_coefficients_are_generalised_least_squares():
    small = drawn(5)
    problem = small.problem
    theta = theta_near(5, problem)
    told = solved(jnp.asarray(theta), problem.compressed)
    size = len(problem.columns)
    x, y, run = whole(small)
    norm = 1 / np.diag(problem.natural)
    x, y = x @ problem.natural, y / problem.unit
    sigma = float(np.exp(theta[LAGS]))
    levels = autocovariance(0.9999 * np.tanh(theta[:LAGS]), sigma, len(y)).astype(float)
    apart = np.abs(np.subtract.outer(np.arange(len(y)), np.arange(len(y))))
    weight = np.linalg.inv(np.where(np.equal.outer(run, run), levels[apart], 0.0))
    groups = dict(zip(small.usual, np.exp(theta[LAGS + 1 :]), strict=True))
    width = np.array([c.width * norm[k] for k, c in enumerate(small.columns)])
    precision = np.array(
        [
            0.0
            if c.prior == FLAT
            else (problem.unit / w) ** 2
            if c.prior == KNOWN
            else (w * groups[c.prior]) ** -2
            for c, w in zip(small.columns, width, strict=True)
        ]
    )
    mean = np.array([-small.centres.get(c.name, 0.0) for c in small.columns]) * norm / problem.unit
    m = x.T @ weight @ x + np.diag(precision)
    expected = np.linalg.solve(m, x.T @ weight @ y + precision * mean)
    found = np.asarray(told.beta)[:size] + problem.start / problem.unit
    np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-7)
    np.testing.assert_allclose(
        np.asarray(told.spread)[:size, :size], np.linalg.inv(m), rtol=1e-5, atol=1e-9
    )


def test_batches_are_loops():
    problem = drawn(1).problem
    thetas = jnp.asarray(np.stack([theta_near(k, problem) for k in range(3)]))
    one = [solved(t, problem.compressed) for t in thetas]
    for many in (
        jax.vmap(solved, (0, None))(thetas, problem.compressed),
        jax.lax.map(lambda t: solved(t, problem.compressed), thetas),
    ):
        for name in ("value", "gradient", "hessian", "beta", "spread", "slopes", "moments"):
            expected = np.stack([np.asarray(getattr(told, name)) for told in one])
            np.testing.assert_allclose(getattr(many, name), expected, rtol=1e-8, atol=1e-8)
    assert np.ptp(np.asarray(jax.vmap(log_density, (0, None))(thetas, problem.compressed))) > 1


def test_neutral_columns_change_nothing():
    problem = drawn(2).problem
    theta = jnp.asarray(theta_near(2, problem))
    wider = padded(padded(jax.tree.map(np.asarray, problem.compressed)))
    assert float(log_density(theta, wider)) == pytest.approx(
        float(log_density(theta, problem.compressed)), abs=1e-9
    )


def test_another_unit_of_the_readings_is_the_same_density():
    one, other = drawn(4), scaled(drawn(4), 3600.0)
    theta = jnp.asarray(theta_near(4, one.problem))
    values = [solved(theta, small.problem.compressed) for small in (one, other)]
    assert float(values[1].value) == pytest.approx(float(values[0].value), abs=1e-6)
    np.testing.assert_allclose(values[1].beta, values[0].beta, rtol=1e-6, atol=1e-8)
    assert other.problem.unit == pytest.approx(3600 * one.problem.unit)


def test_a_scaled_column_with_its_width_is_the_same_density():
    small = drawn(6)
    logs = []
    for rows in small.logs:
        table = rows.table.copy()
        table[:, rows.names["c",]] *= 1e5
        table[:, rows.names["a",]] *= 1e-4
        logs.append(replace(rows, table=table))
    factor = {("c",): 1e-5, ("a",): 1e4}
    columns = tuple(replace(c, width=c.width * factor.get(c.row, 1.0)) for c in small.columns)
    # the columns of one group share τ, so that both columns of c are scaled with their width
    other = Small(columns, tuple(logs), small.centres, small.usual)
    theta = jnp.asarray(theta_near(6, small.problem))
    values = [float(log_density(theta, s.problem.compressed)) for s in (small, other)]
    # ln|M| and Σ ln v of a group's columns move together; a known width is a constant
    assert values[1] == pytest.approx(values[0], abs=1e-6)
    wrong = Small(small.columns, tuple(logs), small.centres, small.usual)
    assert abs(float(log_density(theta, wrong.problem.compressed)) - values[0]) > 0.1


def test_logs_and_runs_have_no_order():
    small = drawn(8, ((14, 11), (12, 17)))
    theta = jnp.asarray(theta_near(8, small.problem))
    swapped = tuple(replace(c, log=None if c.log is None else 1 - c.log) for c in small.columns)
    other = Small(swapped, small.logs[::-1], small.centres, small.usual)
    a, b = (float(log_density(theta, s.problem.compressed)) for s in (small, other))
    assert a == pytest.approx(b, abs=1e-8)
    wrong = Small(small.columns, (small.logs[0], small.logs[0]), small.centres, small.usual)
    assert abs(float(log_density(theta, wrong.problem.compressed)) - a) > 0.1


def test_parts_of_the_delay_are_orthogonal_to_it():
    small = drawn(9)
    problem = small.problem
    x = whole(small)[0] @ problem.natural
    index = problem.index
    parts = [place for name, place in index.items() if name[0] == "part"]
    assert np.abs(x[:, parts].T @ x[:, index["delay",]]).max() < 1e-9
    assert np.abs(whole(small)[0][:, parts].T @ x[:, index["delay",]]).max() > 0.1
