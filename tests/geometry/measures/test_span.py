"""Span: handbook values, and parallel jaws laid against the flanks themselves.

The handbook values are from the usual table of W for m = 1 and 20°, and worked examples of the KHK
gear handbook.
"""

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.geometry.shop_gears import flank_points, known, shop_gear
from vttig_jax.geometry.measures import Span, span
from vttig_jax.geometry.tooth import Tooth

KHK: dict[str, Any] = {"normal_module_mm": 3.0, "normal_pressure_angle_deg": 20.0}


def test_handbooks():
    """The last two with m_n = 3, z = 24 and x_n = +0.4: spur, and helical in the normal plane."""
    for teeth, spanned, value in ((30, 4, 10.7526), (20, 3, 7.6604), (17, 2, 4.6663)):
        found = span(shop_gear(teeth, module_mm=1.0))
        assert found.teeth == spanned and found.measurable and found.reason is None
        assert found.value_mm == pytest.approx(value, abs=6e-5)
        assert found.transverse_mm == found.value_mm
    found = span(shop_gear(20, module_mm=1.0), teeth=2)  # of the calculator of MESYS
    assert found.value_mm == pytest.approx(4.7083, abs=6e-5)
    assert found.contact_diameter_mm == pytest.approx(19.3746, abs=6e-5)
    for helix, spanned, value in ((0.0, 4, 32.8266), (25.0, 5, 42.0085)):
        found = span(shop_gear(24, helix=(helix, -helix), shift=0.4, **KHK))
        assert (found.teeth, found.measurable) == (spanned, True)
        assert found.value_mm == pytest.approx(value, abs=6e-5)


# Jaws laid against the flanks.


def supports(tooth: Tooth, teeth: int, normal: np.ndarray, z: float, reach: float):
    """How far the outermost flanks over some teeth reach along a direction and against it."""
    roll = np.linspace(0.0, 1.2, 1201)[:, None]
    height = z + np.linspace(-reach, reach, 401)[None, :]
    pitch = 2 * math.pi / tooth.teeth
    found = []
    for side, turn in ((0, (teeth - 1) * pitch / 2), (1, -(teeth - 1) * pitch / 2)):
        points = flank_points(tooth, side, roll, height)
        if side:
            points = points * np.array([-1.0, 1.0, 1.0])
        rotation = np.array([[math.cos(turn), -math.sin(turn)], [math.sin(turn), math.cos(turn)]])
        across = np.einsum("ij,...j->...i", rotation, points[..., :2])
        along = across @ normal[:2] + points[..., 2] * normal[2]
        found.append(float((along if side else -along).max()))
    return found


def test_parallel_jaws_stand_that_far_apart_however_they_are_turned():
    """On a helical gear they are square to the base helix; on a tapered one in a section."""
    helical = shop_gear(24, helix=(25.0, -25.0), shift=0.4, width=60.0, **KHK)
    shrunk = float(helical.base_radii[0] / helical.reference_radius)
    base_helix = math.atan(shrunk * math.tan(math.radians(25.0)))
    for tooth, lean, z, reach, within in (
        (helical, base_helix, 0.0, 25.0, 2e-4),
        (shop_gear(helix=(3.0, 3.0)), 0.0, 4.0, 0.0, 1e-4),
    ):
        found = span(tooth, z)
        for turn in (-0.04, 0.03):
            across = np.array([math.cos(turn), math.sin(turn)]) * math.cos(lean)
            normal = np.array([*across, -math.sin(lean)])
            apart = sum(supports(tooth, known(found.teeth), normal, z, reach))
            assert apart == pytest.approx(found.value_mm, abs=within)


