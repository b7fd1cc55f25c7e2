"""All measures of a gear at once: Table 1, ends and sections, and what is said beside them."""

import math
import re
import subprocess
import sys
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.geometry.shop_gears import known, scaled, shop_gear
from vttig_jax.base.errors import PairError
from vttig_jax.geometry.checks import check_measurable
from vttig_jax.geometry.form import radius_where
from vttig_jax.geometry.measures import (
    Stated,
    compare_stated,
    measure_gear,
    measure_pair,
    measures_text,
    over_balls,
)
from vttig_jax.geometry.tooth import Tooth
from vttig_jax.pair.gear_pair import Gear, GearPair
from vttig_jax.pair.schema import StatedTable


def test_the_usual_ball_stands_above_the_tip_in_every_section():
    for section in (-8.0, 0.0, 4.0, 8.0):
        found = measure_gear(shop_gear(helix=(3.0, 3.0)), section_mm=section)
        assert known(found.over_balls_mm.value_mm) > found.tip_diameter_mm


def test_the_thin_end_is_the_thin_one_whichever_way_the_gear_tapers():
    up, down = (measure_gear(shop_gear(helix=(b, b))) for b in (3.0, -3.0))
    ends = "tooth_thickness_thin_mm", "tooth_thickness_mm", "tooth_thickness_thick_mm"
    thin, here, thick = (known(getattr(up, name)) for name in ends)
    assert [getattr(down, name) for name in ends] == [thin, here, thick]
    assert thin < here < thick
    helical = measure_gear(shop_gear(helix=(15.0, -15.0)))
    thin, thick = helical.tooth_thickness_thin_mm, helical.tooth_thickness_thick_mm
    assert thin == pytest.approx(thick, rel=1e-12)
    crowned = measure_gear(shop_gear(crowning_um=20.0))
    assert crowned.tooth_thickness_thick_mm == pytest.approx(crowned.tooth_thickness_mm - 0.04)


def test_thickness_at_radii_asked_for():
    tooth = shop_gear(helix=(3.0, 3.0))
    found = measure_gear(tooth, radii_mm=(46.0, 43.0, 48.0))
    inside, below, above = found.thickness_at
    ends = tooth.thickness(np.full(3, 46.0), np.array([10.0, 0.0, -10.0]))
    assert (inside.thin_mm, inside.section_mm, inside.thick_mm) == pytest.approx(
        tuple(ends), rel=1e-14
    )
    assert below.section_mm is None and above.section_mm is None
    missing = "no involute at a radius of {} mm: it reaches from 43.3497 to 47.0000"
    assert all(missing.format(r) in note for r, note in zip((43, 48), found.notes, strict=False))


@settings(max_examples=10)
@given(factor=st.floats(0.05, 40.0), ball=st.floats(3.2, 3.8), z=st.floats(-8.0, 8.0))
def test_lengths_scale_with_the_gear_and_angles_do_not(factor, ball, z):
    tooth = shop_gear(helix=(3.0, 2.0), shift=0.1, crowning_um=30.0)
    here = measure_gear(tooth, section_mm=z, ball_mm=ball)
    there = measure_gear(scaled(tooth, factor), section_mm=factor * z, ball_mm=factor * ball)

    def lengths(found):
        balls, span = found.over_balls_mm, found.span_mm
        return np.array(
            [
                found.chordal_thickness_mm,
                found.chordal_height_mm,
                known(span.value_mm),
                known(balls.value_mm),
                *known(balls.contact_z_mm),
            ]
        )

    np.testing.assert_allclose(lengths(there) / factor, lengths(here), rtol=1e-10, atol=1e-6)
    np.testing.assert_allclose(lengths(there)[:4] / factor, lengths(here)[:4], rtol=1e-10)
    np.testing.assert_allclose(there.base_helix_deg, here.base_helix_deg, atol=1e-9)
    assert there.span_mm.teeth == here.span_mm.teeth


@pytest.mark.parametrize(
    ("helix", "gear"),
    [((25.0, -10.0), {}), ((2.0, 14.0), {"normal_pressure_angle_deg": 20.0})],
)
def test_base_helices(helix, gear):
    """tan β_b = tan β cos α_t; from a normal pressure angle also sin β_b = sin β cos α_n."""
    tooth = shop_gear(helix=helix, **gear)
    shrunk = np.asarray(tooth.base_radii) / float(tooth.reference_radius)
    found = np.radians(measure_gear(tooth, section_mm=4.0).base_helix_deg)
    np.testing.assert_allclose(np.tan(found), shrunk * np.tan(np.radians(helix)), rtol=1e-9)
    if gear:
        sines = np.sin(np.radians(helix)) * math.cos(math.radians(20.0))
        np.testing.assert_allclose(np.sin(found), sines, rtol=1e-9)


