"""Standard errors from blocks: equal to the model's where it is right, larger where it is not."""

from dataclasses import replace

import numpy as np
import pytest

from tests.identify.quick import quick_rig
from tests.identify.summaries import looked
from vttig_jax.identify.model.forward_model import pair_relation
from vttig_jax.identify.noise.noise_model import NoiseModel, whiten
from vttig_jax.identify.report.comparisons.backlash_readings import mean_gap
from vttig_jax.identify.solve import sandwich
from vttig_jax.identify.solve.least_squares import solve
from vttig_jax.identify.solve.sandwich import Functional, standard_errors, widened
from vttig_jax.identify.solve.solved_fit import SolvedFit
from vttig_jax.rig.imperfections import Noise


@pytest.fixture(scope="module")
def linear():
    """Noise that is correlated over a quarter of a second, four times a row of the fit."""
    rig = quick_rig(0, reversal_deg=3600.0)
    rig = replace(rig, orders=(), noise=Noise(0.004, 0.02))
    return rig.pair, *looked(rig.log(0), rig.pair)


def _solved(linear, *, white: bool) -> SolvedFit:
    pair, scope, seen = linear
    noise, whitened = whiten(seen.summary)
    if white:
        noise = NoiseModel(np.empty(0), noise.std, noise.std, noise.block_s)
        whitened = tuple(
            replace(own, factor=flank.factor(np.ones(1)) / noise.std)
            for own, flank in zip(whitened, seen.summary.flanks, strict=True)
        )
    relation = pair_relation(
        pair, scope.terms, seen.summary.columns, scope.flanks, encoder_terms=True
    )
    solution = solve(relation, whitened)
    return SolvedFit(seen, seen.summary, noise, whitened, solution, solution.covariance)


def _widening(linear, *, white: bool) -> np.ndarray:
    return widened(_solved(linear, white=white), "blocks")


def test_the_right_noise_model_needs_no_widening(linear):
    found = _widening(linear, white=False)
    assert np.all(found >= 1.0)
    assert np.median(found) < 1.25


def test_memory_left_out_of_the_noise_model_is_seen(linear):
    """White standard errors are too small by √((1 + ρ)/(1 − ρ)) with ρ that of a row."""
    rho = np.exp(-linear[2].block_s / 0.02)
    expected = np.sqrt((1 + rho) / (1 - rho))
    assert expected > 1.5
    assert np.median(_widening(linear, white=True)) == pytest.approx(expected, rel=0.35)


def test_a_fit_with_the_right_noise_keeps_its_standard_errors(quick_fit):
    assert quick_fit.checks.whiteness is not None
    assert quick_fit.checks.whiteness.widening == 1.0


@pytest.mark.parametrize(("white", "row"), [(True, 7), (False, 7), (False, 0)])
def test_the_influence_of_a_row_is_that_of_another_fit(linear, white, row):
    """One row of flank B is changed by 1 µrad, and everything is solved again."""
    pair, scope, seen = linear
    driving = np.linspace(0.0, 5.0, 40)
    before = _solved(linear, white=white)
    gap = mean_gap(driving, before)
    runs = sorted(seen.rows[0].runs, key=lambda run: run.segment.start)
    place = [run.segment.flank for run in runs].index("B")
    step = 1e-6
    changed = runs[place].rows.copy()
    changed[row, -1] += step
    moved = [replace(run, rows=changed) if k == place else run for k, run in enumerate(runs)]
    other = replace(seen, rows=(replace(seen.rows[0], runs=tuple(moved)),))
    after = mean_gap(driving, _solved((pair, scope, other), white=white))
    own = sandwich._influences(before, gap.functional, whole=True)[place]
    assert own.weights is not None
    moved_by = float(after.value[0] - gap.value[0])
    assert moved_by == pytest.approx(own.weights[row, 0] * step, rel=0.02)
    if white:
        residual = float(changed[row] @ before.weights[0]["B"]) - step
        rows = sandwich._influences(before, gap.functional)[place].changes
        assert moved_by == pytest.approx(rows[row, 0] / residual * step, rel=0.02)


@pytest.mark.parametrize(
    ("scatter", "least", "most"),
    [("blocks", 0.5, 1.6), ("cosines", 0.4, 4.0), ("memory", 0.95, 4.0)],
)
def test_the_gap_has_standard_errors_of_its_own(linear, scatter, least, most):
    """Where the noise model is right, the log agrees with it; memory makes the error larger."""
    solved = _solved(linear, white=False)
    gap = mean_gap(np.linspace(0.0, 5.0, 40), solved)
    plain = float(np.sqrt(gap.variance(solved.model_covariance)[0]))
    own = float(standard_errors(solved, gap.functional, scatter)[0])
    assert least * plain < own < most * plain
    without = float(standard_errors(solved, Functional(gap.slope), scatter)[0])
    assert without != pytest.approx(own, rel=1e-6)
