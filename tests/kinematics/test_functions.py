"""The public functions: identities, what each argument does, and refusals."""

from dataclasses import replace
from functools import partial
from typing import Any

import jax
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vttig_jax.kinematics.functions import (
    axial_displacement,
    backlash,
    exact_backlash,
    exact_transmission_error,
    transmission_error,
)
from vttig_jax.pair.gear_pair import Eccentricities, Gear, GearPair
from vttig_jax.pair.schema import FLANKS

ANGLES = np.linspace(-3.0, 40.0, 97)

phases = st.floats(0.0, 360.0)
sizes = st.floats(0.005, 0.05)


@st.composite
def pairs(draw):
    """Any proportion of 45/80 teeth: one compilation serves all of them."""
    module = draw(st.floats(0.5, 4.0))
    left, right = draw(st.floats(14.5, 28.0)), draw(st.floats(14.5, 28.0))
    distance = 62.5 * module * (1 + draw(st.floats(0.0, 0.003)))
    helix = draw(st.floats(-5.0, 5.0)), draw(st.floats(-5.0, 5.0))
    return GearPair(
        Gear(45, *helix),
        Gear(80, *helix),
        module_mm=module,
        pressure_angles_deg=(left, right),
        centre_distance_mm=distance,
    )


@st.composite
def rigs(draw, pair):
    module = float(pair.module_mm)
    return Eccentricities(
        draw(sizes) * module,
        draw(phases),
        draw(sizes) * module,
        draw(phases),
        draw(st.floats(0.0, 0.1)),
        draw(st.floats(-0.2, 0.2)),
    )


@given(st.data())
def test_error_of_the_closed_form_grows_with_the_square(data):
    pair = data.draw(pairs())
    rig = replace(data.draw(rigs(pair)), constant_backlash_deg=0.0, axial_mm=0.0)
    twice = replace(rig, driving_mm=2 * rig.driving_mm, driven_mm=2 * rig.driven_mm)

    def worst(one, flank):
        closed = transmission_error(ANGLES, pair, one, flank)
        return np.abs(closed - exact_transmission_error(ANGLES, pair, one, flank)).max()

    for flank in FLANKS:
        assert worst(twice, flank) / worst(rig, flank) == pytest.approx(4.0, rel=0.03)


@given(st.data())
def test_backlash_is_the_difference_of_the_flanks(data):
    pair = data.draw(pairs())
    rig = data.draw(rigs(pair))
    reference = {"pressure_angle": "reference"}
    for te, gap in (
        (transmission_error, backlash),
        (partial(transmission_error, **reference), partial(backlash, **reference)),
        (exact_transmission_error, exact_backlash),
    ):
        apart = te(ANGLES, pair, rig, "B") - te(ANGLES, pair, rig, "A")
        np.testing.assert_allclose(gap(ANGLES, pair, rig), apart, rtol=0, atol=1e-12)


@given(phases, sizes, phases, sizes)
def test_printed_backlash_formula(first, e1, second, e2):
    """(21) written out: j_v = 2 tan α/R₂ [e₂ cos χ₂ − e₁ cos ψ₁], with j_c and s beside it."""
    pair = GearPair(Gear(45, 3.0, 2.0), Gear(80, 3.0, 2.0), module_mm=2.0, pressure_angles_deg=20.0)
    rig = Eccentricities(e1, first, e2, second, 0.038, 0.3)
    cosines = e2 * np.cos(0.5625 * ANGLES + np.radians(second)) - e1 * np.cos(
        ANGLES + np.radians(first)
    )
    printed = np.radians(0.038) + 2 * np.tan(np.radians(20.0)) / 80 * cosines
    printed -= 0.3 * (np.tan(np.radians(3.0)) + np.tan(np.radians(2.0))) / 80
    found = backlash(ANGLES, pair, rig, pressure_angle="reference")
    np.testing.assert_allclose(found, printed, rtol=0, atol=1e-15)


