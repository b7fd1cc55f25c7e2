"""Maps of flank deviations: splines of SciPy evaluated in JAX, and what stops with a sentence."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.interpolate import CubicSpline, RectBivariateSpline

from tests.geometry.pairs import FLANKS, pair_of
from vttig_jax.base.errors import PairError
from vttig_jax.geometry.contact import contact_model
from vttig_jax.geometry.deviations import Deviations, FlankMap
from vttig_jax.kinematics.exact import exact_model
from vttig_jax.pair.gear_pair import Eccentricities, Flank

ROLL = np.array([8.0, 10.0, 13.5, 15.0, 19.0, 22.0])
HEIGHT = np.array([-9.0, -4.0, 0.5, 3.0, 9.5])
DRAWN = np.random.default_rng(3).normal(size=(6, 5))
PLACES = np.random.default_rng(4).uniform([7.0, -11.0], [24.0, 11.0], size=(200, 2)).T


def inside(places=PLACES):
    return np.clip(places[0], 8.0, 22.0), np.clip(places[1], -9.0, 9.5)


def test_it_is_the_bicubic_spline_of_scipy():
    """`RectBivariateSpline` interpolates with the same not-a-knot ends, by another basis."""
    found = FlankMap(ROLL, HEIGHT, DRAWN).prepared()(*inside())
    expected = RectBivariateSpline(ROLL, HEIGHT, DRAWN)(*inside(), grid=False)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12)
    one_off = DRAWN + 1e-6 * (np.arange(30) == 17).reshape(6, 5)
    other = RectBivariateSpline(ROLL, HEIGHT, one_off)(*inside(), grid=False)
    assert np.abs(np.asarray(found) - other).max() > 1e-7  # the comparison can fail


def test_beyond_its_points_it_keeps_the_value_at_the_edge():
    bicubic = FlankMap(ROLL, HEIGHT, DRAWN).prepared()
    outside = (PLACES[0] < 8.0) | (PLACES[0] > 22.0) | (np.abs(PLACES[1]) > 9.0)
    assert outside.any()
    np.testing.assert_allclose(bicubic(*PLACES), bicubic(*inside()), rtol=0, atol=1e-12)


@pytest.mark.parametrize("count", [2, 3, 4])
def test_few_points_make_a_line_or_a_parabola(count):
    roll = ROLL[:count]
    values = DRAWN[:count, :2]
    found = FlankMap(roll, HEIGHT[:2], values).prepared()(
        np.array([9.0, 9.5]), np.array([-9.0] * 2)
    )
    np.testing.assert_allclose(found, CubicSpline(roll, values[:, 0])([9.0, 9.5]), atol=1e-13)


def test_derivatives_in_place_and_in_the_measured_values():
    places = np.array([9.0, 14.2, 21.0]), np.array([-5.0, 0.7, 9.0])

    def value(roll, z, drawn):
        return FlankMap(ROLL, HEIGHT, drawn).prepared()(roll, z)

    moved = tuple(jnp.ones(3) for _ in range(2))
    _, slope = jax.jvp(lambda roll, z: value(roll, z, DRAWN), places, moved)
    spline = RectBivariateSpline(ROLL, HEIGHT, DRAWN)
    roll, z = places
    expected = spline(roll, z, dx=1, grid=False)
    expected += spline(roll, z, dy=1, grid=False)
    np.testing.assert_allclose(slope, expected, rtol=1e-11)
    gradient = jax.jit(jax.jacrev(lambda drawn: value(*places, drawn)))(jnp.asarray(DRAWN))
    unit = (np.arange(30) == 13).reshape(6, 5)
    weight = RectBivariateSpline(ROLL, HEIGHT, unit)(roll, z, grid=False)
    np.testing.assert_allclose(gradient[:, 2, 3], weight, rtol=0, atol=1e-13)


BAD = {
    "folded": (
        (ROLL[::-1], HEIGHT, DRAWN),
        "roll_mm: the map goes from 22 to 19 mm at points 1 and 2",
    ),
    "one row": ((ROLL[:1], HEIGHT, DRAWN[:1]), r"roll_mm: the shape is \(1,\); give two or more"),
    "transposed": ((ROLL, HEIGHT, DRAWN.T), r"map has shape \(5, 6\) over 6 roll lengths and 5"),
    "hole": (
        (ROLL, HEIGHT, np.where(np.arange(30).reshape(6, 5) == 11, np.nan, DRAWN)),
        r"deviation_um: point \(3, 2\) is not a number",
    ),
    "no height": ((ROLL, [np.inf, 1.0], DRAWN), r"z_mm: point \(1,\) is not a number"),
}


def test_maps_that_are_none(unchecked):
    for name in BAD:
        values, sentence = BAD[name]
        with pytest.raises(PairError, match=sentence):
            FlankMap(*values)


def test_knots_are_no_free_numbers(unchecked):
    with pytest.raises(ValueError, match="`roll_mm` must be known numbers, but is traced"):
        jax.jit(lambda roll: FlankMap(roll, HEIGHT, DRAWN).prepared().roll)(ROLL)


def test_it_prints_what_is_there():
    text = str(
        Deviations(
            driving=(FlankMap(ROLL, HEIGHT, DRAWN), None),
            driven_pitch_um=np.array([[0.0, 1.0], [2.0, 3.0]]),
        )
    )
    assert f"driving flank A  6 × 5 points, {DRAWN.min():.2f} … {DRAWN.max():.2f} µm" in text
    assert "driven pitch B   2 teeth, 2.00 … 3.00 µm" in text and "driving flank B" not in text
    assert str(Deviations()).splitlines()[1].split() == ["none", "–"]


def test_what_is_given_is_found():
    one = FlankMap(ROLL, HEIGHT, DRAWN)
    assert Deviations().maps == ()
    assert len(Deviations(driving=(one, None), driven=(None, one)).maps) == 2


# Flanks that deviate: by a constant, along the profile, on a single tooth.


PAIR, SPUR = pair_of(), pair_of((0.0, 0.0))
BASE = np.asarray(PAIR.base_radii)[:, 0]
PITCH = 2 * math.pi / 45
ANGLES = np.linspace(-2.0, 2.0, 33) * PITCH
SHIFTED = Eccentricities(axial_mm=0.2)
FLAT = np.array([5.0, 35.0]), np.array([-10.0, 10.0]), np.ones((2, 2))


def flat(um: float) -> FlankMap:
    return FlankMap(FLAT[0], FLAT[1], um * FLAT[2])


def deviations(driving=(0.0, 0.0), driven=(0.0, 0.0), pitches=None) -> Deviations:
    """Constant deviations of flank A and B in µm: always every part, which is compiled once."""
    own = {"driving": np.zeros((2, 45)), "driven": np.zeros((2, 80))} | (pitches or {})
    return Deviations(
        driving=(flat(driving[0]), flat(driving[1])),
        driven=(flat(driven[0]), flat(driven[1])),
        driving_pitch_um=own["driving"],
        driven_pitch_um=own["driven"],
    )


def errors(flank: Flank, given: Deviations, pair=PAIR, rig=SHIFTED) -> np.ndarray:
    model = contact_model(pair, rig, deviations=given, sections=3)
    return np.asarray(model.transmission_error(ANGLES, flank))


@pytest.mark.slow
def test_no_deviation_is_the_exact_relation_and_an_eccentric_gear_feels_one():
    """The driven centre moves on with φ₂: the step is not the same all around, by e/R."""
    drawn = math.degrees(float(PAIR.drawing_backlash))
    assert contact_model(PAIR, deviations=deviations()).highest_order == 45.0
    rig = Eccentricities(0.0226, 49.5, 0.0273, 79.3, drawn, axial_mm=0.2)
    for flank in FLANKS:
        found = errors(flank, deviations(), rig=rig)
        exact = exact_model(PAIR, rig).transmission_error(ANGLES, flank)
        np.testing.assert_allclose(found, exact, rtol=0, atol=1e-14)
    step = errors("A", deviations((7.0, 0.0)), rig=rig) - errors("A", deviations(), rig=rig)
    apart = np.abs(step / (7e-3 / BASE[1]) - 1).max()
    assert 1e-5 < apart < 2 * 0.0273 / BASE[1]


@pytest.mark.slow
def test_a_constant_deviation_turns_the_contact_by_itself_over_the_base_radius():
    """Of both gears they add; each flank feels its own alone."""
    both = deviations((4.0, 2.0), (3.0, 1.0))
    for flank, total in zip(FLANKS, (7e-3, -3e-3), strict=True):
        moved = errors(flank, both) - errors(flank, deviations())
        np.testing.assert_allclose(moved, total / BASE[1], rtol=0, atol=1e-15)


@pytest.mark.slow
def test_a_single_tooth_shows_where_it_is_in_mesh():
    """Tooth 1 is between the axes at φ = 0; it carries alone while it stands out."""
    for flank in FLANKS:
        for gear in ("driving", "driven"):
            pitch = np.zeros((2, 45 if gear == "driving" else 80))
            tooth = (
                0 if gear == "driving" or flank == "A" else 1
            )  # flank B meets the driven tooth ahead
            pitch[:, tooth] = 5.0
            true = errors(flank, deviations(), SPUR)
            rise = (errors(flank, deviations(pitches={gear: pitch}), SPUR) - true) * BASE[1] * 1e3
            rise *= 1 if flank == "A" else -1
            ratio = float(SPUR.contact_ratios[0])
            full = np.abs(rise - 5.0) < 1e-9
            assert full.sum() == pytest.approx(ratio * 8, abs=1)  # 8 angles a pitch
            assert rise.min() > -1e-9  # before and after, its tip edge still carries
            assert np.abs(ANGLES[full]).max() < 1.2 * PITCH
            far = np.abs(ANGLES) > 1.7 * PITCH
            np.testing.assert_allclose(rise[far], 0.0, atol=1e-9)
            # One that stays behind leaves the load to its neighbours where they nearly mesh.
            fall = errors(flank, deviations(pitches={gear: -pitch}), SPUR) - true
            fall *= BASE[1] * 1e3 * (1 if flank == "A" else -1)
            assert (
                1
                <= (np.abs(fall + 5.0) < 1e-9).sum()
                <= (fall < -1e-9).sum()
                <= (2 - ratio) * 8 + 1
            )
            assert np.abs(fall).max() < 5.0 + 1e-9
