"""The likelihood from lag products, against dense Gaussian log-densities of the same rows."""

from dataclasses import dataclass
from functools import cache
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import block_diag

from benchmarks.compiler import fast_to_compile
from tests.identify.summaries import TERMS, columns, summary_of
from tests.oracles.stationary_noise import covariance, path
from vttig_jax.base.numerics.partial_autocorrelation import filter_of
from vttig_jax.identify.compress.harmonic_summary import HarmonicSummary
from vttig_jax.identify.model.forward_model import ForwardModel, pair_relation
from vttig_jax.posterior.density.coefficients import coefficient_draws
from vttig_jax.posterior.density.likelihood import Likelihood, likelihood_of
from vttig_jax.rig.paper import paper_pair

LENGTHS = (90, 110)
"""Rows of the two runs of every flank."""
RELATIVE = 1e-9
ABSOLUTE = RELATIVE * 4 * sum(LENGTHS)
"""Rounding of a log-likelihood near zero, whose terms are some times the number of rows."""

ASKED = ("constant_backlash", "driving_x", "driving_y", "driven_x", "driven_y")
POINT = np.array([7e-4, 0.02, -0.01, 0.015, 0.03])
NOISE = np.log(3e-5)
HIGHEST = 16
PARTIALS = st.lists(st.floats(-0.7, 0.7), min_size=0, max_size=HIGHEST).map(np.array)


def taps(noise: np.ndarray) -> np.ndarray:
    return np.asarray(filter_of(noise))


@dataclass(frozen=True)
class Case:
    """Rows of some flanks, what they were compressed to, and the model on top of them."""

    rows: dict[str, list[np.ndarray]]
    summary: HarmonicSummary
    relation: ForwardModel
    jacobian: np.ndarray

    def likelihood(self, order: int, asked: tuple[str, ...] = ASKED) -> Likelihood:
        names = [name for name in self.relation.names if name in asked]
        return likelihood_of(
            self.summary,
            self.relation,
            self.jacobian,
            np.zeros(len(self.relation.names)),
            names,
            order,
        )


@cache
def case(drift_order: int = 1, flanks: Any = "AB", encoders: bool = True) -> Case:
    """Two runs a flank, of y that a rig near `POINT` would give under coloured noise."""
    generator = np.random.default_rng(5)
    rows = {}
    for flank in flanks:
        x = columns(sum(LENGTHS), drift_order)
        truth = 1e-4 * generator.standard_normal(x.shape[1])
        noise = 3e-5 * path(taps(np.array([0.6, -0.2])), len(x), generator)
        both = np.column_stack([x, x @ truth + noise])
        rows[flank] = np.split(both, [LENGTHS[0]])
    summary = summary_of(rows, drift_order, lags=16)
    relation = pair_relation(
        paper_pair(), TERMS, summary.columns, tuple(flanks), encoder_terms=encoders
    )
    slopes = jax.jit(jax.jacobian(relation.coefficients))
    jacobian = np.asarray(slopes(np.zeros(len(relation.names))))
    return Case(rows, summary, relation, jacobian)


def split(place: Case, asked: tuple[str, ...] = ASKED) -> tuple[np.ndarray, list[int], list[int]]:
    """Parameters with nuisance zero, places of the asked and of the nuisance."""
    names = place.relation.names
    own = [k for k, name in enumerate(names) if name in asked]
    values = np.zeros(len(names))
    chosen: dict[str, float] = dict(zip(ASKED, POINT.tolist(), strict=True))
    values[own] = [chosen[names[k]] for k in own]
    return values, own, [k for k in range(len(names)) if k not in own]


@eqx.filter_jit
def _tied(relation, parameters):
    return relation.coefficients(parameters)


def tied_of(place: Case, parameters: np.ndarray) -> np.ndarray:
    """Tied coefficients of every flank."""
    return np.asarray(_tied(place.relation, parameters))