@settings(max_examples=15)
@given(
    helix=st.tuples(st.floats(-8, 8), st.floats(-8, 8)),
    z=st.floats(-3, 3),
    teeth=st.sampled_from([44, 45]),
    crowning=st.sampled_from([0.0, 30.0]),
)
def test_the_slope_of_the_measure_over_balls_is_its_derivative(helix, z, teeth, crowning):
    tooth = shop_gear(teeth, helix=helix, crowning_um=crowning)
    found = measure_gear(tooth, section_mm=z, ball_mm=3.5)
    step = 1e-4
    ahead, behind = (known(over_balls(tooth, 3.5, z + sign * step).value_mm) for sign in (1, -1))
    assert found.over_balls_mm.per_axial_mm == pytest.approx(
        (ahead - behind) / (2 * step), abs=2e-6
    )


def test_what_is_said_beside_the_numbers():
    outside = "reference circle lies outside of the involute"
    cases: list[tuple[Tooth, dict[str, Any], str]] = [
        (shop_gear(), {"ball_mm": 3.0}, "Balls of 3 mm do not stand above the tip circle"),
        (shop_gear(60, shift=1.2), {}, outside),
        (shop_gear(60, shift=-1.2), {}, outside),
    ]
    for tooth, options, words in cases:
        notes = measure_gear(tooth, **options).notes
        assert sum(words in note for note in notes) == 1
        assert all(note.endswith(".") and "\n" not in note for note in notes)


def test_of_an_ordinary_gear_nothing_has_to_be_said_and_a_section_beyond_the_face_is_refused():
    for tooth in (shop_gear(), shop_gear(30, helix=(15.0, -15.0), width=40.0)):
        assert measure_gear(tooth).notes == []
    with pytest.raises(ValueError, match=r"within the face, ±10 mm, but is 10\.5"):
        measure_gear(shop_gear(), section_mm=10.5)


