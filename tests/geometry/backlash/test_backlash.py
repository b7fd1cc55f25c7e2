"""Backlash of the tooth thicknesses: (16), other centre distances, crowned teeth by brute force."""

import math
from functools import partial
from typing import Any

import equinox as eqx
import jax
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks.compiler import fast_to_compile
from tests.geometry.pairs import pair_of
from vttig_jax.base.errors import PairError
from vttig_jax.geometry.backlash import (
    axial_for_backlash,
    backlash_and_contact,
    gap_report,
    geometric_backlash,
    section_backlash,
)
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


# Axial positions for a wanted backlash: there and back, and what no position gives.


@pytest.mark.slow
@settings(max_examples=10)
@given(
    helix=st.floats(0.5, 4.0),
    crowning=st.floats(0.0, 20.0),
    distance=st.floats(124.8, 125.6),
    share=st.floats(-0.95, 0.95),
)
def test_there_and_back(helix, crowning, distance, share):
    """The position found has the backlash, and is no farther from s = 0 than the one asked with."""
    pair = make((helix, helix), (crowning, crowning / 2), (20.0, 16.0))
    asked = 18.0 * share
    wanted = float(geometric_backlash(pair, distance, asked))
    found = axial_for_backlash(pair, wanted, distance)
    assert float(geometric_backlash(pair, distance, found)) == pytest.approx(wanted, abs=1e-14)
    assert abs(found) <= abs(asked) + 18.0 / 128


def test_of_two_positions_the_nearer_one():
    """Spur gears, crowned: shifted either way the thickest sections part."""
    pair = make((0.0, 0.0), (20.0, 20.0))
    wanted = float(geometric_backlash(pair, None, 3.0))
    assert abs(axial_for_backlash(pair, wanted)) == pytest.approx(3.0, abs=1e-6)


def test_what_no_position_gives():
    """Beyond the stroke or the face; spur or wrongly crowned gears; base circles that overlap."""
    stroke = r"backlash: 1° cannot be reached; with 15 mm of common face or more"
    stroke += r" \(s from -5 to 5 mm\) it is -0\.\d+° to 0\.\d+°\."
    face = "least_overlap_mm: 21 mm is not between 0 and the narrower face width"
    spur, crowned = {"helix": (0.0, 0.0)}, {"crowning": (20.0, 20.0)}
    cases: list[tuple[Any, tuple[float, ...], dict[str, float], str]] = [
        ({}, (math.radians(1.0),), {"least_overlap_mm": 15.0}, stroke),
        ({}, (0.0,), {"least_overlap_mm": 21.0}, face),
        (spur | {"widths": (math.nan, math.nan)}, (1e-3,), {}, "do not thin along the axis"),
        ({}, (0.0, 115.0), {}, "lies below a base circle"),
        (spur | crowned, (-0.01,), {}, "cannot be reached"),
    ]
    for gears, values, options, sentence in cases:
        with pytest.raises(PairError, match=sentence):
            axial_for_backlash(make(**gears), *values, **options)


def test_what_the_stroke_gives_is_what_its_ends_give():
    """The limits in the sentence can be had, a little more can not."""
    pair = make(**UNEQUAL)
    low, high = np.asarray(geometric_backlash(pair, None, np.array([5.0, -5.0])))
    assert axial_for_backlash(pair, float(low), least_overlap_mm=15.0) == pytest.approx(5.0)
    with pytest.raises(PairError, match=f"{math.degrees(low):.4f}° to {math.degrees(high):.4f}°"):
        axial_for_backlash(pair, float(low) - 1e-6, least_overlap_mm=15.0)


# Backlash of the drawing section by section, beside the apparent one of a fit.


CROWNED = make(crowning=(10.0, 6.0))


@pytest.mark.smoke
def test_numbers_are_those_of_the_functions():
    report = gap_report(CROWNED, 125.2, 0.9, sections=7)
    expected = float(geometric_backlash(CROWNED, 125.2, 0.9))
    assert report.backlash == pytest.approx(expected, abs=1e-15)
    assert report.backlash_mm == pytest.approx(report.backlash * 80.0)
    assert (report.z_mm[0], report.z_mm[-1]) == pytest.approx((-10.0, 9.1))
    expected = section_backlash(CROWNED, report.z_mm, 125.2, 0.9)
    np.testing.assert_allclose(report.section_backlash, expected, rtol=0, atol=1e-16)
    assert report.section_backlash.min() >= report.backlash - 1e-15
    assert np.ptp(report.section_backlash) > 1e-5


@pytest.mark.smoke
def test_interference_is_told_section_by_section():
    """At s = 0.9 the middle is too thick, the crowned ends are not."""
    report = gap_report(CROWNED, axial_mm=0.9, sections=9)
    assert report.backlash < 0
    assert report.interferes.any() and not report.interferes.all()
    np.testing.assert_array_equal(report.interferes, report.section_backlash < 0)
    rows = str(report).splitlines()[-9:]
    assert [row.endswith("interferes") for row in rows] == report.interferes.tolist()
    assert not gap_report(CROWNED, axial_mm=-0.9).interferes.any()


@pytest.mark.smoke
def test_an_apparent_backlash_stands_beside():
    """What it is more than the drawing, as thickness and as an axial position."""
    pair = make((3.0, 2.0))
    report = gap_report(pair, apparent_deg=0.1)
    assert report.difference is not None
    assert report.difference == pytest.approx(math.radians(0.1) - float(pair.drawing_backlash))
    tapers = math.tan(math.radians(3.0)) + math.tan(math.radians(2.0))
    assert report.opening_mm == pytest.approx(tapers, rel=1e-9)
    position = -report.difference * 80.0 / tapers
    assert f"{position:+.3f} mm of s" in str(report)
    moved = gap_report(pair, axial_mm=position)
    assert moved.backlash == pytest.approx(math.radians(0.1), abs=1e-12)
    assert moved.difference is None
    assert gap_report(pair, axial_mm=0.3, apparent_deg=0.1).difference == report.difference
    logged = gap_report(pair, apparent_deg=0.1, logged_axial_mm=position)
    assert logged.difference == pytest.approx(0.0, abs=1e-12)
    assert f"less that drawn at s = {position:g}" in str(logged)
    assert gap_report(pair).difference is None and "apparent" not in str(gap_report(pair))
    spur = str(gap_report(make((0.0, 0.0)), apparent_deg=0.1))
    assert "of tooth thickness" in spur and "of s" not in spur


@pytest.mark.smoke
def test_gears_without_a_face_and_positions_without_a_gap():
    np.testing.assert_array_equal(gap_report(make(widths=(math.nan, math.nan))).z_mm, [0.0])
    with pytest.raises(ValueError, match="`axial_mm` must leave the faces some overlap"):
        gap_report(make(), axial_mm=25.0)
    with pytest.raises(PairError, match="below a base circle; move the axes apart"):
        gap_report(make(), 115.0)
