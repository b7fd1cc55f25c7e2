"""Over balls and span: handbook values, and a ball or parallel jaws laid against the flanks.

The handbook values are worked examples of the KHK gear handbook, its usual table of W for m = 1 and
20°, the table of Machinery's Handbook for wires of 1.728 in at a diametral pitch of 1, and the
example of the MESYS calculator.
"""

import math
from collections.abc import Callable
from typing import Any

import equinox as eqx
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import minimize, root_scalar

from tests.geometry.shop_gears import flank_points, known, shop_gear
from vttig_jax.base.arrays import namespace
from vttig_jax.geometry.measures import SIZES_MM, Span, over_balls, span, usual_ball
from vttig_jax.geometry.tooth import Tooth


def test_balls_of_handbooks():
    """The helical gear, with m_n = 1 and x_n = +0.4, counts its shift in normal modules."""
    found = over_balls(shop_gear(20, module_mm=1.0), 1.7)
    assert found.value_mm == pytest.approx(22.2941, abs=6e-5) and found.reason is None
    assert found.contact_diameter_mm == pytest.approx((19.9594, 19.9594), abs=5e-5)
    over_one = known(found.centre_diameter_mm) / 2 + 1.7 / 2
    assert over_one == pytest.approx(11.1471, abs=6e-5)
    wires = over_balls(shop_gear(32, module_mm=1.0), 1.728)
    assert wires.value_mm == pytest.approx(34.4130, abs=6e-5)
    normal: dict[str, Any] = {"normal_module_mm": 1.0, "normal_pressure_angle_deg": 20.0}
    helical = shop_gear(20, helix=(15.0, -15.0), shift=0.4, **normal)
    assert over_balls(helical, 2.0).value_mm == pytest.approx(24.5696, abs=6e-5)


def involute(angle):
    return math.tan(angle) - angle


def root(function: Callable[[float], float], low: float, high: float) -> float:
    return root_scalar(function, bracket=(low, high), xtol=1e-14).root


def test_the_formula_of_equal_flanks():
    """inv α_M = s_t(z)/d + inv αₜ + D/(d_b cos β_b) − π/z, with an odd number seen askew."""
    for teeth in (44, 45):
        for helix in (0.0, 3.0):
            for z in (-6.0, 0.0, 7.5):
                ball, alpha, beta = 3.4, math.radians(20), math.radians(helix)
                d = 2.0 * teeth
                thickness = math.pi - 2 * z * math.tan(beta)
                base_helix = math.atan(math.tan(beta) * math.cos(alpha))
                base = d * math.cos(alpha)
                wanted = thickness / d + involute(alpha) + ball / (base * math.cos(base_helix))
                wanted -= math.pi / teeth
                at_centre = root(lambda a, wanted=wanted: involute(a) - wanted, 0.0, 1.5)
                centre = base / math.cos(at_centre)
                across = centre * (math.cos(math.pi / 2 / teeth) if teeth % 2 else 1.0)
                found = over_balls(shop_gear(teeth, helix=(helix, helix)), ball, z)
                assert found.centre_diameter_mm == pytest.approx(centre, rel=1e-13)
                assert found.value_mm == pytest.approx(across + ball, rel=1e-13)


class Wave(eqx.Module):
    """A recession that is neither straight nor a parabola."""

    slope: float
    height_mm: float

    def __call__(self, z):
        xp = namespace(z)
        return self.slope * z + self.height_mm * xp.sin(z / 1.3)


def distance(tooth: Tooth, side: int, centre: np.ndarray, reach: float):
    """Distance of a point from a flank of the space beside it, and the nearest point."""
    if side == 1:  # the right flank of the next tooth to the left is a mirrored left flank
        pitch = 2 * math.pi / tooth.teeth
        x, y, z = centre
        x, y = (
            math.cos(pitch) * x + math.sin(pitch) * y,
            math.cos(pitch) * y - math.sin(pitch) * x,
        )
        centre = np.array([-x, y, z])

    def away(at: np.ndarray) -> float:
        return float(np.linalg.norm(flank_points(tooth, side, at[0], at[1]) - centre))

    rolls, heights = np.linspace(0.0, 1.1, 121), centre[2] + np.linspace(-reach, reach, 81)
    grid = flank_points(tooth, side, rolls[:, None], heights[None, :])
    off = np.linalg.norm(grid - centre, axis=-1)
    row, column = np.unravel_index(np.argmin(off), off.shape)
    start = np.array([rolls[row], heights[column]])
    found = minimize(away, start, method="Nelder-Mead", options={"xatol": 1e-11, "fatol": 1e-13})
    return float(found.fun), flank_points(tooth, side, found.x[0], found.x[1])


def seat(tooth: Tooth, radius: float, z: float, ball: float):
    """Distances of a ball, put between the flanks at a radius so that both are alike."""

    def both(turn: float):
        centre = np.array([-radius * math.sin(turn), radius * math.cos(turn), z])
        return [distance(tooth, side, centre, ball) for side in (0, 1)]

    def unlike(turn: float) -> float:
        (left, _), (right, _) = both(turn)
        return left - right

    half = math.pi / tooth.teeth
    return both(root(unlike, 0.6 * half, 1.4 * half))


