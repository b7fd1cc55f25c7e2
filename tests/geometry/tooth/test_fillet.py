"""The fillet against the brute-force envelope of the rack, and where it joins flank and root."""

import jax
import numpy as np
import pytest
from hypothesis import given, settings
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
from vttig_jax.geometry.form import form_radius, undercut_depth
from vttig_jax.geometry.surface import (
    fillet_span,
    flank_roll,
    flank_span,
    tooth_surface,
)
from vttig_jax.geometry.tooth import SIDES

each_side = pytest.mark.parametrize("side", SIDES)

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