def test_jaws_rock_on_flanks_with_different_base_circles():
    tooth = shop_gear(helix=(2.0, 14.0), normal_pressure_angle_deg=20.0)
    found = span(tooth)
    assert found.value_mm is None and not found.measurable
    assert "parallel jaws rock" in known(found.reason)
    apart = [
        sum(supports(tooth, 5, np.array([math.cos(turn), math.sin(turn), 0.0]), 0.0, 0.0))
        for turn in (-0.04, 0.0, 0.04)
    ]
    rocking = float(np.diff(tooth.base_radii)[0]) * 0.04  # by what the arms differ, per turn
    steps = np.diff(apart)
    assert np.abs(steps) == pytest.approx([abs(rocking)] * 2, rel=1e-3)
    assert steps[0] * steps[1] > 0


# Who can take it.


def test_no_micrometer_takes_it_where_no_line_is_square_to_both_flanks():
    for helix, crowning, z, words in (
        ((3.0, 3.0), 0.0, 0.0, "opposite hands (2.8194° left-handed, 2.8194° right-handed)"),
        ((-3.0, -3.0), 0.0, 0.0, "opposite hands (2.8194° right-handed, 2.8194° left-handed)"),
        ((3.0, 0.0), 0.0, 0.0, "base helix angles of 2.8194° and 0.0000°"),
        ((5.0, -3.0), 0.0, 0.0, "base helix angles of"),
        ((15.0, -15.0), 20.0, 0.0, "its helical flanks are crowned"),
        ((0.0, 0.0), 20.0, 5.0, "opposite hands"),
        ((0.0, 0.0), 20.0, 0.0, None),
        ((0.0, 0.0), 0.0, 5.0, None),
        ((15.0, -15.0), 0.0, 5.0, None),
        ((25.0, -25.0), 0.0, 0.0, "stand 14.57 mm apart on the axis, more than the face of 10 mm"),
    ):
        width = 10.0 if helix[0] == 25.0 else 20.0
        found = span(shop_gear(helix=helix, crowning_um=crowning, width=width), z)
        assert found.value_mm is not None
        assert found.measurable == (words is None)
        if words is None:
            assert found.reason is None
        else:
            reason = known(found.reason)
            assert words in reason and "no micrometer can take" in reason.lower()


def test_jaws_that_miss_the_flanks_are_told():
    for teeth, words in (
        (2, "below the form circle of 86.6994 mm; span more teeth"),
        (9, "above the tip circle of 94.0000 mm; span fewer teeth"),
        (60, "above the tip circle"),
    ):
        found = span(shop_gear(), teeth=teeth)
        assert found.value_mm is None and found.teeth == teeth
        assert f"Over {teeth} teeth" in known(found.reason) and words in known(found.reason)


def test_where_no_number_of_teeth_serves_there_is_none():
    for tooth in (
        shop_gear(3),
        shop_gear(2),
        shop_gear(rack={"addendum": 0.05}),
    ):
        found = span(tooth)
        assert found.teeth is None and found.value_mm is None
        assert known(found.reason).startswith("Over ")


# What has to hold for any gear.


@given(teeth=st.integers(12, 200), shift=st.floats(-0.2, 0.5), helix=st.floats(0, 35))
def test_chosen_teeth_are_the_nearest_to_the_v_circle(teeth, shift, helix):
    tooth = shop_gear(teeth, helix=(helix, -helix), shift=shift)
    chosen = span(tooth)
    if chosen.value_mm is None:
        return
    circle = 2 * float(tooth.reference_radius + tooth.profile_shift_mm)
    base = 2 * float(tooth.base_radii[0])

    def off(found: Span) -> float:
        """Distance from the V-circle in roll lengths."""
        contact = known(found.contact_diameter_mm)
        return abs(math.sqrt(contact**2 - base**2) - math.sqrt(circle**2 - base**2))

    pitch = math.pi * base / teeth * chosen.value_mm / known(chosen.transverse_mm)
    for spanned in (known(chosen.teeth) - 1, known(chosen.teeth) + 1):
        other = span(tooth, teeth=spanned)
        if other.value_mm is not None and spanned >= 2:
            assert off(other) >= off(chosen) - 1e-9
            assert abs(other.value_mm - chosen.value_mm) == pytest.approx(pitch)
