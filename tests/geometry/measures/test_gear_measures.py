"""All measures of a gear at once: Table 1, ends and sections, and what is said beside them."""

import math
import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.geometry.shop_gears import known, scaled, shop_gear
from vttig_jax.geometry.form import radius_where
from vttig_jax.geometry.measures import measure_gear, over_balls


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


def test_an_end_of_a_crowned_gear_is_thinner_than_its_middle():
    found = measure_gear(shop_gear(crowning_um=20.0))
    assert found.tooth_thickness_thick_mm == pytest.approx(found.tooth_thickness_mm - 0.04)


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


NOTES = {
    "not proud": (shop_gear(), {"ball_mm": 3.0}, "Balls of 3 mm do not stand above the tip circle"),
    "shifted out": (shop_gear(60, shift=1.2), {}, "reference circle lies outside of the involute"),
    "shifted in": (shop_gear(60, shift=-1.2), {}, "reference circle lies outside of the involute"),
}


def test_what_is_said_beside_the_numbers():
    for name in NOTES:
        tooth, options, words = NOTES[name]
        notes = measure_gear(tooth, **options).notes
        assert sum(words in note for note in notes) == 1
        assert all(note.endswith(".") and "\n" not in note for note in notes)


@pytest.mark.parametrize("tooth", [shop_gear(), shop_gear(30, helix=(15.0, -15.0), width=40.0)])
def test_of_an_ordinary_gear_nothing_has_to_be_said(tooth):
    assert measure_gear(tooth).notes == []


def test_a_section_beyond_the_face_is_refused():
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
