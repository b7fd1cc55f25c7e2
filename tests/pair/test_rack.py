"""`[rack]`, profile_shift and crowning_um: each changes what it says, in the module it is in."""

import math
from functools import partial
from typing import Any

import numpy as np
import pytest
from scipy.optimize import bisect

from tests.pair.tables import pair_of_table
from vttig_jax.base.errors import PairError
from vttig_jax.geometry.tooth import tooth_of
from vttig_jax.pair.gear_pair import GearPair, pair_from_spec, spec_of
from vttig_jax.pair.pair_file import parse_pair_spec

pair_of = partial(pair_of_table, both={"face_width_mm": 20.0})
USUAL = 1 - math.sin(math.radians(20))


@pytest.mark.parametrize(
    ("rack", "tips", "roots", "fillet"),
    [
        ({}, [47.0, 82.0], [42.5, 77.5], 0.25),
        ({"addendum": 0.8}, [46.6, 81.6], [42.9, 77.9], 0.25),
        ({"clearance": 0.4}, [47.0, 82.0], [42.2, 77.2], 0.4),
        ({"tip_radius": 0.3}, [47.0, 82.0], [42.5, 77.5], 0.3 * USUAL),
        ({"tip_radius": 0.0}, [47.0, 82.0], [42.5, 77.5], 0.0),
    ],
)
def test_each_key_of_the_rack(rack, tips, roots, fillet):
    pair = pair_of(rack)
    np.testing.assert_allclose(pair.tip_radii, tips, rtol=1e-14)
    np.testing.assert_allclose(pair.root_radii, roots, rtol=1e-14)
    for shaft, tip, root in zip(("driving", "driven"), tips, roots, strict=True):
        tooth = tooth_of(pair, shaft)
        assert tooth.fillet_radius_mm == pytest.approx(2.0 * fillet / USUAL, abs=1e-15)
        assert (tooth.tip_radius, tooth.root_radius) == pytest.approx((tip, root), rel=1e-14)
    assert spec_of(pair).rack.tip_radius == rack.get("tip_radius")


def test_profile_shift_moves_tip_root_and_flank():
    shifts: Any = {"driving": {"profile_shift": 0.3}, "driven": {"profile_shift": -0.1}}
    pair = pair_of(**shifts, centre_distance_mm=125.4)
    np.testing.assert_allclose(pair.tip_radii, [47.6, 81.8], rtol=1e-14)
    np.testing.assert_allclose(pair.root_radii, [43.1, 77.3], rtol=1e-14)
    plain = pair_of(centre_distance_mm=125.4)
    grown = [tooth_of(p, "driving").thickness(np.array([45.0]), np.zeros(1)) for p in (plain, pair)]
    assert grown[1] - grown[0] == pytest.approx(2 * 0.3 * 2.0 * math.tan(math.radians(20)))
    assert pair.drawing_backlash < plain.drawing_backlash


def test_crowning_thins_both_ends():
    pair = pair_of(driving={"crowning_um": 12.0})
    tooth, mate = tooth_of(pair, "driving"), tooth_of(pair, "driven")
    z = np.array([-10.0, 0.0, 5.0, 10.0])
    np.testing.assert_allclose(tooth.recessions(z)[:, 0], [0.012, 0.0, 0.003, 0.012], atol=1e-15)
    np.testing.assert_array_equal(mate.recessions(z), 0.0)


HELICAL = {"helix_left_deg": 15.0, "helix_right_deg": -15.0}


@pytest.fixture(scope="module")
def normal() -> GearPair:
    """m_n = 2, β = 15° and x = ±0.3, at the centre distance of teeth without play."""
    shifts = ({"profile_shift": x, **HELICAL} for x in (0.3, -0.3))
    options: Any = {"normal_module_mm": 2.0, "centre_distance_mm": 129.409522551}
    driving, driven = shifts
    return pair_of({"tip_radius": 0.3}, driving=driving, driven=driven, **options)


def test_depths_and_shifts_count_in_normal_modules_where_that_is_given(normal):
    """The tip is 1.3 m_n above the reference circle, not 1.3 m_t."""
    reference = 45.0 / math.cos(math.radians(15))
    assert reference == pytest.approx(46.5874, abs=5e-5)
    assert normal.tip_radii[0] == pytest.approx(reference + 2.6, rel=1e-14)
    assert normal.root_radii[0] == pytest.approx(reference + 0.6 - 2.5, rel=1e-14)
    tooth = tooth_of(normal, "driving")
    assert tooth.fillet_radius_mm == pytest.approx(0.6, rel=1e-14)
    assert tooth.profile_shift_mm == pytest.approx(0.6, rel=1e-14)
    thickness = tooth.thickness(np.array([reference]), np.zeros(1))[0]
    # s_n = m_n (π/2 + 2 x tan α_n), with the transverse angle given here
    tangent = math.tan(math.radians(20)) * math.cos(math.radians(15))
    expected = 2.0 * (math.pi / 2 + 0.6 * tangent)
    assert thickness * math.cos(math.radians(15)) == pytest.approx(expected, rel=1e-13)


def test_a_pair_with_a_normal_module_goes_back_to_a_file_of_the_same_gears(normal):
    again = pair_from_spec(spec_of(normal))
    assert isinstance(again, GearPair)

    def sizes(pair: GearPair) -> list[Any]:
        teeth = [tooth_of(pair, shaft) for shaft in ("driving", "driven")]
        numbers = [(tooth.fillet_radius_mm, tooth.profile_shift_mm) for tooth in teeth]
        bent = [tooth.recessions(np.array([-3.0, 4.0])) for tooth in teeth]
        return [pair.tip_radii, pair.root_radii, np.array(numbers), *bent]

    for found, wanted in zip(sizes(again), sizes(normal), strict=True):
        np.testing.assert_allclose(found, wanted, rtol=1e-13)


@pytest.mark.parametrize(
    ("shifts", "expected"), [((0.0, 0.0), 75.0), ((1.0, 0.6), 79.1), ((-0.2, -0.1), 74.06)]
)
def test_the_hint_for_the_centre_distance_knows_profile_shifts(shifts, expected):
    """Against the same equation solved by bisection."""
    alpha = math.radians(20)
    wanted = math.tan(alpha) - alpha + 2 * math.tan(alpha) * sum(shifts) / 50
    working: Any = bisect(lambda angle: math.tan(angle) - angle - wanted, 1e-6, 1.4, xtol=1e-15)
    exact = 75 * math.cos(alpha) / math.cos(working)
    assert exact == pytest.approx(expected, abs=0.2)
    table = {
        "pair": {"module_mm": 3.0, "pressure_angle_deg": 20.0, "centre_distance_mm": 200.0},
        "driving": {"teeth": 17, "profile_shift": shifts[0]},
        "driven": {"teeth": 33, "profile_shift": shifts[1]},
    }
    with pytest.raises(PairError, match=f"need about {exact:.6g} mm"):
        parse_pair_spec(table)
