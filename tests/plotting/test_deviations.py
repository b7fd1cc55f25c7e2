import numpy as np
import pytest

from tests.plotting.axes import legend_texts
from vttig_jax.geometry.deviations import Deviations, FlankMap
from vttig_jax.plotting.deviations import plot_deviations

ROLL, HEIGHT = np.linspace(8.0, 20.0, 7), np.linspace(-8.0, 8.0, 5)
DRAWN = np.random.default_rng(0).normal(size=(7, 5))
MAP = FlankMap(ROLL, HEIGHT, DRAWN)


def dots(ax):
    return [line.get_data() for line in ax.get_lines() if line.get_marker() == "."]


def smooth(ax):
    return [line for line in ax.get_lines() if len(line.get_xdata()) > 100]


def test_a_row_for_each_map_with_the_measured_points(tmp_path):
    """Three heights on the left, three roll lengths on the right."""
    figure = plot_deviations(Deviations(driving=(MAP, None), driven=(None, MAP)))
    flanks = "driving flank A", "driven flank B"
    titles = [f"{flank}, {trace}" for flank in flanks for trace in ("profile", "helix")]
    assert [ax.get_title(loc="left") for ax in figure.axes] == titles
    for ax, axis, values in ((figure.axes[0], ROLL, DRAWN.T), (figure.axes[1], HEIGHT, DRAWN)):
        chosen = [0, len(values) // 2, len(values) - 1]
        for (x, y), row in zip(dots(ax), chosen, strict=True):
            np.testing.assert_array_equal(x, axis)
            np.testing.assert_array_equal(y, values[row])
    assert legend_texts(figure.axes[0]) == ["z = -8 mm", "z = 0 mm", "z = 8 mm"]
    figure.savefig(tmp_path / "deviations.png", dpi=50)


def test_lines_are_the_spline_through_the_points():
    figure = plot_deviations(Deviations(driving=(MAP, None)))
    profile, helix = figure.axes
    for ax, fixed in ((profile, HEIGHT[0]), (helix, ROLL[0])):
        x, y = (np.asarray(values) for values in smooth(ax)[0].get_data())
        other = np.full(len(x), fixed)
        places = (x, other) if ax is profile else (other, x)
        np.testing.assert_array_equal(y, MAP.prepared()(*places))
    assert profile.get_shared_y_axes().joined(profile, helix)
    two = FlankMap(ROLL[:2], HEIGHT[:2], DRAWN[:2, :2])
    figure = plot_deviations(Deviations(driven=(two, None)))
    assert [len(smooth(ax)) for ax in figure.axes] == [2, 2]


def test_the_drawing_marks_flank_and_face(paper_pair):
    plain, marked = (
        plot_deviations(Deviations(driving=(MAP, None)), *pair) for pair in ((), (paper_pair,))
    )
    assert marked.get_suptitle() == "deviations of the flanks · VTTIG rig"
    ends = []
    for ax, without in zip(marked.axes, plain.axes, strict=True):
        lines = [line for line in ax.get_lines() if line.get_linestyle() == "--"]
        assert len(ax.get_lines()) == len(without.get_lines()) + 2
        ends.append([float(np.asarray(line.get_xdata())[0]) for line in lines])
    tip = np.sqrt(47.0**2 - (45 * np.cos(np.radians(20.0))) ** 2)
    assert ends[0][1] == pytest.approx(tip) and 7.0 < ends[0][0] < 11.0
    assert ends[1] == [-10.0, 10.0]


def test_every_tooth_has_its_line_and_nothing_no_picture():
    pitches = np.random.default_rng(1).normal(size=(2, 45))
    (ax,) = plot_deviations(Deviations(driving_pitch_um=pitches)).axes
    assert ax.get_title(loc="left") == "driving gear, single teeth"
    for (x, y), values in zip(dots(ax), pitches, strict=True):
        np.testing.assert_array_equal(np.round(np.asarray(x, float)), np.arange(1, 46))
        np.testing.assert_array_equal(y, values)
    with pytest.raises(ValueError, match="`deviations` must hold a map or pitches, but is empty"):
        plot_deviations(Deviations())
