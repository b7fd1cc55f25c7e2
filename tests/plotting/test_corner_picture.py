from itertools import pairwise

import numpy as np
import pytest

from tests.posterior.made import quick_posterior
from vttig_jax.base.units import ARCSEC
from vttig_jax.plotting.corner_picture import plot_corner
from vttig_jax.plotting.dispatch import plot

NAMES = ("constant_backlash", "driving_x", "driving_encoder_x")


@pytest.fixture(scope="module")
def posterior():
    return quick_posterior()


@pytest.fixture(scope="module")
def figure(posterior):
    return plot_corner(posterior, names=NAMES)


def panels(figure) -> dict:
    """Axes by row and column."""
    places = [ax.get_subplotspec() for ax in figure.axes]
    spans = [(place.rowspan.start, place.colspan.start) for place in places]
    return dict(zip(spans, figure.axes, strict=True))


def test_there_is_a_panel_for_every_pair_below_the_diagonal(figure):
    """Its axes are named with units of people."""
    drawn = panels(figure)
    assert set(drawn) == {(row, column) for row in range(3) for column in range(row + 1)}
    for (row, column), ax in drawn.items():
        assert bool(ax.collections) == (column < row) and bool(ax.patches) == (column == row)
    words = [drawn[2, column].get_xlabel() for column in range(3)]
    assert words == ["constant\nbacklash [°]", "driving x [µm]", "driving\nencoder x [″]"]
    assert [drawn[row, 0].get_ylabel() for row in (1, 2)] == words[1:]


def test_the_ellipses_are_those_of_the_fit(figure, posterior):
    fit = posterior.fit
    ax = panels(figure)[2, 1]
    small, large = (np.asarray(line.get_data()) for line in ax.lines)
    place = [fit.covariance_names.index(name) for name in NAMES[1:]]
    size = np.array([1e-3, ARCSEC])
    middle = (large.max(axis=1) + large.min(axis=1)) / 2
    np.testing.assert_allclose(middle, fit.values[place] / size, rtol=1e-3)
    # The half width is √χ² standard errors: 2.448 for 95 %, 1.510 for 68 % of two coordinates.
    errors = np.sqrt(np.diag(fit.covariance)[place]) / size
    for ring, far in ((large, 2.448), (small, 1.510)):
        np.testing.assert_allclose(np.ptp(ring, axis=1) / 2, far * errors, rtol=2e-3)
    covariance = fit.covariance[np.ix_(place, place)] / np.outer(size, size)
    off = large - middle[:, None]
    radius = np.einsum("ij,ik,kj->j", off, np.linalg.inv(covariance), off)
    np.testing.assert_allclose(radius, 2.448**2, rtol=5e-3)


def test_all_physical_coordinates_by_default_through_plot(posterior):
    figure = plot(posterior)
    count = len(posterior.physical)
    assert len(figure.axes) == count * (count + 1) // 2
    assert "innovation" not in "".join(ax.get_xlabel() for ax in figure.axes)


def test_a_coordinate_the_fit_does_not_have_is_drawn_without_lines(posterior):
    figure = plot_corner(posterior, names=("driving_x", "log_innovation_std"))
    first, pair, last = figure.axes
    assert first.lines and not pair.lines and not last.lines and pair.collections


def test_labels_do_not_overlap(posterior):
    figure = plot_corner(posterior)
    figure.draw_without_rendering()
    last = figure.axes[-len(posterior.physical) :]
    boxes = [ax.xaxis.label.get_window_extent() for ax in last]
    assert all(one.x1 < other.x0 for one, other in pairwise(boxes))
    tick = last[0].get_xticklabels()
    assert all(label.get_window_extent().y0 >= boxes[0].y1 - 1 for label in tick)


def test_nothing_and_unknown_names_are_refused(posterior):
    with pytest.raises(ValueError, match="`names` must hold at least one"):
        plot_corner(posterior, names=())
    with pytest.raises(ValueError, match="must be one of"):
        plot_corner(posterior, names=("nonesuch",))