WAVES = Wave(0.05, 0.03), Wave(-0.02, 0.02)
CASES = {
    "helical": (shop_gear(20, helix=(25.0, -25.0), shift=0.3), 1.5),
    "unequal taper": (shop_gear(helix=(2.0, 14.0), normal_pressure_angle_deg=20.0), -2.0),
    "crowned": (shop_gear(31, helix=(3.0, -8.0), crowning_um=150.0), 4.0),
    "any function": (eqx.tree_at(lambda t: t.recession, shop_gear(), WAVES), -3.0),
}


@pytest.mark.parametrize("name", CASES)
def test_a_ball_there_touches_both_flanks_and_nothing_less(name):
    (tooth, z), ball = CASES[name], 3.5
    found = over_balls(tooth, ball, z)
    assert found.reason is None
    centre = known(found.centre_diameter_mm) / 2
    for side, (away, point) in enumerate(seat(tooth, centre, z, ball)):
        assert away == pytest.approx(ball / 2, abs=2e-9)
        contact = 2 * math.hypot(point[0], point[1])
        assert contact == pytest.approx(known(found.contact_diameter_mm)[side], abs=2e-4)
        assert point[2] == pytest.approx(known(found.contact_z_mm)[side], abs=2e-4)
    # A centre 1 µm farther out or in is seen.
    for radius in (centre + 1e-3, centre - 1e-3):
        assert abs(seat(tooth, radius, z, ball)[0][0] - ball / 2) > 1e-4


def test_the_highest_of_two_hills_is_found():
    """The flank stands out twice under the ball; the larger hill holds it."""

    class Hills(eqx.Module):
        def __call__(self, z):
            xp = namespace(z)
            return -0.4 * xp.exp(-((z - 0.8) ** 2) / 0.01) - 0.39 * xp.exp(-((z + 0.8) ** 2) / 0.01)

    tooth = eqx.tree_at(lambda t: t.recession, shop_gear(), (Hills(), Hills()))
    assert known(over_balls(tooth, 3.5).contact_z_mm) == pytest.approx((0.8, 0.8), abs=0.02)


def test_a_ball_that_cannot_seat_is_told():
    for tooth, ball, z, words in (
        (shop_gear(), 1.2, 0.0, "lies below the base circle; take a larger one"),
        (shop_gear(), 2.0, 0.0, "below the form circle of 86.6994 mm; take a larger one"),
        (shop_gear(), 6.0, 0.0, "above the tip circle of 94.0000 mm; take a smaller one"),
        (shop_gear(rack={"clearance": 0.0}), 2.3, 0.0, "rest on the root circle of 86.0000 mm"),
        (shop_gear(helix=(3.0, 3.0)), 3.5, -9.95, "beyond the end of the face"),
        (shop_gear(1, rack={"addendum": 0.4}), 3.0, 0.0, "one tooth has no opposite space"),
    ):
        found = over_balls(tooth, ball, z)
        assert found.value_mm is None and found.contact_diameter_mm is None
        assert found.reason is not None and words in found.reason
        assert found.reason.endswith(".") and "\n" not in found.reason
    endless = shop_gear(helix=(3.0, 3.0), width=None)
    assert over_balls(endless, 3.5, -9.95).reason is None


def test_the_chosen_ball_is_on_sale_and_touches_near_the_v_circle():
    for tooth in (
        *(shop_gear(teeth) for teeth in (12, 17, 20, 45, 80, 300)),
        *(shop_gear(module_mm=module) for module in (0.3, 1.0, 5.0, 20.0)),
        shop_gear(24, helix=(25.0, -25.0), shift=0.4),
        shop_gear(helix=(3.0, 3.0)),
        shop_gear(helix=(2.0, 14.0), normal_pressure_angle_deg=20.0),
    ):
        ball = usual_ball(tooth)
        found = over_balls(tooth, ball)
        assert ball in SIZES_MM
        assert known(found.value_mm) > 2 * tooth.tip_radius
        contact = np.mean(known(found.contact_diameter_mm)) / 2
        circle = tooth.reference_radius + tooth.profile_shift_mm
        assert abs(contact - circle) < 0.75 * tooth.addendum_mm


def test_sizes_beyond_those_on_sale_have_two_digits():
    for module in (0.05, 100.0):
        tooth = shop_gear(module_mm=module, width=10 * module)
        ball = usual_ball(tooth)
        assert ball not in SIZES_MM and float(f"{ball:.2g}") == ball
        assert over_balls(tooth, ball).value_mm is not None


# Span: handbook values, and parallel jaws laid against the flanks themselves.


KHK: dict[str, Any] = {"normal_module_mm": 3.0, "normal_pressure_angle_deg": 20.0}


def test_spans_of_handbooks():
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
    for tooth in (shop_gear(3), shop_gear(2), shop_gear(rack={"addendum": 0.05})):
        found = span(tooth)
        assert found.teeth is None and found.value_mm is None
        assert known(found.reason).startswith("Over ")


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
