"""The likelihood of a linear model with autoregressive noise of Student's distribution."""

import numpy as np
import pytest
from scipy import stats
from scipy.signal import lfilter

from vttig_jax.base.numerics.student_noise import NoiseFit, fit_student_noise

pytestmark = pytest.mark.smoke

ROWS = 400
PLACE = np.arange(ROWS)
COLUMNS = np.stack([np.ones(ROWS), PLACE / ROWS, np.sin(PLACE / 9)], axis=1)
SIGNAL = COLUMNS @ [3.0, -2.0, 1.0]


def in_units(fit: NoiseFit, values: np.ndarray) -> float:
    """The function scales the values by their range; this is ln L in the unit of the values."""
    return fit.log_likelihood - len(values) * np.log(np.ptp(values))


def coloured(seed: int, freedom: float, scale: float = 0.3) -> tuple[np.ndarray, np.ndarray]:
    """Values with noise z_t = 0.8 z_{t−1} + e_t of Student's innovations e, and the e."""
    generator = np.random.default_rng(seed)
    drawn = stats.t.rvs(freedom, size=ROWS + 200, random_state=generator)
    innovation = scale * np.asarray(drawn)
    noise = np.asarray(lfilter([1.0], [1.0, -0.8], innovation))
    return SIGNAL + noise[200:], innovation[200:]


def test_white_normal_noise_gives_least_squares():
    """ln L is that of the normal distribution with the mean square residual as its variance."""
    for seed in range(4):
        quantiles = stats.norm.ppf((PLACE + 0.5) / ROWS)
        values = SIGNAL + 0.5 * np.random.default_rng(seed).permutation(quantiles)
        residual = values - COLUMNS @ np.linalg.lstsq(COLUMNS, values, rcond=None)[0]
        expected = stats.norm.logpdf(residual, scale=np.sqrt(np.mean(residual**2))).sum()
        fit = fit_student_noise(values, COLUMNS, order=0)
        assert in_units(fit, values) == pytest.approx(expected, abs=1e-3)
        np.testing.assert_allclose(fit.residual, residual, atol=1e-5)
        assert fit_student_noise(values, COLUMNS).order == 0


@pytest.mark.parametrize("freedom", [4, 10, 1e6])
def test_more_columns_do_not_lower_the_likelihood(freedom):
    """A fit that starts from the fit of fewer columns keeps its ln L up to 0.01."""
    generator = np.random.default_rng(7)
    values, _ = coloured(3, freedom)
    columns, fit = COLUMNS, fit_student_noise(values, COLUMNS)
    for place in (40, 170, 310):
        for added in (np.greater(PLACE, place), generator.standard_normal(ROWS)):
            columns = np.column_stack([columns, added])
            larger = fit_student_noise(values, columns, fit)
            assert larger.log_likelihood >= fit.log_likelihood - 0.01
            fit = larger


def test_the_optimum_is_above_the_truth():
    """ln L exceeds that of the true parameters, by no more than seven parameters can.

    2 Δ ln L has a χ² distribution of seven degrees of freedom; it exceeds 40 in 1 of 10⁶ cases.
    """
    for freedom in (4, 10):
        for seed in range(4):
            values, innovation = coloured(seed, freedom)
            truth = stats.t.logpdf(innovation[1:], freedom, scale=0.3).sum() * ROWS / (ROWS - 1)
            gain = 2 * (in_units(fit_student_noise(values, COLUMNS, order=1), values) - truth)
            assert 0 <= gain < 40


def test_heavy_tails_beat_least_squares():
    """For innovations with 2 degrees of freedom, ln L is far above that of normal ones."""
    values, _ = coloured(0, 2)
    fit = fit_student_noise(values, COLUMNS, order=1)
    white = fit.residual[1:] - 0.8 * fit.residual[:-1]
    normal = stats.norm.logpdf(white, scale=white.std()).sum() * ROWS / (ROWS - 1)
    assert in_units(fit, values) > normal + 50


def test_an_outlier_has_a_small_weight():
    """One wrong value among 400 takes a small weight and does not move the coefficients."""
    noise = 0.1 * np.random.default_rng(0).standard_normal(ROWS)
    fit = fit_student_noise(SIGNAL + noise + 5.0 * (PLACE == 120), COLUMNS, order=0)
    assert np.argmin(fit.weight) == 120 and fit.weight[120] < 0.05
    assert fit.residual[120] == pytest.approx(5.0 + noise[120], abs=0.05)


@pytest.mark.parametrize("factor", [1e-6, 1e4])
def test_the_fit_is_scale_equivariant(factor):
    """Other units of the values and columns scale the residual and shift ln L by n ln factor."""
    values, _ = coloured(1, 4)
    fit = fit_student_noise(values, COLUMNS)
    other = fit_student_noise(factor * values, COLUMNS * [1e3, 1.0, 1e-3])
    assert other.order == fit.order
    np.testing.assert_allclose(other.residual / factor, fit.residual, atol=1e-9)
    np.testing.assert_allclose(other.weight, fit.weight, rtol=1e-9)
    shift = ROWS * np.log(factor)
    assert in_units(other, factor * values) == pytest.approx(in_units(fit, values) - shift)
