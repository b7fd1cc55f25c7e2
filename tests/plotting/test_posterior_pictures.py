"""Pictures of a posterior: corner, traces, and the map with its bands."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from matplotlib.figure import Figure

from tests.plotting.axes import legend_texts
from tests.posterior.made import quick_posterior
from vttig_jax.base import ARCSEC, DEG, REV
from vttig_jax.pair import Drive
from vttig_jax.plotting import plot
from vttig_jax.plotting.backlash_map import plot_band_map
from vttig_jax.plotting.posterior_pictures import plot_corner, plot_trace
from vttig_jax.plotting.style import COLOURS
from vttig_jax.posterior import band_map

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


def test_all_physical_coordinates_by_default_do_not_overlap(posterior):
    figure = plot(posterior)
    count = len(posterior.physical)
    assert len(figure.axes) == count * (count + 1) // 2
    assert "innovation" not in "".join(ax.get_xlabel() for ax in figure.axes)
    figure = plot_corner(posterior)
    figure.draw_without_rendering()
    last = figure.axes[-len(posterior.physical) :]
    boxes = [ax.xaxis.label.get_window_extent() for ax in last]
    assert all(one.x1 < other.x0 for one, other in pairwise(boxes))
    tick = last[0].get_xticklabels()
    assert all(label.get_window_extent().y0 >= boxes[0].y1 - 1 for label in tick)


def test_coordinates_that_the_fit_or_nobody_has(posterior):
    figure = plot_corner(posterior, names=("driving_x", "log_innovation_std"))
    first, pair, last = figure.axes
    assert first.lines and not pair.lines and not last.lines and pair.collections
    with pytest.raises(ValueError, match="`names` must hold at least one"):
        plot_corner(posterior, names=())
    with pytest.raises(ValueError, match="must be one of"):
        plot_corner(posterior, names=("nonesuch",))


@pytest.fixture(scope="module")
def traces(posterior):
    return plot_trace(posterior)


def thick(ax) -> list:
    return [line for line in ax.lines if line.get_linewidth() > 1]


def test_every_coordinate_has_a_panel_and_nothing_overlaps(traces, posterior):
    words = [ax.get_title(loc="left") for ax in traces.axes if ax.axison]
    assert len(words) == len(posterior.chains.header.names) + 1
    assert {"log innovation std", "log width driven", "log density"} <= set(words)
    traces.draw_without_rendering()
    shown = [ax for ax in traces.axes if ax.axison]
    boxes = [ax.get_tightbbox() for ax in shown]
    (legend,) = traces.legends
    boxes += [legend.get_window_extent(), traces._suptitle.get_window_extent()]
    for index, box in enumerate(boxes):
        assert all(not box.overlaps(other) for other in boxes[:index])
        assert 0 <= box.xmin < box.xmax <= traces.bbox.xmax
        assert 0 <= box.ymin < box.ymax <= traces.bbox.ymax
    names = [f"ensemble {k}" for k in (1, 2, 3, 4)]
    assert [text.get_text() for text in legend.get_texts()] == names
    top = legend.get_window_extent().y1  # below everything
    assert all(ax.get_tightbbox().y0 >= top - 1 for ax in shown)


def test_each_ensemble_has_its_colour_and_its_mean(traces, posterior):
    chains = posterior.chains
    place = chains.header.names.index("log_innovation_std")
    (ax,) = [ax for ax in traces.axes if ax.get_title(loc="left") == "log innovation std"]
    lines = thick(ax)
    assert [line.get_color() for line in lines] == list(COLOURS[:4])
    for ensemble, line in enumerate(lines):
        expected = chains.draws[ensemble, :, :, place].mean(axis=1)
        np.testing.assert_allclose(line.get_ydata(), expected)
    walkers = [drawn.get_segments() for drawn in ax.collections]
    assert [len(one) for one in walkers] == [12] * 4  # at most twelve of an ensemble
    own = chains.draws[0, :, :, place]
    assert any(np.allclose(walkers[0][0][:, 1], own[:, k]) for k in range(own.shape[1]))


def with_draws(posterior, draws: np.ndarray):
    """The posterior with other stored steps."""
    record = replace(posterior.chains.record, draws=draws, log_density=np.zeros(draws.shape[:3]))
    return replace(posterior, chains=replace(posterior.chains, record=record))


def test_an_ensemble_that_stands_apart_is_seen_and_long_traces_are_thinned(posterior):
    draws = posterior.chains.record.draws.copy()
    draws[2, ..., 0] += 10.0
    names = posterior.chains.header.names[:1]
    ax = plot_trace(with_draws(posterior, draws), names=names).axes[0]
    levels = [np.mean(line.get_ydata()) for line in thick(ax)]
    assert abs(levels[1] - levels[0]) < 1 < levels[2] - levels[0]
    long = with_draws(posterior, np.tile(posterior.chains.record.draws, (1, 100, 1, 1)))
    ax = plot_trace(long, names=("log_innovation_std",)).axes[0]
    steps = long.chains.draws.shape[1]
    assert steps > 2000 and 1000 <= len(thick(ax)[0].get_xdata()) <= steps // 2
    with pytest.raises(ValueError, match="`names`"):
        plot_trace(posterior, names=("nonesuch",))


@pytest.fixture(scope="module")
def banded():
    return band_map(quick_posterior(), step_deg=2.0)


@pytest.fixture(scope="module")
def bands(banded):
    bands = plot(banded)
    bands.draw_without_rendering()
    return bands


def heights(collection) -> np.ndarray:
    """Lower and upper edge of a filled band at each of its angles."""
    (path,) = collection.get_paths()
    points = path.vertices
    angles = np.unique(points[:, 0])
    return np.array([[y.min(), y.max()] for y in (points[points[:, 0] == a, 1] for a in angles)])


def test_both_bands_are_drawn_the_second_time_around_the_smallest_gap(bands, banded):
    whole = bands.axes[0]
    *words, smallest = legend_texts(whole)[:4]
    assert words == ["95 % band of the whole map", "95 % band at one angle", "mean of the draws"]
    assert smallest.startswith("smallest gap 0.00") and smallest.endswith("% here")
    wide, narrow = (heights(c) for c in whole.collections[:2])
    band = banded.band
    np.testing.assert_allclose(wide[:, 0], band.low_simultaneous / DEG)
    np.testing.assert_allclose(narrow[:, 1], band.high / DEG)
    near = bands.axes[1]
    low, high = near.get_xlim()
    place = banded.smallest.place[0] / DEG
    assert low < place < high and high - low == pytest.approx(90)
    assert near.get_title(loc="left") == "around the smallest gap"


def test_the_right_axis_is_the_axial_displacement_and_a_drive_has_none(bands, banded):
    ax = bands.axes[0]
    (right,) = ax.child_axes
    per_deg = DEG * 80 / (2 * np.tan(3 * DEG))
    assert right.get_ylim() == pytest.approx(np.array(ax.get_ylim()) * per_deg)
    drive = Drive(banded.map.pair.ratio, name="drive")
    smallest, grid = (replace(one, pair=drive) for one in (banded.smallest, banded.map))
    alone = replace(banded, map=grid, smallest=smallest)
    assert plot_band_map(alone).axes[0].child_axes == []


def test_title_says_how_much_of_the_period_there_is_also_on_given_axes(banded, bands):
    assert bands.axes[0].get_title(loc="left").endswith("hunting period of 16 turns")
    shown = banded.driving_angle < 2 * REV
    parts = ("centre", "std", "low", "high")
    band = replace(banded.band, **{name: getattr(banded.band, name)[shown] for name in parts})
    cut = {name: getattr(banded, name)[shown] for name in ("driving_angle", "first_order")}
    drawn = plot_band_map(replace(banded, band=band, turns=2.0, **cut))
    assert "2 of the 16 turns" in drawn.axes[0].get_title(loc="left")
    assert legend_texts(drawn.axes[0])[3].endswith("not shown")
    assert drawn.axes[1].get_title(loc="left") == "part of the map"
    bands = Figure()
    upper, lower = bands.subplots(2)
    assert plot_band_map(banded, ax=lower, turns=3.0) is bands
    assert lower.lines and not upper.lines and lower.get_xlim() == (0, 1080)
    with pytest.raises(ValueError, match="`turns` must be positive"):
        plot_band_map(banded, turns=0.0)
