"""Derived numbers of gear pairs, and how the objects behave."""

import math
from dataclasses import FrozenInstanceError, replace
from fractions import Fraction
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from tests.pair.tables import pair_of_table
from vttig_jax.base.units import DEG
from vttig_jax.pair.gear_pair import (
    Drive,
    Eccentricities,
    Gear,
    GearPair,
    Rack,
    involute,
    pair_from_spec,
)
from vttig_jax.pair.pair_file import parse_pair_spec


def test_the_papers_rig(paper_pair):
    assert paper_pair.ratio == Fraction(9, 16)
    assert paper_pair.hunting_turns == 16
    np.testing.assert_allclose(paper_pair.reference_radii, [45.0, 80.0], rtol=1e-15)
    base = np.array([45.0, 80.0]) * math.cos(math.radians(20.0))
    np.testing.assert_allclose(paper_pair.base_radii, np.stack([base, base], axis=1), rtol=1e-15)
    np.testing.assert_allclose(paper_pair.working_pressure_angles / DEG, 20.1504, atol=5e-5)
    assert paper_pair.drawing_backlash / DEG == pytest.approx(0.0628, abs=5e-5)
    assert paper_pair.thinning == pytest.approx(2 * math.tan(math.radians(3.0)), rel=1e-15)
    np.testing.assert_allclose(paper_pair.taper, math.tan(math.radians(3.0)), rtol=1e-15)


def test_working_radii_share_the_centre_distance_by_the_ratio(paper_pair):
    first, second = paper_pair.working_radii
    assert first + second == pytest.approx(125.12, rel=1e-15)
    assert first / second == pytest.approx(45 / 80, rel=1e-14)
    # The base circles seen under the working pressure angle.
    np.testing.assert_allclose(
        paper_pair.working_radii * np.cos(paper_pair.working_pressure_angles[0]),
        paper_pair.base_radii[:, 0],
        rtol=1e-14,
    )


def teeth(
    *shifts: float, distance: float | None = 125.6, angles: Any = 20.0, **options
) -> GearPair:
    """The paper's teeth without taper, with profile shifts and options of the pair."""
    gears = (Gear(n, profile_shift=x) for n, x in zip((45, 80), shifts or (0, 0), strict=True))
    pair = {"module_mm": 2.0, "pressure_angles_deg": angles, "centre_distance_mm": distance}
    return GearPair(*gears, **pair, **options)


@pytest.mark.parametrize("shifts", [(0.0, 0.0), (0.3, -0.1)])
def test_drawing_backlash_is_the_gap_of_the_teeth(shifts):
    """At the working circles: pitch less both tooth thicknesses, from the involute of each."""
    alpha, reference = math.radians(20), np.array([45.0, 80.0])
    working, radii = math.acos(125 * math.cos(alpha) / 125.6), 125.6 * reference / 125
    grown = math.tan(alpha) - alpha - (math.tan(working) - working)
    thickness = 2 * (math.pi / 2 + 2 * np.array(shifts) * math.tan(alpha))
    at_working = 2 * radii * (thickness / 2 / reference + grown)
    gap = 2 * math.pi * radii[1] / 80 - at_working.sum()
    assert teeth(*shifts).drawing_backlash == pytest.approx(gap / radii[1], rel=1e-10)


def test_contact_ratio_by_walking_along_the_line_of_action(paper_pair):
    """Points of the common tangent that lie inside both tip circles, counted in base pitches."""
    rb1, rb2 = (125.0 * share * math.cos(math.radians(20)) for share in (0.36, 0.64))
    working = math.acos((rb1 + rb2) / 125.12)
    whole = 125.12 * math.sin(working)
    along = np.linspace(0.0, whole, 2_000_001)
    inside = (np.hypot(rb1, along) <= 47.0) & (np.hypot(rb2, whole - along) <= 82.0)
    length = np.ptp(along[inside])
    pitch = 2 * math.pi * rb1 / 45
    np.testing.assert_allclose(paper_pair.contact_ratios, length / pitch, rtol=1e-5)
    assert paper_pair.contact_ratios[0] == pytest.approx(1.722, abs=5e-4)


def test_flanks_keep_their_own_pressure_angle():
    pair = teeth(distance=None, angles=(20.0, 25.0))
    np.testing.assert_allclose(pair.working_pressure_angles / DEG, [20.0, 25.0], rtol=1e-12)
    assert pair.base_radii[0, 0] > pair.base_radii[0, 1]
    assert pair.contact_ratios[0] > pair.contact_ratios[1]
    stub = teeth(distance=None, angles=(20.0, 25.0), rack=Rack(addendum=0.8))
    assert stub.contact_ratios[0] < pair.contact_ratios[0]


