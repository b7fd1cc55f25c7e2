"""Noise recovered from made-up rows, and least squares under it against dense algebra."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from tests.identify.summaries import columns, summary_of
from tests.oracles.stationary_noise import quadratic
from vttig_jax.base.errors import NoAnswerError
from vttig_jax.identify.noise.noise_model import whiten
from vttig_jax.identify.preliminary.nuisance import own_terms

pytestmark = pytest.mark.smoke

BETA = np.array([0.3, -0.2, 1.0, 0.5, -0.4, 0.1, 0.7])


def _ar1(count: int, rho: float, seed: int) -> np.ndarray:
    """Stationary AR(1) with innovations of one."""
    shocks = np.random.default_rng(seed).standard_normal(count)
    shocks[0] /= np.sqrt(1 - rho**2)
    return np.asarray(lfilter([1.0], [1.0, -rho], shocks))


def _rows(noise: np.ndarray) -> np.ndarray:
    x = columns(len(noise), 0)
    return np.column_stack([x, x @ BETA + noise])


def test_first_order_autoregression_is_found():
    noise, _ = whiten(summary_of({"A": [_rows(0.01 * _ar1(6000, 0.8, 1))]}))
    assert noise.coefficients[0] == pytest.approx(0.8, abs=0.05)
    assert noise.innovation_std == pytest.approx(0.01, rel=0.03)
    assert noise.std == pytest.approx(0.01 / 0.6, rel=0.08)
    # Half the two-sided sum of ρ^|k|, times the block.
    assert noise.correlation_s == pytest.approx(0.5 * 0.01 * 1.8 / 0.2, rel=0.15)


def test_white_noise_on_top_is_seen_in_the_spectrum():
    """AR(1) plus white is no AR(1): the filter must still leave its innovations white."""
    path = _ar1(8000, 0.9, 2) + np.random.default_rng(3).standard_normal(8000)
    noise, _ = whiten(summary_of({"A": [_rows(path)]}, lags=16))
    assert len(noise.coefficients) >= 2
    assert noise.std == pytest.approx(np.sqrt(1 / (1 - 0.81) + 1), rel=0.08)
    rest = np.asarray(lfilter(noise.filter, [1.0], path))[16:]
    assert noise.innovation_std == pytest.approx(rest.std(), rel=0.02)
    for lag in (1, 2, 3):
        assert abs(rest[lag:] @ rest[:-lag]) / (rest @ rest) < 0.03
    plain = np.asarray(lfilter([1.0, -0.9], [1.0], path))[16:]
    assert abs(plain[1:] @ plain[:-1]) / (plain @ plain) > 0.2


def test_white_noise_needs_no_filter():
    path = np.random.default_rng(4).standard_normal(4000)
    noise, _ = whiten(summary_of({"A": [_rows(path)]}))
    assert np.all(np.abs(noise.coefficients) < 0.06)
    assert noise.innovation_std == pytest.approx(1.0, rel=0.03)


def test_flanks_share_one_noise_but_not_their_coefficients():
    first, second = (0.1 * _ar1(3000, 0.7, seed) for seed in (5, 6))
    moved = _rows(second)
    moved[:, -1] += 5.0
    noise, flanks = whiten(summary_of({"A": [_rows(first)], "B": [moved]}))
    assert noise.coefficients[0] == pytest.approx(0.7, abs=0.06)
    assert noise.innovation_std == pytest.approx(0.1, rel=0.04)
    levels = [np.linalg.solve(*flank.tied)[0] for flank in flanks]
    assert levels[1] - levels[0] == pytest.approx(5.0, abs=0.1)


def test_zero_noise_is_no_trouble():
    rows = _rows(np.zeros(500))
    noise, flanks = whiten(summary_of({"A": [rows]}))
    assert noise.is_rounding
    assert noise.std == pytest.approx(1e-6 * np.sqrt(np.mean(rows[:, -1] ** 2)))
    assert np.all(np.isfinite(noise.coefficients))
    np.testing.assert_allclose(np.linalg.solve(*flanks[0].tied), BETA[2:], atol=1e-6)


def _dense(rows: list[np.ndarray], filter_: np.ndarray):
    """Generalised least squares with the dense covariance: coefficients, (XᵀΣ⁻¹X)⁻¹, misfit."""
    gram = quadratic(filter_, rows)
    inverse = np.linalg.inv(gram[:-1, :-1])
    beta = inverse @ gram[:-1, -1]
    return beta, inverse, float(gram[-1, -1] - gram[:-1, -1] @ beta)


def test_coefficients_equal_generalised_least_squares():
    runs = [_rows(_ar1(300, 0.6, 7)), _rows(_ar1(250, 0.6, 8))]
    noise, (flank,) = whiten(summary_of({"A": runs}))
    beta, inverse, _ = _dense(runs, noise.filter)
    tied = np.linalg.solve(*flank.tied)
    np.testing.assert_allclose(np.append(flank.free_given(tied), tied), beta, atol=1e-8)
    r, _ = flank.tied
    of_tied = np.linalg.inv(r.T @ r)
    covariance = noise.innovation_std**2 * inverse
    np.testing.assert_allclose(flank.covariance(of_tied), covariance, rtol=1e-6, atol=1e-9)


def test_ordinary_least_squares_would_err():
    run = _rows(_ar1(400, 0.7, 9))
    noise, (flank,) = whiten(summary_of({"A": [run]}, lags=1))
    r, _ = flank.tied
    ours = np.sqrt(np.diag(flank.covariance(np.linalg.inv(r.T @ r))))
    x = run[:, :-1]
    ordinary = noise.std * np.sqrt(np.diag(np.linalg.inv(x.T @ x)))
    assert np.abs(ordinary / ours - 1).max() > 0.3


def test_misfit_is_that_of_the_dense_covariance():
    run = _rows(_ar1(300, 0.6, 10))
    filter_ = np.array([1.0, -0.6])
    own = own_terms(summary_of({"A": [run]}), filter_)
    assert own.misfit(own.names) == pytest.approx(_dense([run], filter_)[2], rel=1e-8)


def test_products_that_cannot_be_factored_are_no_answer():
    flank = summary_of({"A": [_rows(_ar1(300, 0.6, 10))]}).flanks[0]
    assert np.isfinite(flank.inner(np.ones(1))).all()
    with pytest.raises(NoAnswerError, match="so smooth that its noise"):
        replace(flank, lag_products=-flank.lag_products).inner(np.ones(1))


def test_weights_count_by_the_squares_of_their_ones():
    """A block of which a loss leaves a share s holds √s where others hold 1."""
    rows = _rows(_ar1(500, 0.5, 11))
    share = np.random.default_rng(12).uniform(0, 1, 500)
    weighted = rows * np.sqrt(share)[:, None]
    assert summary_of({"A": [rows]}).counted_rows == pytest.approx(500)
    counted = summary_of({"A": [weighted, rows]}).counted_rows
    assert counted == pytest.approx(share.sum() + 500)


def test_a_variance_factor_widens_every_error():
    summary = summary_of({"A": [_rows(_ar1(500, 0.5, 13))]})
    (plain_noise, (plain,)), (noise, (wide,)) = whiten(summary), whiten(summary, 4.0)
    assert noise.innovation_std == pytest.approx(2 * plain_noise.innovation_std)
    np.testing.assert_allclose(2 * wide.factor, plain.factor, atol=1e-12)
