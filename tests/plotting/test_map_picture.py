from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.text import Text

from tests.plotting.axes import data, legend_texts
from vttig_jax.base import NoAnswerError
from vttig_jax.kinematics import BacklashMap, closed_model, exact_model
from vttig_jax.kinematics.hunting_coverage import HuntingCoverage
from vttig_jax.pair import Drive, Gear, GearPair
from vttig_jax.plotting import plot_map
from vttig_jax.plotting.curves import MOST_POINTS


@pytest.fixture
def grid(paper_pair, paper_rig) -> BacklashMap:
    model = exact_model(paper_pair, paper_rig)
    return BacklashMap(model, closed_model(paper_pair, paper_rig), paper_pair)


def test_lines_are_the_map_and_its_extremes_are_marked(grid):
    (ax,) = plot_map(grid).axes
    x, y = data(ax, 0)
    assert x[0] == 0 and x[-1] == pytest.approx(5760) and len(x) <= MOST_POINTS
    np.testing.assert_allclose(y, np.degrees(grid.over(np.radians(x))), atol=1e-12)
    x, y = data(ax, 1)
    np.testing.assert_allclose(y, np.degrees(grid.first_order_over(np.radians(x))), atol=1e-12)
    assert np.abs(data(ax, 0)[1] - data(ax, 1)[1]).max() > 1e-6
    assert len(ax.lines) == 4
    for line, extreme in ((2, grid.smallest), (3, grid.largest)):
        x, y = data(ax, line)
        assert x == pytest.approx(np.degrees(extreme.driving_angle))
        assert y == pytest.approx(np.degrees(extreme.backlash))
    smallest, largest, *lines = legend_texts(ax)
    assert smallest == f"smallest: {grid.smallest}" and "teeth" in smallest
    assert largest == f"largest: {grid.largest}" and lines == ["backlash map", "first order only"]
    (unknown,) = plot_map(replace(grid, unknown="the driven shaft turned too little")).axes
    assert legend_texts(unknown)[0] == "backlash map"
    assert unknown.get_title(loc="left").startswith("backlash of the fitted orders · ")


SPUR = GearPair(Gear(45), Gear(80), module_mm=2.0, pressure_angles_deg=20.0)
TAPER = 2 * np.tan(np.radians(3))


def test_the_right_axis_has_millimetres(grid, paper_rig, make_fit):
    """It is the axial displacement of a tapered pair, and at the reference circle of spur gears."""
    spur = BacklashMap(exact_model(SPUR, paper_rig), None, SPUR)
    for one, words, mm in ((grid, "axial displacement", 80 / TAPER), (spur, "circle", 80)):
        figure = plot_map(one)
        figure.draw_without_rendering()
        (ax,) = figure.axes
        (right,) = ax.child_axes
        assert words in right.get_ylabel()
        assert right.get_ylim() == pytest.approx(np.radians(ax.get_ylim()) * mm)
    (ax,) = plot_map(BacklashMap(make_fit().model, None, Drive(Fraction(9, 16)))).axes
    assert not ax.child_axes and len(ax.lines) == 3 and "teeth" not in legend_texts(ax)[0]


def test_a_long_hunting_period_is_cut_and_says_so(paper_rig):
    pair = GearPair(Gear(45, 3, 3), Gear(83, 3, 3), module_mm=2.0, pressure_angles_deg=20.0)
    grid = BacklashMap(exact_model(pair, paper_rig), None, pair)
    (ax,) = plot_map(grid, turns=16).axes
    assert ax.get_xlim() == (0, 5760) and data(ax, 0)[0].max() == pytest.approx(5760)
    assert "first 16 of the 83 turns" in ax.get_title(loc="left")
    for line, extreme in ((1, grid.smallest), (2, grid.largest)):
        outside = np.degrees(extreme.driving_angle) > 5760
        assert len(data(ax, line)[0]) == (0 if outside else 1)
        assert legend_texts(ax)[line - 1].endswith("not shown") == outside
    (whole,) = plot_map(grid).axes
    assert whole.get_xlim() == (0, 360 * 83) and whole.get_xlabel() == "driving angle [turns]"
    ticks = whole.xaxis.get_major_formatter().format_ticks(whole.get_xticks().tolist())
    assert "80" in ticks and not any("28800" in tick for tick in ticks)
    assert "hunting period of 83 turns" in whole.get_title(loc="left")
    turn = f"turn {float(grid.smallest.driving_angle) / (2 * np.pi):.2f}"
    assert legend_texts(whole)[0].endswith(turn) and "turn" not in legend_texts(ax)[0]


def test_fewer_turns_on_given_axes_and_what_is_refused(grid, worm_fit):
    figure = Figure()
    upper, lower = figure.subplots(2)
    assert plot_map(grid, ax=lower, turns=1) is figure
    assert lower.lines and not upper.lines and lower.get_xlim() == (0, 360)
    assert "first 1 of the 16 turns" in lower.get_title(loc="left")
    assert legend_texts(lower)[0].endswith("not shown")
    with pytest.raises(ValueError, match="`turns` must be at least 1, but is 0"):
        plot_map(grid, turns=0)
    with pytest.raises(NoAnswerError, match="one of its flanks was not measured; record both"):
        plot_map(BacklashMap(worm_fit.model, None, Drive(Fraction(1, 2))))


def test_legend_and_title_cover_nothing(grid):
    figure = plot_map(grid)
    figure.draw_without_rendering()
    (ax,) = figure.axes
    legend = ax.get_legend()
    assert legend is not None
    box = legend.get_window_extent()
    assert box.y0 >= ax.get_window_extent().y1 - 1
    words = ax.get_title(loc="left")
    (title,) = [c for c in ax.get_children() if isinstance(c, Text) and c.get_text() == words]
    assert title.get_window_extent().y0 >= box.y1 - 1


def test_uncovered_angles_are_shaded_and_a_delay_makes_a_band(grid, paper_pair):
    spans = np.radians([[720.0, 1440.0], [3600.0, 5760.0]])
    seen = HuntingCoverage(paper_pair, {"A": spans, "B": spans})
    (ax,) = plot_map(replace(grid, coverage=seen)).axes
    shaded = [patch.get_extents().transformed(ax.transData.inverted()) for patch in ax.patches]
    found = [(box.x0, box.x1) for box in shaded]
    np.testing.assert_allclose(found, [(0.0, 720.0), (1440.0, 3600.0)], atol=5.0)
    assert legend_texts(ax)[-1] == "extrapolated: not covered on both flanks"
    (plain,) = plot_map(grid).axes
    assert len(plain.patches) == 0 and ax.get_ylim() == plain.get_ylim()
    (ax,) = plot_map(replace(grid, shift=(-0.01, 0.02))).axes
    assert "95 %, with the delay left open" in legend_texts(ax)
    assert not any("delay" in text for text in legend_texts(plain))
    (band,) = [one for one in ax.collections if one not in plain.collections]
    low, high = band.get_datalim(ax.transData).intervaly
    assert low == pytest.approx(0.0)  # no gap is negative
    assert high == pytest.approx(np.degrees(grid.largest.backlash + 0.02), abs=1e-4)
