"""Chord, base helices, and the radius where two involutes meet."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.geometry.shop_gears import known, scaled, shop_gear
from vttig_jax.geometry.form import radius_where
from vttig_jax.geometry.measures import (
    base_half_angles,
    base_helix_angles,
    measure_gear,
    recession_slopes,
)

pytestmark = pytest.mark.smoke

ONE = np.array([0.0])


def test_chord_of_the_handbook():
    """KHK: m = 10, z = 12, x = +0.3: 17.8256 mm at 13.6657 mm below the tip."""
    tooth = shop_gear(12, module_mm=10.0, shift=0.3)
    found = measure_gear(tooth)
    assert found.chordal_thickness_mm == pytest.approx(17.8256, abs=6e-5)
    assert found.chordal_height_mm == pytest.approx(13.6657, abs=6e-5)


def test_base_helices_of_helical_taper():
    tooth = shop_gear(helix=(25.0, -10.0))
    found = base_helix_angles(tooth, np.array([-5.0, 0.0, 7.0]))
    expected = np.arctan(np.cos(np.radians(20)) * np.tan(np.radians([25.0, -10.0])))
    np.testing.assert_allclose(found, np.broadcast_to(expected, (3, 2)), rtol=1e-11)


def test_the_normal_pressure_angle_makes_two_base_helices():
    """sin β_b = sin β cos α_n, whatever the flank."""
    tooth = shop_gear(helix=(2.0, 14.0), normal_pressure_angle_deg=20.0)
    expected = np.sin(np.radians([2.0, 14.0])) * math.cos(math.radians(20))
    np.testing.assert_allclose(np.sin(base_helix_angles(tooth, ONE)[0]), expected, rtol=1e-10)


def test_slopes_of_crowned_flanks():
    tooth = shop_gear(helix=(3.0, 1.0), crowning_um=40.0)
    z = np.array([-10.0, 0.0, 4.0])
    expected = np.tan(np.radians([3.0, 1.0])) + (8 * 0.04 * z / 20.0**2)[:, None]
    np.testing.assert_allclose(recession_slopes(tooth, z), expected, atol=1e-12)


@given(factor=st.floats(0.01, 100.0), z=st.floats(-9.0, 9.0))
def test_lengths_scale_with_the_gear_and_angles_do_not(factor, z):
    tooth = shop_gear(helix=(3.0, 2.0), shift=0.05, crowning_um=30.0)
    large = scaled(tooth, factor)
    there, here = measure_gear(large, section_mm=factor * z), measure_gear(tooth, section_mm=z)
    for length in ("chordal_thickness_mm", "chordal_height_mm"):
        assert getattr(there, length) == pytest.approx(factor * getattr(here, length), rel=1e-10)
    np.testing.assert_allclose(there.base_helix_deg, here.base_helix_deg, atol=1e-9)


def test_half_angles_at_the_base_circle_are_their_limit():
    tooth = shop_gear(helix=(3.0, 3.0), shift=0.2)
    just_above = np.array([float(tooth.base_radii[0]) * (1 + 1e-12)])
    limit = tooth.half_angles(just_above, np.array([4.0]))
    np.testing.assert_allclose(base_half_angles(tooth, np.array([4.0])), limit, atol=1e-12)


@given(left=st.floats(5.0, 50.0), right=st.floats(5.0, 50.0), angle=st.floats(1e-3, 1.3))
def test_radius_where_undoes_the_involute_function(left, right, angle):
    radius = max(left, right) / math.cos(angle)
    angles = [math.acos(base / radius) for base in (left, right)]
    total = sum(math.tan(a) - a for a in angles)
    assert radius_where(np.array([left, right]), total) == pytest.approx(radius, rel=1e-9)


def test_radius_where_ends_at_the_larger_base_circle():
    assert radius_where(np.array([10.0, 10.0]), 0.0) == pytest.approx(10.0, rel=1e-9)
    assert radius_where(np.array([10.0, 10.0]), -1e-6) is None
    assert radius_where(np.array([9.0, 10.0]), 0.01) is None  # 9/10: inv α = 0.0332 there
    assert known(radius_where(np.array([9.0, 10.0]), 0.04)) > 10.0
