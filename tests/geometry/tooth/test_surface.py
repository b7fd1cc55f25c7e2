"""Flank against the involute and the formulas of the paper, fillet against the brute-force rack."""

import math
from dataclasses import replace

import jax
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from tests.geometry.surface_teeth import (
    any_tooth,
    between,
    clearances,
    crowned,
    cutter,
    tangents,
    tooth,
    wave,
)
from tests.oracles.involute_mp import Flank
from vttig_jax.geometry.form import form_radius, undercut_depth
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


# The fillet against the brute-force envelope of the rack, and where it joins flank and root.


TEETH = {
    "taper": tooth(),
    "crowned": tooth(recession=(crowned(0.05, 0.03), crowned(0.02, 0.01))),
    "wave": tooth(recession=(wave, wave)),
    "shifted in": tooth(30, profile_shift_mm=-0.6),
    "shifted out": tooth(30, profile_shift_mm=1.0),
    "sharp cutter": tooth(fillet_radius_mm=0.0),
    "arc centre above the pitch line": tooth(profile_shift_mm=2.4),
}
TOLERANCE = 1e-8
"""Of the brute force, mm: a sharp cutter's distance has a kink at its minimum."""


def test_flank_and_fillet_are_the_envelope_of_the_rack():
    for side in SIDES:
        for gear in TEETH.values():
            for part, span in (("fillet", fillet_span), ("flank", flank_span)):
                rolls = between(span(gear, side), 5)
                assert np.abs(clearances(gear, side, part, rolls, 3.0)).max() < TOLERANCE
    other, gear = tooth(fillet_radius_mm=0.61), TEETH["taper"]
    rolls = between(fillet_span(other, "left"), 5)[1:-1]
    points = np.asarray(tooth_surface(other, rolls, 0.0, part="fillet"))
    assert min(abs(cutter(gear, "left", 0.0).clearance(x, y)) for x, y, _ in points) > 1e-5


@settings(max_examples=15)
@given(any_tooth(), st.sampled_from(SIDES), st.floats(-10.0, 10.0), st.floats(0.0, 1.0))
def test_any_fillet_is_the_envelope_of_the_rack(gear, side, z, share):
    """An undercut one only up to where it cuts the flank."""
    root, joint = fillet_span(gear, side)
    with jax.disable_jit():
        roll = np.array([root + share * (joint - root)])
        point = np.asarray(tooth_surface(gear, roll, z, side=side, part="fillet"))[0]
        found = clearances(gear, side, "fillet", roll, z)
    if undercut_depth(gear, side) > 0 and np.hypot(*point[:2]) > form_radius(gear, side):
        assert found < TOLERANCE
    else:
        assert np.abs(found).max() < TOLERANCE


def test_fillet_joins_flank_and_root_smoothly_and_the_flank_ends_on_the_tip_circle():
    z = np.linspace(-10, 10, 5)
    for side in SIDES:
        assert np.isnan(form_radius(tooth(4, profile_shift_mm=-1.8), side))  # no flank is left
        for name in ("wave", "sharp cutter", "arc centre above the pitch line"):
            gear = TEETH[name]
            (root, joint), (start, end) = fillet_span(gear, side), flank_span(gear, side)
            lower = tooth_surface(gear, joint, z, side=side, part="fillet")
            upper = tooth_surface(gear, start, z, side=side, part="flank")
            np.testing.assert_allclose(lower, upper, rtol=0, atol=1e-12)
            before, after = (tangents(gear, joint, z, side, p) for p in ("fillet", "flank"))
            crossed = np.linalg.det(np.stack([before, after], axis=-1))
            np.testing.assert_allclose(crossed, 0, atol=1e-9)
            deepest = tooth_surface(gear, root, z, side=side, part="fillet")
            radii = np.hypot(deepest[:, 0], deepest[:, 1])
            np.testing.assert_allclose(radii, float(gear.root_radius), rtol=0, atol=1e-12)
            along = tangents(gear, root, z, side, "fillet")
            np.testing.assert_allclose(np.sum(along * deepest[:, :2], axis=1), 0, atol=1e-9)
            tip = tooth_surface(gear, end, z, side=side)
            radii = np.hypot(tip[:, 0], tip[:, 1])
            np.testing.assert_allclose(radii, float(gear.tip_radius), rtol=1e-14)


@each_side
@settings(max_examples=10)
@given(teeth=st.integers(7, 14), shift=st.floats(-0.5, 0.0), radius=st.floats(0.0, 0.7))
def test_where_undercut_begins_the_cutter_has_been(teeth, shift, radius, side):
    """Just above the form circle the flank stands; just below it is cut away."""
    gear = tooth(teeth, profile_shift_mm=shift, fillet_radius_mm=radius)
    assert undercut_depth(gear, side) > 0
    form, base = form_radius(gear, side), float(gear.base_radii[SIDES.index(side)])
    around = np.array([form + 1e-3, (form + base) / 2])
    with jax.disable_jit():
        rolls = np.asarray(flank_roll(gear, around, side))
        above, below = clearances(gear, side, "flank", rolls, 0.0)
    assert abs(above) < TOLERANCE
    assert below < -TOLERANCE
