"""The flank against the involute of its definition and the formulas of the paper."""

import math
from dataclasses import replace

import jax
import numpy as np
import pytest
from hypothesis import example, given, settings
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
WAVY = tooth(recession=(crowned(0.05, 0.03), wave))
each_side = pytest.mark.parametrize("side", SIDES)


@settings(max_examples=20)
@given(any_tooth(), st.sampled_from(SIDES), st.floats(-10.0, 10.0), st.floats(0.0, 1.0))
@example(tooth(20, recession=(wave, wave), profile_shift_mm=-0.3), "right", 3.3, 0.7)
def test_any_flank_is_an_involute(gear, side, z, share):
    """A micrometre of recession more and a wrong pressure angle are seen."""
    low, high, index = form_radius(gear, side), float(gear.tip_radius), SIDES.index(side)
    roll = flank_roll(gear, np.array(low + share * (high - low)), side)
    with jax.disable_jit():
        x, y, _ = np.asarray(tooth_surface(gear, roll, z, side=side))
    curve = Flank(
        teeth=gear.teeth,
        module=float(gear.module_mm),
        pressure_angle_deg=float(gear.pressure_angles_deg[index]),
        shift=float(gear.profile_shift_mm),
        recession=float(gear.recession[index](np.array([z]))[0]),
    )
    mirrored = x if side == "right" else -x
    assert curve.distance(mirrored, y) < 1e-12 * high
    for changes in ({"pressure_angle_deg": 40.0}, {"recession": curve.recession + 1e-3}):
        assert replace(curve, **changes).distance(mirrored, y) > 1e-5


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


def test_shapes_broadcast():
    z = np.array(HEIGHTS)
    assert tooth_surface(WAVY, 0.0, 0.0).shape == (3,)
    assert tooth_surface(WAVY, np.zeros((4, 1)), z).shape == (4, 4, 3)
    assert tooth_surface(WAVY, np.zeros((5, 2, 1)), 1).shape == (5, 2, 1, 3)
    np.testing.assert_array_equal(tooth_surface(WAVY, 0.1, z)[:, 2], z)


def test_arguments_that_are_none(unchecked):
    with pytest.raises(ValueError, match='`part` must be "root", "fillet", "flank" or "tip", but'):
        tooth_surface(WAVY, 0.0, 0.0, part="land")  # pyright: ignore[reportArgumentType]
    with pytest.raises(ValueError, match='`side` must be "left" or "right", but is \'A\''):
        tooth_surface(WAVY, 0.0, 0.0, side="A")  # pyright: ignore[reportArgumentType]
