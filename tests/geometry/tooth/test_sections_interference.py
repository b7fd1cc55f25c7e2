"""Where the mate's tip begins to use the flank, and whether the fillet is in its way."""

import math
from typing import get_args

import numpy as np
import pytest

from vttig_jax import Gear, GearPair
from vttig_jax.geometry.form import fillet_interference, form_radius
from vttig_jax.geometry.tooth import SIDES, Shaft, tooth_of
from vttig_jax.pair.gear_pair import Rack

pytestmark = pytest.mark.smoke


def pair(teeth, **changes):
    first, second = (Gear(z, 3.0, 2.0, 20.0) for z in teeth)
    return GearPair(
        first, second, **({"module_mm": 2.0, "pressure_angles_deg": (20.0, 22.0)} | changes)
    )


@pytest.mark.parametrize("distance", [125.0, 125.12])
def test_start_of_active_profile(distance):
    """tan α = tan α_w − (z_mate/z)(tan α_a − tan α_w), α_a at the tip of the mate."""
    found = fillet_interference(pair((45, 80), centre_distance_mm=distance))
    for gear, (own, mate) in enumerate(((45, 80), (80, 45))):
        for flank, alpha in enumerate(np.radians([20.0, 22.0])):
            working = math.acos((own + mate) * math.cos(alpha) / distance)
            tip = math.acos(mate * math.cos(alpha) / (mate + 2.0))
            tangent = math.tan(working) - mate / own * (math.tan(tip) - math.tan(working))
            radius = own * math.cos(alpha) * math.hypot(1.0, tangent)
            assert found.active_radius_mm[gear, flank] == pytest.approx(radius, rel=1e-12)


def test_form_radii_follow_the_flanks_of_each_gear():
    """Flank A is the left one of the driving gear, the right one of the driven gear's drawing."""
    both = pair((45, 80))
    found = fillet_interference(both)
    sides = (SIDES, SIDES[::-1])
    for gear, shaft in enumerate(get_args(Shaft)):
        for flank in range(2):
            wanted = form_radius(tooth_of(both, shaft), sides[gear][flank])
            assert found.form_radius_mm[gear, flank] == wanted
    assert np.all(found.form_radius_mm[:, 0] != found.form_radius_mm[:, 1])


def test_standard_gears_are_free():
    found = fillet_interference(pair((45, 80)))
    assert not found.interferes.any()
    assert np.all(found.form_radius_mm < found.active_radius_mm)


def test_closer_axes_and_rounder_cutters_interfere():
    tight = pair((20, 80), centre_distance_mm=99.6)
    found = fillet_interference(tight)
    np.testing.assert_array_equal(found.interferes, found.form_radius_mm > found.active_radius_mm)
    assert found.interferes[0].all()
    round_ = pair((45, 80), rack=Rack(tip_radius=0.6, clearance=0.25))
    assert fillet_interference(round_).interferes.any()


def test_an_undercut_pinion_meets_the_tip_of_a_large_mate():
    found = fillet_interference(pair((10, 80)))
    assert found.interferes[0].all()
    assert np.isnan(found.active_radius_mm[0]).all()  # beyond the base circle
    assert "the mate's tip meets the fillet" in str(found)


def test_table_reads_well():
    lines = str(fillet_interference(pair((45, 80)))).splitlines()
    assert lines[0].split() == [
        *("flank", "form", "radius", "[mm]"),
        *("active", "from", "[mm]", "clear", "by", "[mm]"),
    ]
    assert [line.split()[:2] for line in lines[1:]] == [
        ["driving", "A"],
        ["driving", "B"],
        ["driven", "A"],
        ["driven", "B"],
    ]
    assert all(line.endswith("free") for line in lines[1:])