def test_without_centre_distance_the_reference_circles_touch():
    pair = teeth(distance=None)
    assert pair.centre_distance_mm == 125.0
    assert abs(float(pair.drawing_backlash)) < 1e-15


@pytest.mark.parametrize(
    ("teeth", "turns"),
    [((45, 80), 16), ((20, 40), 2), ((30, 30), 1), ((41, 80), 80), ((80, 45), 9)],
)
def test_hunting_period(teeth, turns):
    pair = GearPair(*map(Gear, teeth), module_mm=2.0, pressure_angles_deg=20.0)
    assert pair.hunting_turns == turns


def test_normal_quantities_become_transverse():
    """20° normal at 3° is 20.0253° transverse, flank by flank; the module grows by 1/cos β."""
    normal: Any = {"normal_module_mm": 2.0, "normal_pressure_angle_deg": 20.0}
    pair = pair_of_table(both={"helix_angle_deg": 3.0}, **normal)
    np.testing.assert_allclose(pair.pressure_angles_deg, 20.0253, atol=5e-5)
    assert pair.module_mm == pytest.approx(2.0 / math.cos(math.radians(3.0)), rel=1e-15)
    helix = np.radians([3.0, 10.0])
    unlike = {"helix_left_deg": 3.0, "helix_right_deg": 10.0}
    pair = pair_of_table(both=unlike, normal_pressure_angle_deg=20.0)
    transverse = np.degrees(np.arctan(math.tan(math.radians(20.0)) / np.cos(helix)))
    np.testing.assert_allclose(pair.pressure_angles_deg, transverse, rtol=1e-14)
    assert pair.taper[1] == pytest.approx(math.tan(helix[1]), rel=1e-14)


def test_a_drive_knows_its_ratio_only():
    drive = pair_from_spec(parse_pair_spec({"name": "robot axis", "drive": {"ratio": "7/1798"}}))
    assert isinstance(drive, Drive)
    assert drive.ratio == Fraction(7, 1798) and drive.hunting_turns == 1798
    assert all(word in str(drive) for word in ("robot axis", "7/1798", "1798 driving turns"))
    assert str(Drive(Fraction(1, 2))).splitlines()[0] == "drive"


def test_objects_cannot_be_changed(paper_pair, paper_rig):
    fields = ((paper_pair, "module_mm"), (paper_pair.driving, "teeth"), (paper_rig, "driving_mm"))
    for thing, field in (*fields, (Drive(Fraction(1, 2)), "ratio")):
        with pytest.raises(FrozenInstanceError):
            setattr(thing, field, 1)


def test_numbers_are_traced_and_tooth_counts_are_not(paper_pair, paper_rig):
    traces = []

    @eqx.filter_jit
    def first_radius(pair, rig):
        traces.append(1)
        return pair.reference_radii[0] + rig.driving_mm

    def changed(**fields):
        return eqx.tree_at(
            lambda p: [getattr(p, name) for name in fields], paper_pair, [*fields.values()]
        )

    more = replace(paper_pair.driving, teeth=46)
    assert first_radius(paper_pair, paper_rig) == pytest.approx(45.0226)
    wider = changed(module_mm=np.asarray(2.1))
    assert first_radius(wider, replace(paper_rig, driving_mm=0.5)) == pytest.approx(47.75)
    assert len(traces) == 1
    assert first_radius(changed(driving=more), paper_rig) == pytest.approx(46.0226)
    assert len(traces) == 2


def test_leaves_are_numpy_doubles_until_compiled(paper_pair, paper_rig):
    for leaf in jax.tree.leaves((paper_pair, paper_rig)):
        assert isinstance(leaf, np.ndarray) and leaf.dtype == np.float64
    # Where 64-bit mode is off, only arrays of NumPy keep their digits.
    for derived in (paper_pair.base_radii, paper_pair.working_radii):
        assert isinstance(derived, np.ndarray) and derived.dtype == np.float64
    moved = jax.tree.map(jnp.asarray, paper_pair)
    assert isinstance(moved.base_radii, jax.Array)
    np.testing.assert_allclose(moved.base_radii, paper_pair.base_radii, rtol=1e-15)


def test_eccentricities_as_complex_numbers():
    first, second = Eccentricities(0.02, 90.0, 0.03, -60.0).cartesian
    np.testing.assert_allclose(first, 0.02j, atol=1e-17)
    np.testing.assert_allclose(second, 0.03 * np.exp(-1j * np.pi / 3), atol=1e-17)


def test_involute_function():
    """inv α is the bearing of the involute's point where the string stands at pressure angle α."""
    alpha = np.radians(np.array([0.0, 14.5, 20.0, 35.0]))
    roll = np.tan(alpha)
    point = np.exp(1j * roll) * (1 - 1j * roll)
    np.testing.assert_allclose(involute(alpha), np.angle(point), atol=1e-15)
