"""Restricted maximum likelihood from lags, against the dense likelihood climbed by scipy."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize

from tests.identify.summaries import columns, summary_of
from tests.oracles.stationary_noise import covariance, path
from vttig_jax.base.numerics.partial_autocorrelation import filter_of
from vttig_jax.identify.compress.harmonic_summary import HarmonicSummary
from vttig_jax.identify.noise.freedom import freedom
from vttig_jax.identify.noise.reml import lowered, restricted_partial, touching_bound

TRUE = np.array([0.85, -0.3])


def _logs(seed: int, count: int = 150, partial: np.ndarray = TRUE) -> list[np.ndarray]:
    """One run a flank."""
    generator = np.random.default_rng(seed)
    rows = []
    for _ in range(2):
        x = columns(count, 0)
        y = x.sum(axis=1) + path(filter_of(partial), count, generator)
        rows.append(np.column_stack([x, y]))
    return rows


def _summary(rows: list[np.ndarray], lags: int) -> HarmonicSummary:
    return summary_of({"A": [rows[0]], "B": [rows[1]]}, lags=lags)


def _dense(partial: np.ndarray, rows: list[np.ndarray], *, restricted: bool = True) -> float:
    """−2 log-likelihood with dense matrices, the variance at its best."""
    determinant, misfit, swallowed = 0.0, 0.0, 0
    for run in rows:
        dense = covariance(filter_of(partial), len(run))
        x, y = run[:, :-1], run[:, -1]
        inverse = np.linalg.inv(dense)
        gram = x.T @ inverse @ x
        left = y - x @ np.linalg.solve(gram, x.T @ inverse @ y)
        misfit += left @ inverse @ left
        determinant += np.linalg.slogdet(dense)[1]
        if restricted:
            determinant += np.linalg.slogdet(gram)[1]
            swallowed += x.shape[1]
    return float(determinant + (sum(map(len, rows)) - swallowed) * np.log(misfit))


def _climbed(rows: list[np.ndarray], order: int, *, restricted: bool = True) -> np.ndarray:
    found = minimize(
        lambda z: _dense(np.tanh(z), rows, restricted=restricted),
        np.full(order, 0.1),
        method="BFGS",
        options={"gtol": 1e-5},
    )
    return np.tanh(found.x)


@pytest.mark.parametrize("seed", [0, 1])
def test_the_maximum_is_that_of_the_dense_likelihood(seed):
    rows = _logs(seed)
    found = restricted_partial(_summary(rows, 2))
    np.testing.assert_allclose(found, _climbed(rows, len(found)), atol=2e-5)
    assert len(found) == 2


def test_it_is_not_the_unrestricted_maximum():
    """Columns that swallow the slow part of the noise make it look whiter than it is."""
    rows = _logs(2, count=60, partial=np.array([0.9]))
    found = restricted_partial(_summary(rows, 1))
    plain = _climbed(rows, 1, restricted=False)
    assert found[0] > plain[0] + 0.02


def test_it_is_unbiased_where_plain_likelihood_is_not():
    """Over 150 short logs of AR(1) noise, 60 rows a flank and 14 coefficients."""
    found = [
        restricted_partial(_summary(_logs(seed, 60, np.array([0.8])), 1)) for seed in range(150)
    ]
    values = np.array([partial[0] for partial in found if len(partial)])
    assert len(values) > 145
    assert abs(values.mean() - 0.8) < 4 * values.std() / np.sqrt(len(values)) + 0.02


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10_000), st.lists(st.floats(-0.9, 0.9), min_size=1, max_size=4))
def test_no_step_goes_up(seed, start):
    """The bound touches the likelihood where it is taken and lies above it elsewhere."""
    rows = _logs(seed, 80)
    before = np.array(start)
    bound = touching_bound(_summary(rows, 4), before)
    after = lowered(bound, before)
    gain = _dense(before, rows) - _dense(after, rows)
    promised = bound.at(before, filter_of(before)) - bound.at(after, filter_of(after))
    assert gain >= promised - 1e-6 >= -2e-6


@pytest.mark.parametrize("order", [0, 1, 3])
def test_the_order_is_that_of_the_noise(order):
    partial = np.array([0.7, -0.5, 0.4])[:order]
    orders = [len(restricted_partial(_summary(_logs(s, 800, partial), 8))) for s in range(12)]
    assert np.mean(np.array(orders) == order) > 0.7


def _gram(partial: np.ndarray, run: np.ndarray) -> np.ndarray:
    """Products of the columns, with y behind, over the dense covariance."""
    return run.T @ np.linalg.solve(covariance(filter_of(partial), len(run)), run)


def _likelihood_and_variances(theta: np.ndarray, rows: list[np.ndarray], functions: list):
    """−2 ln restricted likelihood, and the variances of functions of all flanks, dense."""
    size, partial = np.exp(theta[0]), np.tanh(theta[1:])
    height, variances = 0.0, np.zeros(functions[0].shape[1])
    for run, weights in zip(rows, functions, strict=True):
        dense = size * covariance(filter_of(partial), len(run))
        spread = np.linalg.inv(_gram(partial, run)[:-1, :-1] / size)
        left = run[:, -1] - run[:, :-1] @ spread @ (_gram(partial, run)[:-1, -1] / size)
        height += np.linalg.slogdet(dense)[1] - np.linalg.slogdet(spread)[1]
        height += left @ np.linalg.solve(dense, left)
        variances += np.einsum("ck,cd,dk->k", weights, spread, weights)
    return height, variances


@pytest.mark.parametrize("flanks", ["AB", "A"])
def test_degrees_of_freedom_are_those_of_dense_differences(flanks):
    """2 ν⁻¹ is the variance of ln v by the inverse Hessian of −ln L (Satterthwaite)."""
    lengths = dict(zip(flanks, (60, 45), strict=False))
    partial = np.array([0.7, -0.4])
    rows = [_logs(7 + place, count, partial)[0] for place, count in enumerate(lengths.values())]
    summary = summary_of({flank: [run] for flank, run in zip(flanks, rows, strict=True)}, lags=2)
    generator = np.random.default_rng(1)
    functions = [generator.standard_normal((rows[0].shape[1] - 1, 3)) for _ in rows]
    left = sum(map(len, rows)) - len(rows) * (rows[0].shape[1] - 1)
    misfit = sum(1 / np.linalg.inv(_gram(partial, run))[-1, -1] for run in rows)
    centre = np.append(np.log(misfit / left), np.arctanh(partial))

    def at(*moves: np.ndarray):
        return _likelihood_and_variances(centre + np.sum(moves, axis=0), rows, functions)

    moves = 2e-3 * np.eye(3)
    hessian = [
        [at(a, b)[0] - at(a, -b)[0] - at(-a, b)[0] + at(-a, -b)[0] for a in moves] for b in moves
    ]
    hessian = np.array(hessian) / (2 * 2e-3) ** 2
    slope = np.array([np.log(at(a)[1]) - np.log(at(-a)[1]) for a in moves]) / (2 * 2e-3)
    expected = 2 / np.einsum("pk,pq,qk->k", slope, 2 * np.linalg.inv(hessian), slope)
    responses = [
        np.linalg.solve(_gram(partial, run)[:-1, :-1], weights)
        for run, weights in zip(rows, functions, strict=True)
    ]
    assert np.linalg.eigvalsh(hessian).min() > 1 and expected.min() > 3
    np.testing.assert_allclose(freedom(summary, partial, responses), expected, rtol=2e-3)
