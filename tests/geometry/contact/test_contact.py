"""First touch of unmodified surfaces against the exact relation, which the search does not know."""

import math
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from tests.geometry.pairs import FLANKS, pair_of
from vttig_jax.base.errors import PairError
from vttig_jax.geometry.contact import Place, contact_model
from vttig_jax.geometry.contact_report import Contacts, contact_at
from vttig_jax.geometry.deviations import Deviations
from vttig_jax.geometry.form import form_radius
from vttig_jax.geometry.mounting import Misalignment
from vttig_jax.geometry.tooth import tooth_of
from vttig_jax.kinematics.backlash_map import BacklashMap
from vttig_jax.kinematics.exact import exact_model
from vttig_jax.kinematics.flank_model import FlankModel
from vttig_jax.kinematics.flank_table import tabulate_flanks
from vttig_jax.pair.gear_pair import Eccentricities, Flank, GearPair, Rack

TABLE_2 = (0.0226, 49.5, 0.0273, 79.3)
HUNTING = np.linspace(0.0, 32 * math.pi, 64)
"""Over the hunting period."""

SOME = np.array([0.0, 1.0, 6.1, 33.3, 50.3, 77.7, 100.0, -7.0])


def rig(e=TABLE_2, backlash_deg=0.0, axial=0.0):
    return Eccentricities(e[0], e[1], e[2], e[3], backlash_deg, axial)


def drawn(pair: GearPair, e=TABLE_2, axial=0.0):
    """With the backlash that the drawn teeth have, as the exact relation takes it."""
    return rig(e, math.degrees(float(pair.drawing_backlash)), axial)


def apart(pair, eccentricities, angles=HUNTING, exact=None, **options):
    """Largest difference on both flanks, rad."""
    contact = contact_model(pair, eccentricities, **options)
    relation = exact_model(pair, exact or eccentricities)
    return max(
        np.abs(
            np.asarray(contact.transmission_error(angles, flank))
            - np.asarray(relation.transmission_error(angles, flank))
        ).max()
        for flank in FLANKS
    )


def test_the_rig_of_the_paper_over_its_hunting_period(paper_pair):
    assert contact_model(paper_pair, drawn(paper_pair)).highest_order == 1.0
    later = SOME + paper_pair.hunting_turns * 2 * math.pi
    angles = np.concatenate([HUNTING, later])
    assert apart(paper_pair, drawn(paper_pair, axial=0.3), angles) < 1e-14


SHIFTED = pair_of((0.0, 0.0), teeth=(20, 33), shifts=(0.4, 0.3), distance=54.3)
UNEQUAL = pair_of(helix=(3.0, 2.0), pressure=(20.0, 25.0))
RIGS: dict[str, tuple[GearPair, tuple[float, float, float, float], float]] = {
    "profile-shifted": (SHIFTED, (0.03, 10.0, 0.02, 70.0), 0.0),
    "speeding up": (pair_of(teeth=(80, 45)), (0.2, 10.0, 0.1, 200.0), 0.2),
    "large eccentricities": (pair_of(), (0.2, 49.5, 0.2, 79.3), -0.5),
    "unequal flanks": (UNEQUAL, (0.1, 0.0, 0.05, 90.0), 0.4),
    "untapered": (pair_of(helix=(0.0, 0.0)), TABLE_2, 3.0),
    "no face widths": (pair_of(widths=(math.nan, math.nan)), TABLE_2, 0.3),
    "interfering": (pair_of(distance=125.0), (0.05, 0.0, 0.05, 0.0), 0.3),
    "tapered the other way": (pair_of(helix=(-2.0, -2.0)), TABLE_2, 0.2),
}


def test_other_rigs():
    for name, (pair, e, axial) in RIGS.items():
        assert apart(pair, drawn(pair, e, axial), SOME) < 1e-13, name


@pytest.mark.slow
def test_sections_that_touch_at_once_add_nothing(paper_pair):
    assert apart(paper_pair, drawn(paper_pair, axial=0.3), SOME, sections=9) < 1e-14


