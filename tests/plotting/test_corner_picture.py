from itertools import pairwise

import numpy as np
import pytest

from tests.posterior.made import quick_posterior
from vttig_jax.base.units import ARCSEC, DEG
from vttig_jax.plotting.corner_picture import _ellipse, picture_unit, plot_corner
from vttig_jax.plotting.dispatch import plot

NAMES = ("constant_backlash", "driving_x", "driving_encoder_x")


@pytest.fixture(scope="module")
def posterior():
    return quick_posterior()


@pytest.fixture(scope="module")
def figure(posterior):
    return plot_corner(posterior, names=NAMES)


def panels(figure, count: int = 3) -> np.ndarray:
    """Axes by row and column, None above the diagonal."""
    found = np.full((count, count), None)
    for ax in figure.axes:
        place = ax.get_subplotspec()
        found[place.rowspan.start, place.colspan.start] = ax
    return found


def test_there_is_a_panel_for_every_pair_below_the_diagonal(figure):
    for row in range(3):
        for column in range(3):
            ax = panels(figure)[row, column]
            assert (ax is not None) == (column <= row)
            if ax is None:
                continue
            assert bool(ax.collections) == (column < row)
            assert bool(ax.patches) == (column == row)


def test_axes_are_named_with_units_of_people(figure, posterior):
    words = [ax.get_xlabel() for ax in panels(figure)[-1]]
    assert words == ["constant\nbacklash [°]", "driving x [µm]", "driving\nencoder x [″]"]
    assert [ax.get_ylabel() for ax in panels(figure)[1:, 0]] == words[1:]
    assert picture_unit(posterior, "driving_x") == ("µm", 1e-3)
    assert picture_unit(posterior, "constant_backlash") == ("°", DEG)
    assert picture_unit(posterior, "driving_encoder_x") == ("″", ARCSEC)
    assert picture_unit(posterior, "log_innovation_std") == ("", 1.0)


def test_the_ellipse_holds_its_share_of_a_gaussian():
    covariance = np.array([[4.0, 1.5], [1.5, 1.0]])
    draws = np.random.default_rng(0).multivariate_normal([0, 0], covariance, 20_000)
    for level in (0.68, 0.95):
        ring = _ellipse(covariance, level)
        inverse = np.linalg.inv(covariance)
        radius = np.einsum("ij,ik,kj->j", ring, inverse, ring)
        assert radius == pytest.approx(radius[0])
        inside = np.einsum("ni,ij,nj->n", draws, inverse, draws) < radius[0]
        assert inside.mean() == pytest.approx(level, abs=0.01)


def test_the_ellipses_are_those_of_the_fit(figure, posterior):
    fit = posterior.fit
    ax = panels(figure)[2, 1]
    small, large = (np.asarray(line.get_data()) for line in ax.lines)
    place = [fit.covariance_names.index(name) for name in NAMES[1:]]
    size = np.array([1e-3, ARCSEC])
    middle = (large.max(axis=1) + large.min(axis=1)) / 2
    np.testing.assert_allclose(middle, fit.values[place] / size, rtol=1e-3)
    # The half width of the 95 % ellipse is 2.448 standard errors.
    half = (large.max(axis=1) - large.min(axis=1)) / 2
    errors = np.sqrt(np.diag(fit.covariance)[place]) / size
    np.testing.assert_allclose(half, 2.448 * errors, rtol=2e-3)
    assert np.ptp(small[0]) < np.ptp(large[0])


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
    count = len(posterior.physical)
    boxes = [ax.xaxis.label.get_window_extent() for ax in panels(figure, count)[-1]]
    for one, other in pairwise(boxes):
        assert one.x1 < other.x0
    tick = panels(figure, count)[-1, 0].get_xticklabels()
    assert all(label.get_window_extent().y0 >= boxes[0].y1 - 1 for label in tick)


def test_nothing_and_unknown_names_are_refused(posterior):
    with pytest.raises(ValueError, match="`names` must hold at least one"):
        plot_corner(posterior, names=())
    with pytest.raises(ValueError, match="must be one of"):
        plot_corner(posterior, names=("nonesuch",))
