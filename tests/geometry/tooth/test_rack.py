"""The rack cutter: its parts hang together, and its normals are those of its surfaces."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from tests.geometry.surface_teeth import crowned, tooth, wave
from vttig_jax.geometry.tooth.rack_cutter import SIDES, rack_side
from vttig_jax.geometry.tooth.recession import Taper

each_side = pytest.mark.parametrize("side", SIDES)
UPRIGHT = np.array(math.pi / 2)
LINEAR = tooth()
CURVED = tooth(recession=(crowned(0.05, 0.03), wave), profile_shift_mm=0.3)


def test_flanks_are_those_of_the_paper():
    """(1) and (2) as printed: m = 2 mm, h_ap = 2 mm, helix angles 3° and 2°."""
    for d in (0.0, 1.7):
        for z in (-10.0, 4.0):
            left, right = math.radians(20.0), math.radians(22.0)
            reach = math.pi * 2.0 / 4
            ac = (
                d * math.sin(left) + z * math.tan(math.radians(3)) - reach - 2.0 * math.tan(left),
                d * math.cos(left) - 2.0,
                z,
            )
            df = (
                -d * math.sin(right)
                - z * math.tan(math.radians(2))
                + reach
                + 2.0 * math.tan(right),
                d * math.cos(right) - 2.0,
                z,
            )
            for side, wanted in zip(SIDES, (ac, df), strict=True):
                found = rack_side(LINEAR, side).flank(np.array([d]), np.array([z]))[0]
                np.testing.assert_allclose(found, wanted, rtol=1e-15, atol=1e-15)


def test_normal_is_that_of_the_paper():
    """(4), and its mirror image on DF."""
    alpha, slope = np.radians([20.0, 22.0]), np.tan(np.radians([3.0, 2.0]))
    for index, side in enumerate(SIDES):
        rack = rack_side(LINEAR, side)
        found = rack.normal(jnp.asarray(rack.pressure_angle), jnp.asarray(5.0))
        cosine = math.cos(alpha[index])
        wanted = (cosine * (1 - 2 * index), -math.sin(alpha[index]), -cosine * slope[index])
        np.testing.assert_allclose(found, wanted, rtol=1e-14)


@each_side
@pytest.mark.parametrize("part", ["flank", "arc"])
def test_normal_stands_on_the_surface(side, part):
    """(3): derivatives along the part and along l; the mirror turns their cross product round."""
    rack = rack_side(CURVED, side)
    for z in (-7.0, 0.0, 6.0):
        for steep in (float(rack.pressure_angle), 0.8, 1.5):
            if part == "flank":
                steep, along = float(rack.pressure_angle), 1.3
            else:
                along = steep
            point = getattr(rack, part)
            one, two = jax.jacfwd(point, (0, 1))(jnp.asarray(along), jnp.asarray(z))
            normal = rack.normal(jnp.asarray(steep), jnp.asarray(z))
            assert abs(normal @ one) < 1e-14
            assert abs(normal @ two) < 1e-14
            assert abs(normal @ jnp.ones(3)) > 1e-3


@each_side
@pytest.mark.parametrize("gear", [LINEAR, CURVED], ids=["linear", "curved"])
def test_parts_hang_together(gear, side):
    """Flank and arc meet at the same point, the arc ends on the tip line with an upright normal."""
    rack, z = rack_side(gear, side), np.array([-8.0, 0.0, 8.0])
    alpha = rack.pressure_angle
    distance = (rack.flank_start - rack.shift + rack.addendum) / np.cos(alpha)
    start = rack.flank(distance, z)
    np.testing.assert_allclose(rack.arc(alpha, z), start, rtol=0, atol=1e-14)
    lowest = rack.arc(UPRIGHT, z)
    line = rack.tip_line(rack.mirror * lowest[:, 0], z)
    np.testing.assert_allclose(lowest, line, rtol=0, atol=1e-14)
    centre = rack.arc_centre
    off = rack.mirror * start[:, 0] - centre[0] - rack.recedes(z)
    np.testing.assert_allclose(np.hypot(off, start[:, 1] - centre[1]), 0.6, rtol=1e-13)


@pytest.mark.parametrize("shift", [0.0, 0.7])
def test_reference_line_halves_the_pitch(shift):
    """On the profile reference line tooth and space are π m/2 each where nothing recedes."""
    gear = tooth(recession=(Taper(0.0), Taper(0.0)), profile_shift_mm=shift)
    ends = []
    for side in SIDES:
        rack = rack_side(gear, side)
        distance = rack.addendum / np.cos(rack.pressure_angle)
        point = rack.flank(distance, np.zeros(1))[0]
        assert point[1] == pytest.approx(shift, abs=1e-15)
        ends.append(point[0])
    assert ends[1] - ends[0] == pytest.approx(math.pi, rel=1e-15)


def test_root_line_is_where_the_tip_of_the_gear_is():
    point = rack_side(CURVED, "left").root_line(np.zeros(1), np.zeros(1))[0]
    assert point[1] + 45.0 == pytest.approx(float(CURVED.tip_radius), rel=1e-15)


def test_a_side_that_is_none(unchecked):
    with pytest.raises(ValueError, match='must be "left" or "right", but is \'front\''):
        rack_side(LINEAR, "front")  # pyright: ignore[reportArgumentType]
