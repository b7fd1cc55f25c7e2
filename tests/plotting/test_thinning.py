import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vttig_jax.plotting.curves import MOST_POINTS, thinned


@given(size=st.integers(2, 500), most=st.integers(4, 60), seed=st.integers(0, 99))
def test_the_outline_stays(size, most, seed):
    x = np.arange(float(size))
    y = np.random.default_rng(seed).standard_normal(size)
    thin_x, thin_y = thinned(x, y, most)
    assert len(thin_x) <= max(most, 2)
    assert thin_x[0] == 0 and thin_x[-1] == size - 1
    assert np.all(np.diff(thin_x) > 0)
    np.testing.assert_array_equal(thin_y, y[thin_x.astype(int)])
    assert thin_y.min() == y.min() and thin_y.max() == y.max()


def test_short_lines_are_left_alone():
    x = np.arange(float(MOST_POINTS))
    assert thinned(x, x)[0] is x
    assert len(thinned(np.arange(MOST_POINTS + 1.0), np.arange(MOST_POINTS + 1.0))[0]) < MOST_POINTS


def test_every_piece_keeps_its_own_peaks_and_passes_over_holes():
    x, y = np.arange(1000.0), np.zeros(1000)
    y[[105, 505, 905]] = 1.0, -1.0, 2.0
    assert {105.0, 505.0, 905.0} <= set(thinned(x, y, 50)[0])
    y = np.where(x % 2, np.sin(x), np.nan)
    _, thin = thinned(x, y, 100)
    assert np.nanmax(thin) == np.nanmax(y) and np.isfinite(thin).sum() >= 90
    assert np.isnan(thinned(x, np.full(1000, np.nan), 100)[1]).all()


def test_too_few_points_are_refused():
    with pytest.raises(ValueError, match="`most` must be at least 4, but is 3"):
        thinned(np.zeros(9), np.zeros(9), 3)
