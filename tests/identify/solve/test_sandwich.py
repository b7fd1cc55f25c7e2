"""Standard errors from blocks: equal to the model's where it is right, larger where it is not."""

from dataclasses import replace

import numpy as np
import pytest

from tests.identify.quick import quick_rig
from tests.identify.summaries import looked
from vttig_jax.identify.model.forward_model import pair_relation
from vttig_jax.identify.noise.noise_model import NoiseModel, whiten
from vttig_jax.identify.solve.least_squares import solve
from vttig_jax.identify.solve.sandwich import widened
from vttig_jax.identify.solve.solved_fit import SolvedFit
from vttig_jax.rig.imperfections import Noise


@pytest.fixture(scope="module")
def linear():
    """Noise that is correlated over a quarter of a second, four times a row of the fit."""
    rig = quick_rig(0, reversal_deg=3600.0)
    rig = replace(rig, orders=(), noise=Noise(0.004, 0.02))
    return rig.pair, *looked(rig.log(0), rig.pair)


def _widening(linear, *, white: bool) -> np.ndarray:
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
    return widened(SolvedFit(seen, seen.summary, noise, whitened, solution))


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