def test_the_backlash_is_that_of_the_drawn_teeth(paper_pair):
    """The j_c of a fit changes nothing."""
    fitted = rig(backlash_deg=0.038, axial=0.1)
    assert apart(paper_pair, fitted, SOME, drawn(paper_pair, axial=0.1)) < 1e-14
    assert apart(paper_pair, fitted, SOME) > 1e-4


def test_axes_that_are_not_where_the_drawing_has_them(paper_pair):
    """The zero of φ₂ stays that of the nominal centre distance."""
    moved = pair_of(distance=125.3)
    nominal, now = (p.working_pressure_angles[0] for p in (paper_pair, moved))
    opened = (math.tan(now) - now - math.tan(nominal) + nominal) * float(1 + paper_pair.ratio)
    contact = contact_model(paper_pair, rig(), centre_distance_mm=125.3)
    # Zero of φ₂ where it is with the axes apart: the driven offset stands elsewhere at φ₂ = 0.
    there = exact_model(moved, drawn(moved, (*TABLE_2[:3], TABLE_2[3] - math.degrees(opened))))
    for flank in FLANKS:
        found = np.asarray(contact.transmission_error(SOME, flank)) + opened
        np.testing.assert_allclose(found, there.transmission_error(SOME, flank), atol=1e-13)


@pytest.mark.slow
def test_the_driven_centre_can_be_held():
    """As the harmonics over both angles need it."""
    pair = pair_of()
    eccentric = drawn(pair, (0.2, 49.5, 0.2, 79.3), 0.1)
    contact, relation = contact_model(pair, eccentric), exact_model(pair, eccentric)
    driving, driven = jnp.meshgrid(jnp.linspace(0, 6, 5), jnp.linspace(0, 6, 7), indexing="ij")
    for flank in FLANKS:
        np.testing.assert_allclose(
            contact.at_both_angles(driving, driven, flank),
            relation.at_both_angles(driving, driven, flank),
            rtol=0,
            atol=1e-13,
        )


def test_neighbouring_rigs_are_told_apart(paper_pair):
    cases: list[dict[str, Any]] = [
        {"e": (0.0227, *TABLE_2[1:])},
        {"e": (*TABLE_2[:3], 79.4)},
        {"axial": 0.1001},
        {"backlash_deg": 0.0629},
    ]
    for changed in cases:
        other = drawn(paper_pair, axial=0.1)
        values = {"axial": 0.1, "backlash_deg": float(other.constant_backlash_deg)}
        assert apart(paper_pair, other, SOME, rig(**(values | changed))) > 5e-8


# Contact as any other flank model: maps, TE curves, tables for the simulator, fits.


@pytest.mark.slow
def test_the_backlash_map_of_the_surfaces_is_the_exact_one(paper_pair):
    rig = drawn(paper_pair)
    contact = contact_model(paper_pair, rig)
    assert isinstance(contact, FlankModel)
    found = BacklashMap(contact, None, paper_pair)
    exact = BacklashMap(exact_model(paper_pair, rig), None, paper_pair)
    np.testing.assert_allclose(found.at(SOME), exact.at(SOME), rtol=0, atol=1e-14)
    for one, other in ((found.smallest, exact.smallest), (found.largest, exact.largest)):
        assert one.backlash == pytest.approx(other.backlash, abs=1e-13)
        assert one.tooth_pair == other.tooth_pair
    assert found.safe_closing_mm == pytest.approx(exact.safe_closing_mm, abs=1e-9)


@pytest.mark.slow
def test_the_tooth_mesh_is_in_the_table(paper_pair):
    """A tilted axis: the transmission error has the period of the teeth."""
    model = contact_model(paper_pair, misalignment=Misalignment(0.0, 3e-4), sections=3)
    assert model.highest_order == 45.0
    table = tabulate_flanks(model, 1, per_turn=45 * 16)
    strength = np.abs(np.fft.rfft(table.nodes[:-1, 0]))[1:]
    assert sorted(1 + np.argsort(-strength)[:3]) == [45, 90, 135]
    angles = np.linspace(0.0, 0.3, 33)
    found = np.asarray(table.at(jnp.asarray(angles)).lower)
    error = np.asarray(model.transmission_error(angles, "A"))
    # At its corners one pair of teeth takes over from another.
    assert np.median(np.abs(found - error)) < 0.01 * np.ptp(error)


