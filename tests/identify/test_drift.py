"""The power of time that is chosen, on rows with and without drift."""

import numpy as np
import pytest
from scipy.signal import lfilter

from tests.identify.summaries import columns, summary_of
from vttig_jax.identify.drift import choose_drift, with_drift


def _summary(slope: float, bend: float, seed: int):
    flanks = {}
    for flank, side in (("A", 0), ("B", 1)):
        x = columns(800, 2)
        noise = np.random.default_rng(2 * seed + side).standard_normal(800)
        noise = np.asarray(lfilter([0.01], [1.0, -0.6], noise))
        y = x @ np.array([0.3, -0.2, 1.0 + side, slope, bend, 0.5, -0.4, 0.1, 0.7]) + noise
        flanks[flank] = [np.column_stack([x, y])]
    return summary_of(flanks, drift_order=2)


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize(("slope", "bend", "order"), [(0, 0, 0), (0.05, 0, 1), (0.02, 0.05, 2)])
def test_the_drift_that_is_there_is_chosen(slope, bend, order, seed):
    assert choose_drift(_summary(slope, bend, seed)) == order


def test_a_drift_far_below_the_noise_is_left_alone():
    assert choose_drift(_summary(1e-5, 1e-5, 0)) == 0


@pytest.mark.parametrize("order", [0, 1, 2])
def test_with_drift_leaves_the_columns_of_higher_powers_out(order):
    whole = _summary(0.05, 0.01, 0)
    reduced = with_drift(whole, order)
    assert reduced.plan.drift_order == order
    assert reduced.plan.width == whole.plan.width - (2 - order)
    keep = [0, 1, *range(2, 3 + order), *range(5, 10)]
    for before, after in zip(whole.flanks, reduced.flanks, strict=True):
        np.testing.assert_array_equal(after.lag_products, before.lag_products[:, keep][:, :, keep])
        np.testing.assert_array_equal(after.heads, before.heads[:, :, keep])
        np.testing.assert_array_equal(after.tails, before.tails[:, :, keep])
