"""The flank against the involute of its definition, the paper's formulas and the law of meshing."""

import math
from dataclasses import replace

import jax
import mpmath as mp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.geometry.surface_teeth import any_tooth, between, crowned, tangents, tooth, wave
from tests.oracles.involute_mp import Flank
from vttig_jax.geometry.form import form_radius
from vttig_jax.geometry.surface import (
    fillet_span,
    flank_roll,
    flank_span,
    rack_side,
    tooth_surface,
)
from vttig_jax.geometry.tooth import SIDES, Taper

HEIGHTS = (-10.0, -3.3, 0.0, 10.0)
each_side = pytest.mark.parametrize("side", SIDES)


def involute(gear, side, recession) -> Flank:
    index = SIDES.index(side)
    return Flank(
        teeth=gear.teeth,
        module=float(gear.module_mm),
        pressure_angle_deg=float(gear.pressure_angles_deg[index]),
        shift=float(gear.profile_shift_mm),
        recession=recession,
    )


def distances(gear, side, points, recession) -> np.ndarray:
    """Of points of one section from the involute of its definition, mm."""
    curve, mirror = involute(gear, side, recession), 1.0 if side == "right" else -1.0
    return np.array([curve.distance(mirror * x, y) for x, y, _ in np.asarray(points)])


def linear(slope):
    return lambda z: mp.mpf(slope) * z


def quadratic(slope, crowning):
    return lambda z: mp.mpf(slope) * z + mp.mpf(crowning) * (2 * mp.mpf(z) / 20) ** 2


def sine(z):
    return mp.mpf(0.05) * mp.sin(mp.mpf(0.3) * z) + mp.mpf(0.01) * z


CASES = {
    "linear": (tooth(recession=(Taper(0.05), Taper(0.03))), (linear(0.05), linear(0.03))),
    "crowned, shifted": (
        tooth(30, recession=(crowned(0.05, 0.02), crowned(0.0, 0.04)), profile_shift_mm=0.7),
        (quadratic(0.05, 0.02), quadratic(0.0, 0.04)),
    ),
    "drum-shaped, 14.5 and 30 degrees": (
        tooth(80, recession=(crowned(0.0, 0.1),) * 2, pressure_angles_deg=np.array([14.5, 30.0])),
        (quadratic(0.0, 0.1),) * 2,
    ),
    "a wave": (tooth(20, recession=(wave, wave), profile_shift_mm=-0.3), (sine, sine)),
}


def test_flank_is_the_involute_of_its_definition():
    for side in SIDES:
        for case in CASES:
            for z in HEIGHTS:
                gear, exact = CASES[case]
                low = form_radius(gear, side)
                rolls = flank_roll(gear, np.linspace(low, float(gear.tip_radius), 7), side)
                with mp.workdps(50):
                    recession = exact[SIDES.index(side)](z)
                points = tooth_surface(gear, rolls, z, side=side)
                found = distances(gear, side, points, recession)
                assert found.max() < 1e-10
                assert (found / np.linalg.norm(points[:, :2], axis=-1)).max() < 1e-12


@settings(max_examples=20)
@given(any_tooth(), st.sampled_from(SIDES), st.floats(-10.0, 10.0), st.floats(0.0, 1.0))
def test_any_flank_is_an_involute(gear, side, z, share):
    low, high = form_radius(gear, side), float(gear.tip_radius)
    roll = flank_roll(gear, np.array([low + share * (high - low)]), side)
    recession = float(gear.recession[SIDES.index(side)](np.array([z]))[0])
    with jax.disable_jit():
        points = tooth_surface(gear, roll, z, side=side)
    assert distances(gear, side, points, recession).max() < 1e-12 * high