# What is reported beside the transmission error: teeth, radii, contact lines, misfit, places.


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


# Pairs that cannot be brought into contact, and wrong options: one sentence each.


make = partial(pair_of, distance=None)
LONG: dict[str, Any] = {"rack": Rack(addendum=1.5, clearance=0.1), "helix": (0.0, 0.0)}
UNLIKE = {"deviations": Deviations(driving_pitch_um=np.zeros((2, 80)))}
SHAPES = r"the shape is \(2, 80\); give one value for each flank and tooth, shape \(2, 45\)"
TILTED = {"misalignment": Misalignment(1e-4)}


def test_gears_that_do_not_meet():
    cases: list[tuple[dict[str, Any], dict[str, Any], str]] = [
        ({}, {"centre_distance_mm": 117.0}, "lets the base circles overlap"),
        ({"widths": (math.nan, math.nan)}, TILTED, "give a face width"),
        ({"widths": (36.0, 36.0)}, {}, "pointed at z = 18 mm"),
        ({"widths": (80.0, 80.0)}, {}, "mm thick on the reference circle"),
        (LONG, {"tooth_pairs": 2}, "2 tooth pairs are too few for a contact ratio of"),
        ({}, UNLIKE, SHAPES),
    ]
    for gears, options, sentence in cases:
        with pytest.raises(PairError, match=sentence):
            contact_model(make(**gears), **options)


def test_options_that_are_none(unchecked):
    cases: list[tuple[dict[str, Any], str]] = [
        ({"sections": 0}, "`sections` must be 1 or more, but is 0"),
        ({"tooth_pairs": 0}, "`tooth_pairs` must be 1 or more"),
        ({"points": 2}, "`points` must be 3 or more, but is 2"),
    ]
    for options, sentence in cases:
        with pytest.raises(ValueError, match=sentence):
            contact_model(make(), **options)


def test_a_wrong_flank(unchecked):
    with pytest.raises(ValueError, match='`flank` must be "A" or "B"'):
        contact_model(make()).transmission_error(0.0, "left")  # pyright: ignore


@pytest.mark.slow
def test_long_teeth_are_searched_when_asked():
    model = contact_model(make(**LONG), tooth_pairs=4)
    np.testing.assert_allclose(model.transmission_error(np.linspace(0, 1, 5), "A"), 0, atol=1e-15)


def test_the_flank_of_an_undercut_tooth_begins_at_its_fillet():
    pair = make((0.0, 0.0), teeth=(12, 80))
    model = contact_model(pair, sections=1)
    radius = form_radius(tooth_of(pair, "driving"), "left")
    base = float(pair.base_radii[0, 0])
    np.testing.assert_allclose(model.starts[0], math.sqrt((radius / base) ** 2 - 1), rtol=1e-12)
    traced = jax.jit(lambda x: contact_model(x, sections=1).starts)(pair)
    np.testing.assert_allclose(traced[1], model.starts[1], rtol=1e-12)
    assert traced[0, 0] == 0.0  # on the base circle while nothing is known


def test_sections_are_one_where_all_touch_at_once():
    assert contact_model(make()).search_grid.sections == 1
    assert contact_model(make((0.0, 0.0))).search_grid.sections == 1
    assert contact_model(make(rack=Rack(addendum=0.6))).search_grid.sections == 9  # tips may carry
    assert contact_model(make(), misalignment=Misalignment(1e-5)).search_grid.sections == 9
    assert contact_model(make(), deviations=Deviations()).search_grid.sections == 9
    assert contact_model(make(driven_helix=(3.1, 3.0))).search_grid.sections == 9


def test_half_of_the_numbers_may_be_traced():
    """A pair in which one number is traced and the others are not."""

    def error(distance):
        return contact_model(make(distance=distance), Eccentricities(), sections=1).backlash(0.1)

    assert jax.eval_shape(error, jnp.asarray(125.12)).shape == ()
    assert error(125.12) == contact_model(make(distance=125.12)).backlash(0.1)