def dense_parts(
    place: Case, parameters: np.ndarray, nuisance: list[int], noise: np.ndarray
) -> tuple[Any, Any, Any]:
    """Stacked residual, regressors of everything that is integrated out, and covariance."""
    free = place.summary.columns.free_width
    tied = tied_of(place, parameters)
    residuals, own, common, blocks = [], [], [], []
    for side, runs in enumerate(place.rows.values()):
        rows = np.concatenate(runs)
        residuals.append(rows[:, -1] - rows[:, free:-1] @ tied[side])
        own.append(rows[:, :free])
        common.append(rows[:, free:-1] @ place.jacobian[side][:, nuisance])
        blocks += [covariance(taps(noise), len(run)) for run in runs]
    both: Any = [block_diag(*own), np.concatenate(common)]
    design = np.hstack(both)
    return np.concatenate(residuals), design, block_diag(*blocks)


def dense(
    place: Case,
    parameters: np.ndarray,
    nuisance: list[int],
    noise: np.ndarray,
    log_std: float = NOISE,
    *,
    initial: bool = True,
) -> float:
    """log ∫ N(y; mean, σ²Σ) d(coefficients), without powers of 2π; `initial` False drops log|Σ|."""
    y, x, unit = dense_parts(place, parameters, nuisance, noise)
    gram = x.T @ np.linalg.solve(unit, x)
    right = x.T @ np.linalg.solve(unit, y)
    misfit = y @ np.linalg.solve(unit, y) - right @ np.linalg.solve(gram, right)
    determinant = np.linalg.slogdet(gram)[1]
    determinant += np.linalg.slogdet(unit)[1] if initial else 0.0
    freedom = len(y) - x.shape[1]
    return -0.5 * (2 * freedom * log_std + determinant + misfit * np.exp(-2 * log_std))


def value(likelihood: Likelihood, asked: np.ndarray, noise: np.ndarray, log_std: float) -> float:
    return float(_compiled(likelihood, asked, noise, np.asarray(log_std)))


@eqx.filter_jit
def _compiled(likelihood, asked, noise, log_std):
    return likelihood(jnp.asarray(asked), jnp.asarray(noise), jnp.asarray(log_std))


@cache
def highest(flanks: str) -> Likelihood:
    return case(1, flanks, encoders=len(flanks) == 2).likelihood(HIGHEST)


@pytest.mark.portable
@settings(max_examples=30)
@given(PARTIALS, st.sampled_from(["AB", "A"]))
def test_it_is_the_dense_restricted_likelihood(noise, flanks):
    """Zeros behind the partial autocorrelations leave the order what it is."""
    place = case(1, flanks, encoders=len(flanks) == 2)
    parameters, own, nuisance = split(place)
    padded = np.append(noise, np.zeros(HIGHEST - len(noise)))
    found = value(highest(flanks), parameters[own], padded, NOISE)
    expected = dense(place, parameters, nuisance, noise)
    assert found == pytest.approx(expected, rel=RELATIVE, abs=ABSOLUTE)


@pytest.mark.parametrize("order", [0, 1, 5])
def test_a_likelihood_of_its_own_order_agrees(order):
    place = case()
    noise = np.random.default_rng(order).uniform(-0.6, 0.6, order)
    parameters, own, nuisance = split(place)
    found = value(place.likelihood(order), parameters[own], noise, NOISE)
    assert found == pytest.approx(dense(place, parameters, nuisance, noise), rel=RELATIVE)


def test_white_noise_is_order_zero():
    """The formula of ordinary least squares, written out."""
    place = case()
    parameters, own, nuisance = split(place)
    y, x, _ = dense_parts(place, parameters, nuisance, np.zeros(0))
    left = y - x @ np.linalg.lstsq(x, y, rcond=None)[0]
    expected = -(len(y) - x.shape[1]) * NOISE - 0.5 * np.linalg.slogdet(x.T @ x)[1]
    expected -= 0.5 * left @ left * np.exp(-2 * NOISE)
    found = value(place.likelihood(0), parameters[own], np.zeros(0), NOISE)
    assert found == pytest.approx(expected, rel=RELATIVE)


