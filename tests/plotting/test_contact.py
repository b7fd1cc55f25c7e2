"""The gears in mesh are drawn where they are: no flank crosses another, and touches lie on both."""

import math

import numpy as np
import pytest
from matplotlib.colors import to_rgba

from vttig_jax.geometry.contact import contact_model
from vttig_jax.geometry.contact_report import contact_at
from vttig_jax.geometry.mounting import Misalignment
from vttig_jax.pair.gear_pair import Eccentricities
from vttig_jax.plotting.contact import plot_contact
from vttig_jax.plotting.style import COLOURS, FLANK_COLOURS

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


def test_lines_on_the_flank(contacts):
    ax = plot_contact(contacts["A"], place=1).axes[1]
    assert ax.get_title(loc="left") == "4 angles within a pitch, light to dark"
    drawn = [line for line in ax.get_lines() if len(np.asarray(line.get_xdata())) > 2]
    assert len(drawn) == sum(len(contacts["A"].contact_lines(row)) for row in range(1, 5))
    radius = np.concatenate([np.asarray(line.get_ydata()) for line in drawn])
    assert radius.min() > 42.2 and radius.max() < 47.0 + 1e-9


def test_the_words(contacts, paper_pair, tmp_path):
    figure = plot_contact(contacts["B"], paper_pair)
    assert figure.get_suptitle() == f"contact · VTTIG rig · flank B at {math.degrees(0.3):g}°"
    assert plot_contact(contacts["B"]).get_suptitle().startswith("contact · gear pair · ")
    left, right = figure.axes
    assert left.get_xlabel() == "x, from axis to axis [mm]"
    assert right.get_ylabel() == "radius on the driving gear [mm]"
    assert {word.get_text() for word in right.texts} == {"tip", "base"}
    figure.savefig(tmp_path / "contact.png", dpi=50)


def test_points_of_tilted_gears_are_dots_and_nothing_that_touches_no_picture(paper_pair):
    model = contact_model(paper_pair, misalignment=Misalignment(0.0, 3e-4), sections=9)
    ax = plot_contact(contact_at(model, ANGLES, "A")).axes[1]
    assert "." in [line.get_marker() for line in ax.get_lines()]
    model = contact_model(paper_pair, Eccentricities(axial_mm=21.0), sections=9)
    with pytest.raises(ValueError, match="an angle with contact, but 2 has none"):
        plot_contact(contact_at(model, ANGLES, "A"), place=2)
