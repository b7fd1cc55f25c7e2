"""Backlash of the tooth thicknesses: (16), other centre distances, crowned teeth by brute force."""

import math
from functools import partial
from typing import Any

import equinox as eqx
import jax
import numpy as np
import pytest

from benchmarks.compiler import fast_to_compile
from tests.geometry.pairs import pair_of
from vttig_jax.geometry.backlash import backlash_and_contact, geometric_backlash, section_backlash
from vttig_jax.geometry.contact import contact_model
from vttig_jax.pair.gear_pair import Eccentricities, GearPair

make = partial(pair_of, pressure=(20.0, 22.0))
SHIFTS = np.array([-12.0, -3.0, -0.2, 0.0, 0.1, 0.9, 4.0, 15.0])
DISTANCES = (124.9, 125.12, 125.6)


UNEQUAL: dict[str, Any] = {
    "helix": (3.0, 1.5),
    "driven_helix": (2.85, 1.6),
    "crowning": (14.0, 9.0),
}
"""Driving and driven flanks that thin unlike: A and B touch in different sections."""


def test_linear_teeth_have_the_backlash_of_equation_16():
    """At every shift that leaves some common face, and at every centre distance."""
    for distance in DISTANCES:
        for shifts in ((0.0, 0.0), (0.2, 0.1)):
            pair = make((3.0, 2.0), shifts=shifts)
            there = make((3.0, 2.0), distance=distance, shifts=shifts)
            tapers = math.tan(math.radians(3.0)) + math.tan(math.radians(2.0))
            expected = float(there.drawing_backlash) - SHIFTS * tapers / 80.0
            found = np.asarray(geometric_backlash(pair, distance, SHIFTS))
            np.testing.assert_allclose(found, expected, rtol=0, atol=1e-14)
            off = expected + 1e-6 * tapers / 80.0  # a nanometre of shift is seen
            assert np.abs(found - off).min() > 1e-10


@pytest.mark.slow
@pytest.mark.parametrize(("distance", "shift"), [(125.12, 0.0), (125.4, 1.5), (125.05, -4.0)])
def test_it_is_what_the_surfaces_leave_when_they_touch(distance, shift):
    """First touch of both flanks, found by a search that knows no thickness."""
    pair = make(**UNEQUAL, widths=(20.0, 16.0))
    model = contact_model(
        pair, Eccentricities(axial_mm=shift), centre_distance_mm=distance, sections=9
    )
    touched = np.asarray(model.backlash(np.array([0.02, 0.07])))
    found = float(geometric_backlash(pair, distance, shift))
    np.testing.assert_allclose(touched, found, rtol=0, atol=1e-9)
    assert abs(float(geometric_backlash(pair, distance, shift + 0.001)) - found) > 1e-8


def material(pair: GearPair, distance: float, shift: float, z: np.ndarray) -> np.ndarray:
    """Arc on the working pitch circles that both gears fill on flank A and B, mm, shape (2, n)."""
    rows = []
    for flank in (0, 1):
        alpha = math.radians(float(pair.pressure_angles_deg[flank]))
        total = np.zeros_like(z)
        for gear, sense in ((pair.driving, 1.0), (pair.driven, -1.0)):
            own = sense * (z + (shift if sense < 0 else 0.0))
            reference = 1.0 * gear.teeth
            beta = math.radians(float((gear.helix_left_deg, gear.helix_right_deg)[flank]))
            recede = (
                own * math.tan(beta)
                + float(gear.crowning_um) * 1e-3 * (2 * own / float(gear.face_width_mm)) ** 2
            )
            arc = math.pi / 2 - recede
            working = distance * gear.teeth / 125
            turned = math.acos(reference * math.cos(alpha) / working)
            bearing = math.tan(alpha) - alpha - math.tan(turned) + turned
            total = total + working * (arc / reference + bearing)
        rows.append(total)
    return np.stack(rows)


@pytest.mark.parametrize(("distance", "shift"), [(125.12, 0.0), (125.4, 3.0), (124.95, -2.5)])
def test_crowned_teeth_touch_where_each_flank_is_thickest(distance, shift):
    """A dense grid over the common face, flank by flank."""
    pair = make(**UNEQUAL, widths=(20.0, 16.0))
    z = np.linspace(max(-10.0, -8.0 - shift), min(10.0, 8.0 - shift), 200_001)
    filled = material(pair, distance, shift, z)
    pitch = 2 * math.pi * distance / 125
    working = distance * 80 / 125
    expected = (pitch - filled.max(axis=1).sum()) / working
    assert float(geometric_backlash(pair, distance, shift)) == pytest.approx(expected, abs=1e-12)
    together = (pitch - filled.sum(axis=0).max()) / working
    assert together - expected > 1e-5  # one section for both flanks would be wrong
    places = np.asarray(backlash_and_contact(pair, distance, shift)[1])
    np.testing.assert_allclose(places, z[filled.argmax(axis=1)], rtol=0, atol=1e-4)
    assert abs(places[0] - places[1]) > 0.5
    some = z[::20_000]
    sections = (pitch - filled.sum(axis=0)[::20_000]) / working
    np.testing.assert_allclose(
        section_backlash(pair, some, distance, shift), sections, rtol=0, atol=1e-14
    )


def test_nothing_is_left_where_faces_do_not_overlap():
    pair = make(widths=(20.0, 12.0))
    found = np.asarray(geometric_backlash(pair, None, np.array([-16.1, -15.9, 15.9, 16.1])))
    assert np.isnan(found).tolist() == [True, False, False, True]
    z = np.array([-10.1, -10.0, -1.0, 1.0, 1.1])
    beside = np.asarray(section_backlash(pair, z, None, 5.0))
    assert np.isnan(beside).tolist() == [True, False, False, False, True]
    single = make(widths=(math.nan, math.nan))
    assert np.isfinite(section_backlash(single, np.array([-50.0, 50.0]))).all()
    assert np.isnan(float(geometric_backlash(pair, 115.0)))  # base circles that overlap


NUMBERS = {
    "distance": 125.3,
    "shift": 0.4,
    "driving.crowning_um": 14.0,
    "driven.helix_right_deg": 1.6,
    "driving.profile_shift": 0.0,
}


@jax.jit
def of_numbers(numbers):
    pair = make(**UNEQUAL, widths=(20.0, 16.0))
    for name, value in numbers.items():
        if "." in name:
            gear, key = name.split(".")
            pair = eqx.tree_at(lambda p, g=gear, k=key: getattr(getattr(p, g), k), pair, value)
    return geometric_backlash(pair, numbers["distance"], numbers["shift"])


def test_derivatives_follow_the_section_that_touches():
    slopes = jax.jit(jax.grad(of_numbers), **fast_to_compile())(NUMBERS)
    for name, value in NUMBERS.items():
        step = 1e-4
        ends = [float(of_numbers(NUMBERS | {name: value + way * step})) for way in (1, -1)]
        central = (ends[0] - ends[1]) / (2 * step)
        assert float(slopes[name]) == pytest.approx(central, rel=1e-7, abs=1e-11), name
        assert abs(central) > 1e-8
