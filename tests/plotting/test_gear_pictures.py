"""Pictures of a tooth, of deviations, and of gears in mesh: touches lie on both, none cross."""

import math

import numpy as np
import pytest
from matplotlib.colors import to_rgba

from tests.geometry.surface_teeth import crowned, tooth
from tests.plotting.axes import legend_texts
from vttig_jax.base import PairError
from vttig_jax.geometry import (
    Deviations,
    FlankMap,
    Misalignment,
    contact_at,
    contact_model,
    section_report,
)
from vttig_jax.pair import Eccentricities
from vttig_jax.plotting import plot_contact, plot_deviations, plot_tooth
from vttig_jax.plotting.style import COLOURS, FLANK_COLOURS


def thick_lines(ax):
    return [line for line in ax.get_lines() if line.get_linewidth() == 1.8]


def test_three_sections_from_thin_to_thick_in_their_colours(tmp_path):
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
    gear = tooth()
    for ax in plot_tooth(gear).axes[:3]:
        by_colour = {}
        for line in thick_lines(ax):
            radius = np.hypot(*np.asarray(line.get_data(), float))
            by_colour.setdefault(to_rgba(line.get_color()), []).append(radius)
        assert len(by_colour) == 4
        tips = [r for radii in by_colour.values() for r in radii if np.allclose(r, 47.0)]
        assert len(tips) == 2


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


ANGLES = np.array([0.3, 0.33, 0.36, 0.39, 0.42, 0.5])
RIG = Eccentricities(0.3, 20.0, 0.25, 200.0, axial_mm=-1.0)
"""Eccentricities that a picture shows."""


@pytest.fixture(scope="module")
def contacts(paper_pair):
    """Of both flanks, axes 0.48 mm farther apart than drawn."""
    model = contact_model(paper_pair, RIG, centre_distance_mm=125.6, sections=9)
    return {flank: contact_at(model, ANGLES, flank) for flank in ("A", "B")}


def coloured(ax, colour):
    lines = [line for line in ax.get_lines() if to_rgba(line.get_color()) == to_rgba(colour)]
    return [np.asarray(line.get_xydata()) for line in lines]


def outlines(ax, number):
    return coloured(ax, COLOURS[6 + number])


def nearest(points, curves):
    """Distances of points from polygons."""
    start = np.concatenate([curve[:-1] for curve in curves])
    along = np.concatenate([np.diff(curve, axis=0) for curve in curves])
    away = points[:, None] - start
    share = (away * along).sum(-1) / np.maximum((along**2).sum(-1), 1e-30)
    foot = np.clip(share, 0, 1)[..., None] * along
    return np.linalg.norm(away - foot, axis=-1).min(axis=1)


@pytest.mark.parametrize("flank", ["A", "B"])
def test_touches_lie_on_both_gears(contacts, flank):
    """To a tenth of a µm or so of the polygons, on eccentric bodies and shifted axes."""
    for place in (0, 3):
        ax = plot_contact(contacts[flank], place=place).axes[0]
        dots = np.concatenate(coloured(ax, FLANK_COLOURS[flank]))
        assert 1 <= len(dots) <= contacts[flank].pairs_in_contact[place]
        for number in (0, 1):
            assert nearest(dots, outlines(ax, number)).max() < 2e-3
            assert nearest(dots + 0.01, outlines(ax, number)).max() > 3e-3
        first = contacts[flank].radius_mm[place, 0]
        centre = 0.3 * np.exp(1j * (ANGLES[place] + math.radians(20.0)))
        far = np.abs(dots[:, 0] + 1j * dots[:, 1] - centre)
        assert np.abs(far - first).min() < 1e-9


def test_the_other_flank_has_its_gap(contacts):
    """What is left between the gears beside flank A is their backlash, in the picture too."""
    ax = plot_contact(contacts["A"]).axes[0]
    low, high = ax.get_xlim()
    driving, driven = (
        [curve for curve in outlines(ax, number) if (np.abs(curve[:, 1]) < 2.5).any()]
        for number in (0, 1)
    )
    x, y = (points := np.concatenate(driving)).T
    gaps = nearest(points[(x > low + 3.2) & (x < high - 3.2) & (np.abs(y) < 4.0)], driven)
    assert gaps.min() < 1e-3
    backlash = contacts["B"].transmission_error[0] - contacts["A"].transmission_error[0]
    wide = backlash * 80.0 * math.cos(math.radians(20.0))
    assert wide > 0.1 and gaps.max() > 0.9 * wide


def test_lines_on_the_flank_dots_and_the_words(contacts, paper_pair, tmp_path):
    ax = plot_contact(contacts["A"], place=1).axes[1]
    assert ax.get_title(loc="left") == "4 angles within a pitch, light to dark"
    drawn = [line for line in ax.get_lines() if len(np.asarray(line.get_xdata())) > 2]
    assert len(drawn) == sum(len(contacts["A"].contact_lines(row)) for row in range(1, 5))
    radius = np.concatenate([np.asarray(line.get_ydata()) for line in drawn])
    assert radius.min() > 42.2 and radius.max() < 47.0 + 1e-9
    figure = plot_contact(contacts["B"], paper_pair)
    assert figure.get_suptitle() == f"contact · VTTIG rig · flank B at {math.degrees(0.3):g}°"
    assert plot_contact(contacts["B"]).get_suptitle().startswith("contact · gear pair · ")
    left, right = figure.axes
    assert left.get_xlabel() == "x, from axis to axis [mm]"
    assert right.get_ylabel() == "radius on the driving gear [mm]"
    assert {word.get_text() for word in right.texts} == {"tip", "base"}
    figure.savefig(tmp_path / "contact.png", dpi=50)
    model = contact_model(paper_pair, misalignment=Misalignment(0.0, 3e-4), sections=9)
    ax = plot_contact(contact_at(model, ANGLES, "A")).axes[1]
    assert "." in [line.get_marker() for line in ax.get_lines()]
    model = contact_model(paper_pair, Eccentricities(axial_mm=21.0), sections=9)
    with pytest.raises(ValueError, match="an angle with contact, but 2 has none"):
        plot_contact(contact_at(model, ANGLES, "A"), place=2)
