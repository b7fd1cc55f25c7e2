"""The public surface functions: shapes, normals, derivatives, wrong arguments."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from tests.geometry.surface_teeth import between, crowned, tooth, wave
from tests.laws import checks, table
from vttig_jax.geometry.surface import fillet_span, flank_span, tooth_surface
from vttig_jax.geometry.tooth import SIDES

GEAR = tooth(recession=(crowned(0.05, 0.03), wave))
HEIGHTS = np.array([-9.0, -2.0, 0.5, 8.0])
each_side = pytest.mark.parametrize("side", SIDES)


def rolls(gear, side, part, count=5):
    """Roll angles between the limits of a part."""
    if part in ("root", "tip"):
        span = (-0.02, 0.03)
    else:
        span = (fillet_span if part == "fillet" else flank_span)(gear, side)
    return between(span, count)[:, None]


def difference(gear, side, part, roll, z, step_roll, step_z):
    """Central difference of the points along a step."""
    ends = (
        np.asarray(
            tooth_surface(gear, roll + way * step_roll, z + way * step_z, side=side, part=part)
        )
        for way in (1, -1)
    )
    return np.subtract(*ends) / 2


def test_shapes_broadcast():
    assert tooth_surface(GEAR, 0.0, 0.0).shape == (3,)
    assert tooth_surface(GEAR, np.zeros((4, 1)), HEIGHTS).shape == (4, 4, 3)
    assert tooth_surface(GEAR, np.zeros((5, 2, 1)), 1).shape == (5, 2, 1, 3)
    np.testing.assert_array_equal(tooth_surface(GEAR, 0.1, HEIGHTS)[:, 2], HEIGHTS)


def test_a_section_knows_nothing_of_the_others():
    grid = tooth_surface(GEAR, rolls(GEAR, "right", "fillet"), HEIGHTS, side="right", part="fillet")
    for place, z in enumerate(HEIGHTS):
        alone = tooth_surface(
            GEAR, rolls(GEAR, "right", "fillet")[:, 0], z, side="right", part="fillet"
        )
        np.testing.assert_allclose(grid[:, place], alone, rtol=0, atol=1e-13)


@each_side
def test_recession_turns_the_section(side):
    """δ moves flank and fillet round the axis by δ/R and nothing else."""
    index, sense = SIDES.index(side), (-1.0 if side == "left" else 1.0)
    for part in ("fillet", "flank"):
        roll = rolls(GEAR, side, part)
        points = np.asarray(tooth_surface(GEAR, roll, HEIGHTS, side=side, part=part))
        radius = np.hypot(points[..., 0], points[..., 1])
        np.testing.assert_allclose(radius, radius[:, :1] + 0 * radius, rtol=1e-14)
        clockwise = np.arctan2(points[..., 0], points[..., 1]) * sense
        recession = np.asarray(GEAR.recessions(HEIGHTS))[:, index]
        turned = clockwise + recession / 45.0
        np.testing.assert_allclose(turned, turned[:, :1] + 0 * turned, rtol=0, atol=1e-15)


def test_a_plain_function_will_do():
    """The surface can be jitted and differentiated in z."""
    gear = tooth(recession=(wave, lambda z: 0.02 + 0.0 * z))
    right = tooth_surface(gear, 0.05, HEIGHTS, side="right")
    np.testing.assert_allclose(right[:, :2], right[:1, :2] + np.zeros((4, 2)), rtol=1e-14)
    slope = jax.jacfwd(lambda z: tooth_surface(gear, -0.1, z))(2.0)
    step = np.asarray(tooth_surface(gear, -0.1, 2.0 + 1e-5) - tooth_surface(gear, -0.1, 2.0 - 1e-5))
    np.testing.assert_allclose(slope, step / 2e-5, rtol=0, atol=1e-9)


def test_many_teeth_at_once():
    """A batch of teeth over shift and helix angle, and the gradient of a thickness in them."""

    def point(shift, slope):
        gear = tooth(profile_shift_mm=shift, recession=(crowned(slope, 0.0), wave))
        return tooth_surface(gear, -0.02, 5.0)

    shifts, slopes = jnp.array([0.0, 0.3]), jnp.array([0.05, 0.02])
    batch = jax.vmap(point)(shifts, slopes)
    for place in range(2):
        np.testing.assert_allclose(batch[place], point(shifts[place], slopes[place]), rtol=1e-13)
    forward = jax.jacfwd(point, (0, 1))(0.3, 0.05)
    backward = jax.jacrev(point, (0, 1))(0.3, 0.05)
    np.testing.assert_allclose(np.array(forward), np.array(backward), rtol=0, atol=1e-14)
    assert np.abs(np.array(forward)[:, :2]).min() > 1e-3


def test_arguments_that_are_none(unchecked):
    with pytest.raises(ValueError, match='`part` must be "root", "fillet", "flank" or "tip", but'):
        tooth_surface(GEAR, 0.0, 0.0, part="land")  # pyright: ignore[reportArgumentType]
    with pytest.raises(ValueError, match='`side` must be "left" or "right", but is \'A\''):
        tooth_surface(GEAR, 0.0, 0.0, side="A")  # pyright: ignore[reportArgumentType]


@pytest.mark.parametrize("law", table.SURFACES, ids=str)
def test_new_values_compile_nothing(law):
    checks.check_one_trace(law.function, law.arguments)


def test_numbers_inside_a_tooth_are_traced():
    """New teeth of the same number compile nothing."""
    tooth_surface(tooth(33), 0.0, 1.0)
    with checks.compilations() as seen:
        tooth_surface(tooth(33, module_mm=3.0, profile_shift_mm=0.1), 0.1, 2.0)
    assert not seen
    with checks.compilations() as seen:
        tooth_surface(tooth(34), 0.1, 2.0)
    assert seen


def test_double_precision_comes_out_of_whole_numbers():
    found = tooth_surface(eqx.tree_at(lambda g: g.module_mm, GEAR, np.float64(2)), 0, 1)
    assert found.dtype == np.float64
