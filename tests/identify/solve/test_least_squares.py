"""The solution against SciPy on the residuals of all parameters, and the rank of what it finds."""

from dataclasses import replace

import equinox as eqx
import numpy as np
import pytest
from scipy.optimize import least_squares

from tests.identify.summaries import TERMS, columns, layout_of, looked, summary_of
from vttig_jax.identify.model.forward_model import pair_relation
from vttig_jax.identify.noise.noise_model import WhitenedFlank, whiten
from vttig_jax.identify.report.notes import solver_notes
from vttig_jax.identify.solve.eccentricity_search import EccentricitySearch
from vttig_jax.identify.solve.least_squares import _covariance, solve


@pytest.fixture(scope="module")
def problem(noisy_rig, noisy_log):
    pair = noisy_rig.pair
    scope, linear = looked(noisy_log, pair)
    summary = linear.summary
    relation = pair_relation(pair, scope.terms, summary.columns, scope.flanks, encoder_terms=True)
    return pair, scope, relation, whiten(summary)[1]


def test_same_minimum_as_scipy(problem):
    _, _, relation, whitened = problem
    solution = solve(relation, whitened)
    coefficients = eqx.filter_jit(relation.coefficients)

    def residual(parameters):
        tied = np.asarray(coefficients(parameters))
        parts = []
        for flank, h in zip(whitened, tied, strict=True):
            matrix, target = flank.tied
            parts.append(matrix @ h - target)
        return np.concatenate(parts)

    scale = np.where(
        ["backlash" in n or "offset" in n or "encoder" in n for n in relation.names], 1e-4, 1e-2
    )
    other = least_squares(
        residual, np.zeros(len(relation.names)), x_scale=scale, xtol=1e-15, ftol=1e-15, gtol=1e-15
    )
    std = np.sqrt(np.diag(solution.covariance))
    assert solution.converged
    assert solution.steps > 0
    assert np.all(np.abs(solution.values - other.x) < 1e-3 * std)
    covariance = np.linalg.inv(other.jac.T @ other.jac)
    np.testing.assert_allclose(std, np.sqrt(np.diag(covariance)), rtol=1e-4)
    np.testing.assert_allclose(solution.tied, np.asarray(coefficients(solution.values)), atol=1e-15)
    assert np.all(solution.determined)


def test_one_flank_leaves_encoder_and_gear_open(problem):
    """With encoder terms a single flank sees only their sum; what is left stays determined."""
    pair, scope, _, whitened = problem
    layout = layout_of(scope.terms)
    relation = pair_relation(pair, scope.terms, layout, ("A",), encoder_terms=True)
    solution = solve(relation, whitened[:1])
    by_name = dict(zip(solution.names, solution.determined, strict=True))
    assert by_name.pop("offset")
    assert not any(by_name.values())
    assert np.all(np.isfinite(solution.covariance))


@pytest.mark.parametrize("apart", [0.0, 0.05])
def test_a_direction_without_data_is_flagged(paper_pair, apart):
    """Both shafts' columns alike: rank says so; a little apart and both are determined."""
    x = columns(2000, 0)
    x[:, 5:7] = x[:, 3:5] + apart * x[:, 5:7]
    noise = 1e-5 * np.random.default_rng(0).standard_normal(2000)
    y = 1e-3 + 3e-4 * x[:, 3] + noise
    whitened = whiten(summary_of({"A": [np.column_stack([x, y])]}))[1]
    relation = pair_relation(paper_pair, TERMS, layout_of(TERMS), ("A",), encoder_terms=False)
    solution = solve(relation, whitened)
    by_name = dict(zip(solution.names, solution.determined.tolist(), strict=True))
    assert by_name.pop("offset")
    assert set(by_name.values()) == {apart > 0}
    assert solution.values[0] == pytest.approx(1e-3, abs=1e-5)


def _farther(problem, offset: float) -> tuple[WhitenedFlank, ...]:
    """The same flanks with a constant added to the transmission error of both."""
    _, _, relation, whitened = problem
    spread = relation.linear[relation.names.index("offset")]
    found = []
    for flank, tied in zip(whitened, spread, strict=True):
        factor = flank.factor.copy()
        factor[: flank.free, -1] += offset * factor[: flank.free, flank.free : -1] @ tied
        factor[flank.free : -1, -1] += offset * flank.tied[0] @ tied
        found.append(replace(flank, factor=factor))
    return tuple(found)


def test_a_large_offset_leads_nowhere_else(problem):
    """Two radians, which a damped step would spread over eccentricities of metres."""
    _, _, relation, whitened = problem
    near, far = solve(relation, whitened), solve(relation, _farther(problem, 2.0))
    assert far.converged
    moved = far.values - near.values
    moved[relation.names.index("offset")] -= 2.0
    assert np.all(np.abs(moved) < 0.01 * np.sqrt(np.diag(near.covariance)))
    assert far.misfit == pytest.approx(near.misfit, rel=0.01)


def test_a_start_outside_the_valid_geometry_is_refused(problem):
    """Eccentricities of metres let the base circles overlap, and no step leads out of there."""
    _, _, relation, whitened = problem
    matrices, targets = (np.stack([flank.tied[part] for flank in whitened]) for part in (0, 1))
    std = np.sqrt(np.diag(solve(relation, whitened).covariance))
    search = EccentricitySearch.of(relation, matrices, targets, std)
    start = np.zeros(len(relation.names))
    start[relation.names.index("driving_x")] = 120.0
    values, settled, _ = search.minimise(start)
    assert not settled and np.array_equal(values, start)
    assert search.minimise(0 * start)[1]


@pytest.mark.parametrize(("off", "settled"), [(0.0, True), (1e-3, True), (0.1, False)])
def test_a_solver_that_ran_out_of_steps_is_judged_by_where_it_stands(
    problem, monkeypatch, off, settled
):
    """At a minimum, to a hundredth of a standard deviation, it has converged all the same."""
    _, _, relation, whitened = problem
    best = solve(relation, whitened)
    values = best.values.copy()
    values[0] += off / np.sqrt(np.linalg.inv(best.covariance)[0, 0])
    monkeypatch.setattr(EccentricitySearch, "minimise", lambda *_: (values, False, 100))
    assert solve(relation, whitened).converged is settled


def test_what_is_no_minimum_has_not_converged(problem, monkeypatch):
    """The negative control: a solver that says it is done where it is not."""
    _, _, relation, whitened = problem
    honest = solve(relation, whitened)
    assert honest.converged and solver_notes(honest) == []
    wrong = honest.values.copy()
    wrong[relation.names.index("driven_x")] += 4.0
    monkeypatch.setattr(EccentricitySearch, "minimise", lambda *_: (wrong, True, 67))
    found = solve(relation, whitened)
    assert not found.converged and found.misfit > 1000 * found.linear_misfit
    (note,) = solver_notes(found)
    assert "134 steps" in note and "[fit]" in note
    assert f"{found.misfit:.3g} standard deviations" in note
    monkeypatch.setattr(EccentricitySearch, "minimise", lambda *_: (np.nan * wrong, True, 67))
    assert not solve(relation, whitened).converged


def test_data_without_any_slope_determine_nothing():
    covariance, determined, weakest = _covariance(np.zeros((3, 2)), ("one", "other"))
    assert determined.tolist() == [False, False] and weakest is None
    np.testing.assert_array_equal(covariance, np.zeros((2, 2)))
