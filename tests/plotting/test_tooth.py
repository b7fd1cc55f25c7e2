import numpy as np
import pytest
from matplotlib.colors import to_rgba

from tests.geometry.surface_teeth import crowned, tooth
from vttig_jax.base.errors import PairError
from vttig_jax.geometry.checks import section_report
from vttig_jax.plotting.tooth import plot_tooth


def thick_lines(ax):
    return [line for line in ax.get_lines() if line.get_linewidth() == 1.8]


def test_three_sections_from_thin_to_thick(tmp_path):
    figure = plot_tooth(tooth(), name="a $ gear")
    *sections, along = figure.axes
    titles = [ax.get_title(loc="left") for ax in sections]
    assert titles == ["thin end, z = 10 mm", "middle, z = 0 mm", "thick end, z = -10 mm"]
    widths = [max(np.ptp(line.get_xdata()) for line in thick_lines(ax)) for ax in sections]
    assert len(set(widths)) > 1
    assert all(len(thick_lines(ax)) == 8 for ax in sections)
    labels = {text.get_text() for text in figure.legends[0].get_texts()}
    assert {"root", "fillet", "flank", "tip", "base circle", "form circle"} <= labels
    assert along.get_xlabel() == "z [mm]"
    figure.savefig(tmp_path / "tooth.png", dpi=50)
    other = plot_tooth(tooth(recession=(crowned(-0.03, 0.0),) * 2))
    assert other.axes[0].get_title(loc="left") == "thin end, z = -10 mm"


def test_a_tooth_that_winds_is_turned_back_upright():
    ends = plot_tooth(tooth(recession=(crowned(0.3, 0.0), crowned(-0.3, 0.0)))).axes[:3]
    titles = [ax.get_title(loc="left") for ax in ends]
    assert titles == ["end, z = 10 mm", "middle, z = 0 mm", "end, z = -10 mm"]
    labels = [ax.get_xlabel() for ax in ends]
    assert labels == ["x [mm], turned by 3.82°", "x [mm]", "x [mm], turned by -3.82°"]
    for ax in ends:
        lines = [np.asarray(line.get_data(), float) for line in thick_lines(ax)]
        x, y = np.concatenate(lines, axis=1)
        top = np.hypot(x, y) > 46.99
        assert x[top].mean() == pytest.approx(0.0, abs=0.05)


def test_the_pieces_have_their_colours_and_radii():
    gear = tooth()
    for ax in plot_tooth(gear).axes[:3]:
        by_colour = {}
        for line in thick_lines(ax):
            radius = np.hypot(*np.asarray(line.get_data(), float))
            by_colour.setdefault(to_rgba(line.get_color()), []).append(radius)
        assert len(by_colour) == 4
        tips = [r for radii in by_colour.values() for r in radii if np.allclose(r, 47.0)]
        assert len(tips) == 2


def test_lines_along_the_face_are_those_of_the_report():
    gear = tooth()
    ax = plot_tooth(gear).axes[3]
    lines = {line.get_label(): line for line in ax.get_lines()}
    report = section_report(gear, np.asarray(lines["root land"].get_xdata(), float))
    np.testing.assert_array_equal(lines["root land"].get_ydata(), report.root_land_mm)
    name = "tooth at the reference circle"
    np.testing.assert_array_equal(lines[name].get_ydata(), report.thickness_mm)
    assert len(ax.collections) == 1  # overlapping fillets
    spur = plot_tooth(tooth(60, fillet_radius_mm=0.1, recession=(crowned(0.0, 0.0),) * 2))
    assert not spur.axes[3].collections
    with pytest.raises(PairError, match="pointed"):
        plot_tooth(tooth(recession=(crowned(0.09, 0.0),) * 2))
