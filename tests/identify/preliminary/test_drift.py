"""The power of time that is chosen, on rows with and without drift."""

import numpy as np
import pytest
from scipy.signal import lfilter

from tests.identify.summaries import columns, lag_products_of, own_of_powers, summary_of
from vttig_jax.identify.compress.harmonic_summary import HarmonicSummary
from vttig_jax.identify.noise.noise_model import autoregression
from vttig_jax.identify.preliminary.model_selection import choose_drift, drift_names
from vttig_jax.identify.preliminary.nuisance import NuisanceRegression, own_terms

pytestmark = pytest.mark.smoke


def _summary(slope: float, bend: float, seed: int) -> HarmonicSummary:
    flanks = {}
    for flank, side in (("A", 0), ("B", 1)):
        x = columns(800, 2)
        noise = np.random.default_rng(2 * seed + side).standard_normal(800)
        noise = np.asarray(lfilter([0.01], [1.0, -0.6], noise))
        y = x @ np.array([0.3, -0.2, 1.0 + side, slope, bend, 0.5, -0.4, 0.1, 0.7]) + noise
        flanks[flank] = [np.column_stack([x, y])]
    return summary_of(flanks, drift_order=2)


def _own(summary: HarmonicSummary) -> NuisanceRegression:
    return own_terms(summary, autoregression(summary))


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize(("slope", "bend", "order"), [(0, 0, 0), (0.05, 0, 1), (0.02, 0.05, 2)])
def test_the_drift_that_is_there_is_chosen(slope, bend, order, seed):
    assert choose_drift(_own(_summary(slope, bend, seed))) == order


def test_a_drift_far_below_the_noise_is_left_alone():
    assert choose_drift(_own(_summary(1e-5, 1e-5, 0))) == 0


def test_rounding_is_no_drift():
    """Without noise BIC would take any power that mends the last digit."""
    x = columns(800, 2)
    y = x @ np.array([0.3, -0.2, 1.0, 0.0, 0.0, 0.5, -0.4, 0.1, 0.7])
    own = _own(summary_of({"A": [np.column_stack([x, y])]}, drift_order=2))
    assert own.is_exact
    assert choose_drift(own) == 0


def test_names_of_the_powers_up_to_an_order():
    names = ("drift_1_of_1", "drift_2_of_1", "delay", "drift_1_of_2", "drift_2_of_2")
    assert drift_names(names, 1) == ["drift_1_of_1", "drift_1_of_2"]
    assert drift_names(names, 2) == [n for n in names if n != "delay"]
    assert drift_names(names, 0) == []


@pytest.mark.parametrize("order", [0, 1, 2])
def test_a_summary_without_the_columns_of_higher_powers(order):
    whole = _summary(0.05, 0.01, 0)
    reduced = whole.without([f"drift_{power}" for power in range(order + 1, 3)])
    assert reduced.columns.own == (own_of_powers(order),)
    assert reduced.columns.width == whole.columns.width - (2 - order)
    keep = [0, 1, *range(2, 3 + order), *range(5, 10)]
    for before, after in zip(whole.flanks, reduced.flanks, strict=True):
        expected = lag_products_of(before)[:, keep][:, :, keep]
        np.testing.assert_allclose(lag_products_of(after), expected, rtol=1e-11, atol=1e-11)
        for part in ("heads", "tails"):
            own, other = (getattr(f, part) @ f.triangle for f in (before, after))
            np.testing.assert_allclose(other, own[:, :, keep], atol=1e-12)
    same = whole.keeping(reduced.columns.own)
    np.testing.assert_array_equal(same.flanks[0].lag_products, reduced.flanks[0].lag_products)