def test_differences_do_not_depend_on_what_is_asked():
    """With every parameter asked only the free harmonics are integrated out."""
    place = case()
    names = place.relation.names
    noise = np.array([0.5, -0.3, 0.2])
    likelihood = place.likelihood(3, names)
    assert likelihood.spread.shape[0] == 0
    point = 1e-4 * np.random.default_rng(1).standard_normal(len(names))
    found = value(likelihood, point, noise, NOISE)
    assert found == pytest.approx(dense(place, point, [], noise), rel=RELATIVE)


def test_the_misfit_is_the_whitened_quadratic_form():
    """What multiplies −1/2σ² with nothing but the free harmonics taken out."""
    place = case()
    names = place.relation.names
    noise = np.array([0.7, 0.2])
    likelihood = place.likelihood(2, names)
    point = 1e-4 * np.random.default_rng(2).standard_normal(len(names))
    factor = eqx.filter_jit(likelihood.reduced)(jnp.asarray(noise)).factor
    residual, nuisance = eqx.filter_jit(likelihood.whitened_residual)(jnp.asarray(point), factor)
    found = float(np.sum(np.asarray(factor)[:, -1, -1] ** 2) + np.sum(np.square(residual)))
    y, x, unit = dense_parts(place, point, [], noise)
    right = x.T @ np.linalg.solve(unit, y)
    gram = x.T @ np.linalg.solve(unit, x)
    expected = y @ np.linalg.solve(unit, y) - right @ np.linalg.solve(gram, right)
    assert nuisance.shape[1] == 0
    assert found == pytest.approx(expected, rel=RELATIVE)


def test_what_is_neither_asked_nor_in_the_way_keeps_its_value():
    """Undetermined parameters are nuisance too: their columns are integrated out, not fixed."""
    place = case()
    asked = tuple(name for name in ASKED if not name.startswith("driven"))
    likelihood = place.likelihood(1, asked)
    parameters, own, nuisance = split(place, asked)
    noise = np.array([0.4])
    found = value(likelihood, parameters[own], noise, NOISE)
    assert found == pytest.approx(dense(place, parameters, nuisance, noise), rel=RELATIVE)


@pytest.mark.parametrize("wrong", ["ends", "determinant"])
def test_the_comparison_sees_what_is_left_out(wrong):
    place = case()
    parameters, own, nuisance = split(place)
    noise = np.array([0.5, -0.3])
    likelihood = place.likelihood(2)
    if wrong == "ends":
        products = np.asarray(likelihood.products).copy()
        products[3:] = 0.0
        object.__setattr__(likelihood, "products", products)
    found = value(likelihood, parameters[own], noise, NOISE)
    expected = dense(place, parameters, nuisance, noise, initial=wrong != "determinant")
    assert found != pytest.approx(expected, rel=1e3 * RELATIVE)


def test_gradient_and_hessian_are_finite_and_those_of_differences():
    place = case()
    parameters, own, _ = split(place)
    likelihood = place.likelihood(2)
    scale = np.array([*np.full(len(own), 1e-5), 1e-3, 1e-3, 1e-3])
    centre = np.array([*parameters[own], NOISE, 0.5, -0.3])

    @jax.jit
    def density(z):
        point = centre + scale * z
        return likelihood(point[: len(own)], point[len(own) + 1 :], point[len(own)])

    zero = np.zeros(len(centre))
    slope = jax.jit(jax.grad(density), **fast_to_compile())
    gradient, hessian = slope(zero), jax.jit(jax.hessian(density), **fast_to_compile())(zero)
    assert np.isfinite(gradient).all() and np.isfinite(hessian).all()
    steps = 0.1 * np.eye(len(centre))
    ahead, back = (np.array([float(density(s * step)) for step in steps]) for s in (1, -1))
    np.testing.assert_allclose(gradient, (ahead - back) / 0.2, rtol=1e-4, atol=1e-3)
    slopes = [(np.asarray(slope(step)) - np.asarray(slope(-step))) / 0.2 for step in steps]
    size = np.sqrt(np.abs(np.diag(hessian)))
    np.testing.assert_allclose(
        hessian / np.outer(size, size), slopes / np.outer(size, size), atol=2e-3
    )