def test_axial_displacement_both_ways(paper_pair, paper_rig):
    """(16): j = 2 s tan β at the reference circle; shifting by s(j) takes up exactly j."""
    assert axial_displacement(0.05, paper_pair) == pytest.approx(
        0.05 / (2 * np.tan(np.radians(3.0))), rel=1e-14
    )
    gaps = np.asarray(backlash(ANGLES, paper_pair, paper_rig))
    for angle, gap in zip(ANGLES[::24], gaps[::24], strict=True):
        shift = axial_displacement(gap * 80.0, paper_pair)
        closed = replace(paper_rig, axial_mm=shift)
        assert abs(float(backlash(angle, paper_pair, closed))) < 1e-15
        assert abs(float(exact_backlash(angle, paper_pair, closed))) < 1e-6


def test_unequal_helix_angles_move_each_flank_by_its_own():
    pair = GearPair(Gear(45, 3.0, 1.0), Gear(80, 3.0, 1.0), module_mm=2.0, pressure_angles_deg=20.0)
    for flank, slope in zip(FLANKS, np.tan(np.radians([3.0, -1.0])) / 80, strict=True):
        for te in (transmission_error, exact_transmission_error):
            moved = te(1.0, pair, Eccentricities(axial_mm=0.5), flank)
            assert float(moved) == pytest.approx(0.5 * slope, rel=1e-12)
    thinning = np.tan(np.radians(3.0)) + np.tan(np.radians(1.0))
    assert axial_displacement(0.1, pair) == pytest.approx(0.1 / thinning, rel=1e-14)
    spur = GearPair(Gear(45), Gear(80), module_mm=2.0, pressure_angles_deg=20.0)
    assert np.isposinf(axial_displacement(0.05, spur))


WITH_RIG = (
    partial(transmission_error, flank="B"),
    partial(exact_transmission_error, flank="B"),
    backlash,
    exact_backlash,
)


@pytest.mark.parametrize("function", [transmission_error, exact_transmission_error])
def test_reference_start_is_zero_at_zero_and_differs_by_a_constant(function, paper_pair, paper_rig):
    absolute = np.asarray(function(ANGLES, paper_pair, paper_rig, "B"))
    started = np.asarray(function(ANGLES, paper_pair, paper_rig, "B", reference="start"))
    at_zero = float(function(0.0, paper_pair, paper_rig, "B"))
    assert float(function(0.0, paper_pair, paper_rig, "B", reference="start")) == 0.0
    assert abs(at_zero) > 1e-4
    np.testing.assert_allclose(absolute - started, at_zero, rtol=0, atol=1e-17)


@pytest.mark.parametrize(
    ("angle", "error_deg", "gap_deg"), [("reference", 1.2e-4, 2.2e-4), ("working", 1.9e-5, 3.6e-5)]
)
def test_published_numbers(paper_pair, paper_rig, angle, error_deg, gap_deg):
    """Closed form against exact in physics.md §3 and §6, on the rig of Tables 1 and 2."""
    turns = np.radians(np.arange(0.0, 5760.0, 0.5))
    arguments = turns, paper_pair, replace(paper_rig, constant_backlash_deg=0.0)
    of_gap = backlash(*arguments, pressure_angle=angle) - exact_backlash(*arguments)
    differences = [(of_gap, gap_deg)]
    for flank in FLANKS:
        closed = transmission_error(*arguments, flank, pressure_angle=angle)
        differences.append((closed - exact_transmission_error(*arguments, flank), error_deg))
    for difference, most in differences:
        apart = np.degrees(difference)
        assert np.abs(apart - apart.mean()).max() == pytest.approx(most, rel=0.1)


@pytest.mark.parametrize("function", WITH_RIG)
def test_result_has_the_shape_of_the_angles(function, paper_pair, paper_rig):
    for shape in ((), (0,), (8, 12)):
        found = jax.eval_shape(lambda grid: function(grid, paper_pair, paper_rig), np.zeros(shape))
        assert found.shape == shape
    assert function(3, paper_pair, paper_rig) == function(3.0, paper_pair, paper_rig)


def test_unknown_choices_are_refused_by_name(paper_pair, paper_rig, unchecked):
    for name, choice in (("reference", "zero"), ("pressure_angle", "normal"), ("flank", "C")):
        wrong: dict[str, Any] = {name: choice}
        with pytest.raises(ValueError, match=f"Argument `{name}` must be "):
            transmission_error(0.0, paper_pair, paper_rig, **wrong)