def test_the_oracle_sees_a_billionth_of_a_millimetre():
    curve = Flank(45, 2.0, 20.0)
    x, y = curve.point(0.4)
    assert curve.distance(x, y) < 1e-14
    assert curve.distance(x + 1e-9, y) == pytest.approx(1e-9, rel=0.2)
    for other in (replace(curve, pressure_angle_deg=20.0001), replace(curve, recession=1e-6)):
        assert other.distance(x, y) > 1e-8


@each_side
def test_thickness_is_that_of_the_drawing(side):
    """Table 1 of the paper: 4.190 mm and 2.093 mm at the ends; see the half angles of `Tooth`."""
    taper = Taper(math.tan(math.radians(3.0)))
    gear = tooth(pressure_angles_deg=np.array([20.0, 20.0]), recession=(taper, taper))
    roll = flank_roll(gear, np.array(45.0), side)
    x, y, _ = np.asarray(tooth_surface(gear, roll, np.array([-10.0, 10.0]), side=side)).T
    np.testing.assert_allclose(2 * 45 * np.abs(np.arctan2(x, y)), [4.1897, 2.0934], atol=5e-5)


@each_side
def test_flank_is_the_formula_of_the_paper(side):
    """(1), (2), (14) and (15) as printed, with the angle φ of the paper and helix angles."""
    slope, index = math.tan(math.radians(3.0)), SIDES.index(side)
    gear = tooth(recession=(Taper(slope), Taper(slope)))
    m, h, r, alpha = 2.0, 2.0, 45.0, math.radians([20.0, 22.0][index])
    for phi in (-0.15, 0.02, 0.08):
        for z in HEIGHTS:
            # The paper prints + φ r₂ for AC; for DF its sign follows from the motion.
            turn = phi if side == "left" else -phi
            d = math.sin(alpha) * (
                math.pi * m / 4 + h * math.tan(alpha) + h / math.tan(alpha) + turn * r - z * slope
            )
            x = d * math.sin(alpha) + z * slope - math.pi * m / 4 - h * math.tan(alpha)
            x, y = (x if side == "left" else -x), d * math.cos(alpha) - h
            cosine, sine_ = math.cos(phi), math.sin(phi)
            wanted = (
                x * cosine + y * sine_ + r * (sine_ - phi * cosine),
                -x * sine_ + y * cosine + r * (cosine + phi * sine_),
                z,
            )
            roll = phi - z * slope / r if side == "left" else phi + z * slope / r
            found = tooth_surface(gear, roll, z, side=side)
            np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-13)


@each_side
def test_normal_touches_the_base_circle(side):
    """A flank's normal in the section is the taut string: r · tangent is its arm."""
    gear = tooth(recession=(wave, wave))
    roll, z = between(flank_span(gear, side), 5)[:, None], np.array(HEIGHTS)
    point = np.asarray(tooth_surface(gear, roll, z, side=side))
    arm = np.sum(point[..., :2] * tangents(gear, roll, z, side, "flank"), axis=-1)
    np.testing.assert_allclose(np.abs(arm), gear.base_radii[SIDES.index(side)], rtol=1e-13)


@each_side
def test_limits_are_the_end_of_the_arc_and_the_tip(side):
    gear, index = tooth(profile_shift_mm=0.4), SIDES.index(side)
    start, end = flank_span(gear, side)
    np.testing.assert_allclose(end, flank_roll(gear, gear.tip_radius, side), rtol=1e-15)
    np.testing.assert_allclose(fillet_span(gear, side)[1], start, rtol=1e-15)
    np.testing.assert_allclose(
        start, flank_roll(gear, np.array(form_radius(gear, side)), side), rtol=1e-13
    )
    rack = rack_side(gear, side)
    point, _ = rack.contact("flank", jax.numpy.asarray(start), jax.numpy.asarray(0.0))
    # c_p + h_ap deep, less what the arc of radius ρ takes: ρ (1 − sin α)
    sine_ = math.sin(gear.pressure_angles[index])
    np.testing.assert_allclose(point[1], 0.4 - 2.5 + 0.6 * (1 - sine_), rtol=1e-13)
