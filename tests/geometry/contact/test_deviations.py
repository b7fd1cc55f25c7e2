"""Maps of flank deviations: splines of SciPy evaluated in JAX, and what stops with a sentence."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.interpolate import CubicSpline, RectBivariateSpline

from vttig_jax.base.errors import PairError
from vttig_jax.geometry.deviations import Deviations, FlankMap

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