@pytest.mark.slow
def test_measuring_compiles_nothing():
    """A verb that only measures starts as fast as its imports allow."""
    code = """
import sys, jax
compiled = []
jax.monitoring.register_event_duration_secs_listener(lambda name, *_, **__: compiled.append(name))
from vttig_jax.geometry.measures import measure_gear
from vttig_jax.geometry.tooth import tooth_of
from vttig_jax.rig.paper import paper_pair
for shaft in ("driving", "driven"):
    measure_gear(tooth_of(paper_pair(), shaft), radii_mm=(46.0, 80.0))
print([name for name in compiled if "compile" in name])
jax.numpy.zeros(3) + 1
print(any("compile" in name for name in compiled))
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines() == ["[]", "True"]


@pytest.mark.smoke
def test_chord_of_the_handbook():
    """KHK: m = 10, z = 12, x = +0.3: 17.8256 mm at 13.6657 mm below the tip."""
    tooth = shop_gear(12, module_mm=10.0, shift=0.3)
    found = measure_gear(tooth)
    assert found.chordal_thickness_mm == pytest.approx(17.8256, abs=6e-5)
    assert found.chordal_height_mm == pytest.approx(13.6657, abs=6e-5)


@pytest.mark.smoke
def test_radius_where_ends_at_the_larger_base_circle():
    assert radius_where(np.array([10.0, 10.0]), 0.0) == pytest.approx(10.0, rel=1e-9)
    assert radius_where(np.array([10.0, 10.0]), -1e-6) is None
    assert radius_where(np.array([9.0, 10.0]), 0.01) is None  # 9/10: inv α = 0.0332 there
    assert known(radius_where(np.array([9.0, 10.0]), 0.04)) > 10.0


# What is stated beside what is computed, and when the two may not be compared.


TAPERED = shop_gear(helix=(3.0, 3.0))


INSPECTED = StatedTable(span_mm=27.9, span_teeth=5, over_balls_mm=95.0, ball_diameter_mm=3.5)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"span_teeth": 6, "ball_mm": 3.5}, ["The stated span is over 5 teeth."]),
        ({"span_teeth": 5, "ball_mm": 3.4}, ["over balls is over balls of 3.5 mm."]),
        ({"span_teeth": 5, "ball_mm": 3.5, "section_mm": 2.0}, ["span is that of the middle"] * 2),
    ],
)
def test_what_was_measured_otherwise_is_shown_and_not_compared(options, words):
    beside, notes = compare_stated(INSPECTED, measure_gear(TAPERED, **options))
    assert None in {one.difference for one in beside.values()}
    assert beside["span_mm"].value == 27.9
    assert len(notes) == len(words) and words[0] in notes[0]


def test_what_cannot_be_computed_is_not_compared():
    stated = StatedTable(tooth_thickness_thin_mm=2.0, over_balls_mm=95.0, ball_diameter_mm=1.0)
    found = measure_gear(shop_gear(width=None), ball_mm=1.0)
    beside, _ = compare_stated(stated, found)
    assert [one.difference for one in beside.values()] == [None, None]


def table(gears, stated=None, notes=None):
    nothing = {name: {} for name in gears}
    mesh = measure_pair(GearPair(Gear(45), Gear(80), module_mm=2.0, pressure_angles_deg=20.0))
    empty = {name: [] for name in gears}
    return measures_text(gears, stated or nothing, notes or empty, "Title", mesh)


def cells(text: str, label: str) -> list[str]:
    (line,) = [line for line in text.splitlines() if line.strip().startswith(label)]
    return line.split(label)[1].split()


def test_a_column_a_gear_and_stated_columns_only_where_something_is():
    gears = {"one": measure_gear(TAPERED), "other": measure_gear(shop_gear(80))}
    plain = table(gears)
    assert plain.splitlines()[0] == "Title" and "stated" not in plain and "notes" not in plain
    assert cells(plain, "thickness, thin end") == ["2.0934", "3.1416"]
    stated = {"one": {"tip_diameter_mm": Stated(94.5, 0.5)}, "other": {}}
    beside = table(gears, stated)
    assert cells(beside, "tip diameter") == ["94.0000", "94.5", "+0.5000", "164.0000"]
    unlike = table(gears, {"one": {"span_mm": Stated(27.9, None)}, "other": {}})
    assert cells(unlike, "span")[1:3] == ["27.9", "–"]


def test_flanks_of_a_gear_have_rows_of_their_own_and_a_hand():
    helical, tapered = measure_gear(shop_gear(helix=(15.0, -15.0))), measure_gear(TAPERED)
    text = table({"a": helical, "b": tapered, "c": measure_gear(shop_gear())})
    left = cells(text, "base helix and hand, left flank [°]")
    right = cells(text, "base helix and hand, right flank [°]")
    assert (left[1], left[3], left[4]) == ("L", "L", "0.0000")
    assert (right[1], right[3], right[4]) == ("L", "R", "0.0000")
    one = measure_gear(shop_gear(helix=(2.0, 14.0), normal_pressure_angle_deg=20.0))
    text = table({"one": one})
    left, right = (cells(text, f"base diameter, {side} flank") for side in ("left", "right"))
    assert float(left[0]) > float(right[0])
    assert cells(text, "teeth spanned") == ["–"]
    assert "span, a computed figure" in table({"one": tapered})
    assert "computed" not in table({"one": measure_gear(shop_gear())})


def test_notes_of_all_gears_stand_once():
    gears = {"one": measure_gear(TAPERED), "other": measure_gear(TAPERED)}
    text = table(gears, notes={"one": ["Both.", "Mine."], "other": ["Both."]})
    assert text.splitlines()[-3:] == ["notes:", "  Both.", "  one: Mine."]


# Teeth that cannot be measured: one sentence that says where, and the cure.


def test_pointed_teeth_say_where_their_flanks_meet():
    """At the other end, by the profile shift, by the addendum."""
    for tooth, place, cure in (
        (shop_gear(helix=(-3.0, -3.0), width=30.0), "z = -15 mm", "the face narrower"),
        (shop_gear(12, shift=0.9), "z = ", "the profile shift lower"),
        (shop_gear(rack={"addendum": 1.8}), "z = ", "shift lower or the addendum lower"),
    ):
        with pytest.raises(PairError) as caught:
            check_measurable(tooth)
        message = caught.value.message
        assert f"pointed at {place}" in message and cure in message
        assert caught.value.where == "tip circle"
        z, met, tip = (float(n) for n in re.findall(r"(?:z = |of )(-?[\d.]+) mm", message))
        assert tip == 2 * float(tooth.tip_radius)
        radius, height = np.array([met / 2 - 0.001, met / 2 + 0.001]), np.full(2, z)
        inside, outside = tooth.thickness(radius, height)
        assert inside > 0 > outside


def test_teeth_that_are_none():
    """No space is left, no tip, nothing but fillet."""
    wide = {"addendum": 0.3, "clearance": 1.2, "tip_radius": 0.0}
    round_ = {"addendum": 0.05, "clearance": 0.25, "tip_radius": 2.0}
    for tooth, words in (
        (
            shop_gear(helix=(3.0, 3.0), width=40.0, rack=wide),
            "leave no space between them at z = -20 mm",
        ),
        (shop_gear(20, shift=-2.5, centre_distance_mm=120.0), "inside the base circle"),
        (shop_gear(30, rack=round_), "leaves no flank below the tip circle"),
    ):
        with pytest.raises(PairError) as caught:
            check_measurable(tooth, 0.0)
        assert words in caught.value.message and "\n" not in caught.value.message
        assert caught.value.exit_code == 3


def test_without_face_width_the_section_alone_is_looked_at():
    tooth = shop_gear(helix=(3.0, 3.0), width=None)
    with pytest.raises(PairError, match="pointed at z = 15 mm"):
        check_measurable(tooth, 15.0)
