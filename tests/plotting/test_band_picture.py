from dataclasses import replace

import numpy as np
import pytest
from matplotlib.figure import Figure

from tests.plotting.axes import legend_texts
from tests.posterior.made import quick_posterior
from vttig_jax.base.units import DEG, REV
from vttig_jax.pair.gear_pair import Drive
from vttig_jax.plotting.backlash_map import plot_band_map
from vttig_jax.plotting.dispatch import plot
from vttig_jax.posterior.summary.bands import band_map


@pytest.fixture(scope="module")
def banded():
    return band_map(quick_posterior(), step_deg=2.0)


@pytest.fixture(scope="module")
def figure(banded):
    figure = plot(banded)
    figure.draw_without_rendering()
    return figure


def heights(collection) -> np.ndarray:
    """Lower and upper edge of a filled band at each of its angles."""
    (path,) = collection.get_paths()
    points = path.vertices
    angles = np.unique(points[:, 0])
    return np.array([[y.min(), y.max()] for y in (points[points[:, 0] == a, 1] for a in angles)])


def test_both_bands_are_drawn_and_labelled_with_their_probability(figure, banded):
    whole = figure.axes[0]
    *words, smallest = legend_texts(whole)
    assert words == ["95 % band of the whole map", "95 % band at one angle", "mean of the draws"]
    assert smallest.startswith("smallest gap 0.00") and smallest.endswith("% here")
    wide, narrow = (heights(c) for c in whole.collections[:2])
    band = banded.band
    np.testing.assert_allclose(wide[:, 0], band.low_simultaneous / DEG)
    np.testing.assert_allclose(narrow[:, 1], band.high / DEG)


def test_the_second_panel_is_around_the_smallest_gap(figure, banded):
    near = figure.axes[1]
    low, high = near.get_xlim()
    place = banded.smallest.place[0] / DEG
    assert low < place < high and high - low == pytest.approx(90)
    assert near.get_title(loc="left") == "around the smallest gap"


def test_the_right_axis_is_the_axial_displacement_and_a_drive_has_none(figure, banded):
    ax = figure.axes[0]
    (right,) = ax.child_axes
    per_deg = DEG * 80 / (2 * np.tan(3 * DEG))
    assert right.get_ylim() == pytest.approx(np.array(ax.get_ylim()) * per_deg)
    assert right.get_ylabel() == "axial displacement that closes it [mm]"
    drive = Drive(banded.map.pair.ratio, name="drive")
    smallest, grid = (replace(one, pair=drive) for one in (banded.smallest, banded.map))
    alone = replace(banded, map=grid, smallest=smallest)
    assert plot_band_map(alone).axes[0].child_axes == []


def test_title_says_how_much_of_the_period_there_is(banded, figure):
    assert figure.axes[0].get_title(loc="left").endswith("hunting period of 16 turns")
    shown = banded.driving_angle < 2 * REV
    parts = ("centre", "std", "low", "high")
    band = replace(banded.band, **{name: getattr(banded.band, name)[shown] for name in parts})
    cut = {name: getattr(banded, name)[shown] for name in ("driving_angle", "first_order")}
    drawn = plot_band_map(replace(banded, band=band, turns=2.0, **cut))
    assert "2 of the 16 turns" in drawn.axes[0].get_title(loc="left")
    assert legend_texts(drawn.axes[0])[3].endswith("not shown")
    assert drawn.axes[1].get_title(loc="left") == "part of the map"


def test_it_draws_on_given_axes_and_fewer_turns(banded):
    figure = Figure()
    upper, lower = figure.subplots(2)
    assert plot_band_map(banded, ax=lower, turns=3.0) is figure
    assert lower.lines and not upper.lines and lower.get_xlim() == (0, 1080)
    with pytest.raises(ValueError, match="`turns` must be positive"):
        plot_band_map(banded, turns=0.0)


def test_legend_and_title_cover_nothing(figure):
    ax = figure.axes[0]
    box = ax.get_legend().get_window_extent()
    assert box.y0 >= ax.get_window_extent().y1 - 1
    assert ax._left_title.get_window_extent().y0 >= box.y1 - 1
    assert box.x0 > 0
