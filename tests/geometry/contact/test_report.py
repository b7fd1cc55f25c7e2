"""What is reported beside the transmission error: teeth, radii, contact lines, misfit, places."""

import math

import numpy as np
import pytest

from tests.geometry.pairs import FLANKS, pair_of
from vttig_jax.geometry.contact import Place, contact_model
from vttig_jax.geometry.contact_report import Contacts, contact_at
from vttig_jax.pair.gear_pair import Eccentricities, Flank, GearPair

PITCH = 2 * math.pi / 45
ANGLES = np.linspace(0.0, PITCH, 64, endpoint=False)
SPUR = (0.0, 0.0)


def looked(
    pair: GearPair, flank: Flank, rig=Eccentricities(), angles: np.ndarray = ANGLES
) -> Contacts:
    return contact_at(contact_model(pair, rig, sections=9), angles, flank)


@pytest.mark.slow
@pytest.mark.parametrize("flank", FLANKS)
def test_pairs_in_contact_are_the_contact_ratio(flank):
    """On a spur gear the transverse one; tapered flanks add their overlap as helical ones do."""
    spur, tapered = pair_of(SPUR), pair_of()
    transverse = float(spur.contact_ratios[0])
    assert looked(spur, flank).pairs_in_contact.mean() == pytest.approx(transverse, abs=0.04)
    overlap = 20.0 * math.tan(math.radians(3.0)) / (2.0 * math.pi)
    found = looked(tapered, flank).pairs_in_contact.mean()
    assert found == pytest.approx(transverse + overlap, abs=0.04)


@pytest.mark.parametrize("flank", FLANKS)
def test_contact_lines_lie_on_the_line_of_action(flank):
    """Of every pair in every section: its distance from both base circles is the string's."""
    pair = pair_of()
    contacts = looked(pair, flank)
    assert contacts.line.all() and (contacts.place == Place.FLANK).all()
    np.testing.assert_allclose(contacts.length_mm, 20.0, rtol=1e-12)
    base, distance = np.asarray(pair.base_radii)[:, 0], 125.12
    strings = np.sqrt(contacts.radius_mm**2 - base**2).sum(axis=1)
    along = math.sqrt(distance**2 - base.sum() ** 2)
    np.testing.assert_allclose(strings, along, rtol=0, atol=1e-6)
    lines = contacts.contact_lines(0)
    assert set(lines) <= {45, 1, 2} and len(lines) == contacts.pairs_in_contact[0]
    for points in lines.values():
        radius = np.sqrt(points[:, 1] ** 2 - base[0] ** 2)
        slope = np.diff(radius[np.argsort(points[:, 0])]) / 2.5
        steep = math.tan(math.radians(3.0)) * math.cos(math.radians(20.0))
        assert np.abs(slope).max() == pytest.approx(steep, rel=1e-5)


def test_flanks_that_differ_along_the_face_leave_a_misfit():
    """Both crowned by 12 µm: the ends stay behind by 24 µm at the reference circles."""
    contacts = looked(pair_of(crowning=(12.0, 12.0)), "A")
    assert not contacts.line.any()
    assert contacts.kind(0) == "point, flank"
    np.testing.assert_allclose(contacts.z_mm, 0.0, atol=0.05)
    ends = contacts.section_misfit[:, [0, 8]]
    np.testing.assert_allclose(ends, 0.024 / 80.0, rtol=1e-9)


def test_teeth_are_counted_as_they_come_into_mesh():
    pair = pair_of()
    angles = np.arange(0.0, 60.0) * PITCH
    for flank, ahead in zip(FLANKS, (0, 1), strict=True):
        contacts = looked(pair, flank, angles=angles)
        teeth = contacts.tooth_pair
        assert set(np.diff(teeth[:, 0]) % 45) == {1} and set(np.diff(teeth[:, 1]) % 80) == {1}
        first = teeth[0]
        assert first[1] - first[0] == ahead  # the space between two driven teeth takes a tooth
        assert teeth[0, 0] == teeth[45, 0] and teeth[0, 1] != teeth[45, 1]


def test_the_common_face_ends_where_the_narrower_face_does():
    contacts = looked(pair_of(SPUR, widths=(20.0, 12.0)), "A", Eccentricities(axial_mm=6.0))
    face = contacts.section_z_mm.min(), contacts.section_z_mm.max()
    assert face == pytest.approx((-10.0, 0.0))


@pytest.mark.slow
def test_faces_that_have_left_each_other_do_not_touch():
    pair = pair_of()
    contacts = looked(pair, "B", Eccentricities(axial_mm=20.5))
    assert np.isnan(contacts.transmission_error).all()
    assert (contacts.place == Place.NOTHING).all()
    assert contacts.kind(3) == "nothing" and contacts.contact_lines(3) == {}
    assert contacts.pairs_in_contact.max() == 0
    model = contact_model(pair, Eccentricities(axial_mm=19.9), sections=9)
    assert np.isfinite(model.transmission_error(0.0, "B"))


def test_crowned_gears_out_of_centre_touch_where_both_are_thickest():
    """c₁(2z/b)² + c₂(2(z + s)/b)² is least at z = −s/2 for equal gears."""
    contacts = looked(pair_of(crowning=(12.0, 12.0)), "A", Eccentricities(axial_mm=3.0))
    np.testing.assert_allclose(contacts.z_mm, -1.5, atol=1e-6)
    least = 2 * 0.012 * (3.0 / 20.0) ** 2
    expected = (3.0 * math.tan(math.radians(3.0)) - least) / 80.0
    np.testing.assert_allclose(contacts.transmission_error, expected, rtol=1e-10)


@pytest.mark.slow
def test_gears_without_face_width_have_one_section():
    contacts = contact_at(contact_model(pair_of(widths=(math.nan, math.nan))), ANGLES, "A")
    assert contacts.misfit.shape == (64, 3, 1)
    assert not contacts.line.any()


def test_the_report_prints_what_it_counts():
    text = str(looked(pair_of(), "A"))
    assert text.splitlines()[0] == "contact, flank A"
    assert "64 of 64" in text and "line, flank" in text


def test_no_angles_are_an_empty_report():
    contacts = looked(pair_of(), "A", angles=np.empty(0))
    assert len(contacts.transmission_error) == 0
    assert str(contacts).splitlines()[1].split() == ["angles", "0"]
