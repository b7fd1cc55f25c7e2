"""What every kind of noise promises about its flank summaries."""

from typing import get_args

import numpy as np
import pytest

from tests.identify.summaries import irregular_flank, lagged_flank
from vttig_jax.base.numerics.partial_autocorrelation import filter_of
from vttig_jax.identify.compress.flank_summary import FlankSummary
from vttig_jax.identify.compress.noise_kinds import NOISE
from vttig_jax.identify.settings import NoiseKind

pytestmark = pytest.mark.smoke

_GENERATOR = np.random.default_rng(0)
RUNS = [_GENERATOR.standard_normal((count, 4)) for count in (60, 45)]
TIMES = [np.cumsum(_GENERATOR.exponential(0.01, len(rows))) for rows in RUNS]
CASES = {
    "lagged": (lagged_flank(RUNS, 3), [0.6, -0.3, 0.2]),
    "white": (lagged_flank(RUNS, 0), []),
    "irregular": (irregular_flank(RUNS, TIMES, 0.01), [0.7]),
    "irregular and white": (irregular_flank(RUNS, TIMES, 0.01), []),
}


def test_every_kind_in_the_settings_has_its_treatment():
    assert set(NOISE) == set(get_args(NoiseKind))
    assert len({kind.name for kind in NOISE.values()}) == len(NOISE)


@pytest.mark.parametrize("case", CASES)
def test_the_weighted_products_are_the_quadratic_form(case: str):
    flank, values = CASES[case]
    partial = np.array(values, float)
    found = np.tensordot(flank.product_weights(partial), flank.weighted_products(len(partial)), 1)
    inner = flank.inner(filter_of(partial))
    np.testing.assert_allclose((found + found.T) / 2, inner.T @ inner, atol=1e-9)
    terms = flank.determinant_terms(len(partial))
    determinant = float(flank.determinant_of(terms, partial))
    assert determinant == pytest.approx(flank.log_determinant(partial), abs=1e-12)


def test_a_summary_without_a_kind_cannot_be_made():
    with pytest.raises(TypeError, match="abstract"):
        FlankSummary("A", np.eye(1), np.ones((1, 1, 1)), np.ones((1, 0, 1)), np.ones((1, 0, 1)), 1)  # pyright: ignore