def test_a_robust_loss_counts_what_no_coefficient_explains_by_its_factor():
    """The misfit at the best coefficients times the factor; what moving them costs stays."""
    place = case()
    parameters, own, _ = split(place)
    names = [place.relation.names[k] for k in own]
    plain, robust = (
        likelihood_of(place.summary, place.relation, place.jacobian, parameters, names, 1, factor)
        for factor in (1.0, 1.7)
    )
    noise = np.array([0.4])
    factor = eqx.filter_jit(plain.reduced)(jnp.asarray(noise)).factor
    left = float(np.sum(np.asarray(factor)[:, -1, -1] ** 2))
    added = -0.5 * 0.7 * left * np.exp(-2 * NOISE)
    for point in (parameters[own], parameters[own] + 1e-6):
        gain = value(robust, point, noise, NOISE) - value(plain, point, noise, NOISE)
        assert gain == pytest.approx(added, rel=1e-9)


def test_new_values_do_not_trace_again():
    place = case()
    _, own, _ = split(place)
    likelihood = place.likelihood(2)
    traces = []

    @jax.jit
    def density(point, noise, log_std):
        traces.append(1)
        return likelihood(point, noise, log_std)

    for k in range(3):
        density(np.full(len(own), 1e-3 * k), np.array([0.1 * k, 0.2]), np.asarray(NOISE + k))
    assert len(traces) == 1


@pytest.mark.parametrize("flanks", ["AB", "A"])
def test_drawn_coefficients_have_mean_and_covariance_of_generalised_least_squares(flanks):
    place = case(1, flanks, encoders=len(flanks) == 2)
    parameters, own, nuisance = split(place)
    noise = np.array([0.6, -0.2])
    likelihood = place.likelihood(2)
    point, count = np.concatenate([parameters[own], [NOISE], noise]), 5_000
    drawn = coefficient_draws(likelihood, np.tile(point, (count, 1)), seed=0)
    mean, spread = dense_coefficients(place, parameters, nuisance, noise)
    flat = drawn.reshape(count, -1)
    size = np.sqrt(np.diag(spread))
    loose = size > 1e-12 * np.abs(mean).max()
    error = (flat.mean(axis=0) - mean)[loose] / size[loose]
    assert np.abs(error).max() < 5 / np.sqrt(count)
    still = np.abs(flat - mean)[:, ~loose]
    assert still.max(initial=0.0) < 1e-9 * np.abs(mean).max()
    found = np.cov(flat[:, loose].T) / np.outer(size[loose], size[loose])
    expected = spread[np.ix_(loose, loose)] / np.outer(size[loose], size[loose])
    assert np.abs(found - expected).max() < 7 / np.sqrt(count)


def dense_coefficients(
    place: Case, parameters: np.ndarray, nuisance: list[int], noise: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Mean and covariance of the coefficients (free, own, tied) of every flank given the asked."""
    y, x, unit = dense_parts(place, parameters, nuisance, noise)
    inverse = np.linalg.inv(x.T @ np.linalg.solve(unit, x))
    best = inverse @ x.T @ np.linalg.solve(unit, y)
    free, flanks = place.summary.columns.free_width, len(place.rows)
    tied = tied_of(place, parameters)
    width = free + tied.shape[1]
    matrix = np.zeros((flanks * width, x.shape[1]))
    shift = np.zeros(flanks * width)
    for side in range(flanks):
        at = side * width
        matrix[at : at + free, side * free : (side + 1) * free] = np.eye(free)
        matrix[at + free : at + width, flanks * free :] = place.jacobian[side][:, nuisance]
        shift[at + free : at + width] = tied[side]
    covariance_ = np.exp(2 * NOISE) * matrix @ inverse @ matrix.T
    return shift + matrix @ best, covariance_
