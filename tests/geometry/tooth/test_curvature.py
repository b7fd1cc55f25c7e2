"""Curvatures against those known: involute, base helix, cylinders, an arc, and differences."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from tests.geometry.surface_teeth import between, crowned, tooth, without_taper
from vttig_jax.geometry.tooth.curvature import _principal, surface_curvatures
from vttig_jax.geometry.tooth.rack_cutter import SIDES
from vttig_jax.geometry.tooth.recession import Taper
from vttig_jax.geometry.tooth.roll_limits import fillet_span, flank_roll, flank_span
from vttig_jax.geometry.tooth.surface import surface_normal, tooth_surface

each_side = pytest.mark.parametrize("side", SIDES)
RADII = np.array([43.8, 45.0, 46.5])
CURVED = tooth(recession=(crowned(0.05, 0.2), crowned(0.03, -0.1)))


@each_side
def test_section_of_a_straight_flank_is_an_involute(side):
    """1/κ = √(r² − r_b²), convex; nothing along the axis."""
    gear = without_taper(tooth())
    found = surface_curvatures(gear, flank_roll(gear, RADII, side), 2.0, side=side)
    base = gear.base_radii[SIDES.index(side)]
    np.testing.assert_allclose(1 / found.principal[:, 0], np.sqrt(RADII**2 - base**2), rtol=1e-11)
    np.testing.assert_allclose(found.principal[:, 1], 0.0, atol=1e-13)


@each_side
def test_tapered_flank_is_an_involute_helicoid(side):
    """It is developable, with 1/κ = √(r² − r_b²)/cos β_b and tan β_b = tan β cos αₜ."""
    gear, index = tooth(), SIDES.index(side)
    found = surface_curvatures(gear, flank_roll(gear, RADII, side), -6.0, side=side)
    base, alpha = gear.base_radii[index], gear.pressure_angles[index]
    base_helix = math.atan(math.tan(math.radians([3.0, 2.0][index])) * math.cos(alpha))
    wanted = np.sqrt(RADII**2 - base**2) / math.cos(base_helix)
    np.testing.assert_allclose(1 / found.principal[:, 0], wanted, rtol=1e-10)
    assert np.abs(found.gaussian).max() < 1e-12
    np.testing.assert_allclose(2 * found.mean, 1 / wanted, rtol=1e-10)


@each_side
def test_crowning_bends_the_flank_along_the_axis(side):
    """Spur and crowned: δ″ = 8 c/b² at the middle, seen along the normal, which leans by αₜ(r)."""
    gear = tooth(recession=(crowned(0.0, 0.2), crowned(0.0, 0.2)))
    found = surface_curvatures(gear, flank_roll(gear, RADII, side), 0.0, side=side)
    # The flank turns by δ/R about the axis; the normal has the arm r_b.
    base = gear.base_radii[SIDES.index(side)]
    np.testing.assert_allclose(found.principal[:, 1], 8 * 0.2 / 20**2 * base / 45.0, rtol=1e-10)
    sections = surface_curvatures(
        without_taper(gear), flank_roll(gear, RADII, side), 0.0, side=side
    )
    np.testing.assert_allclose(found.principal[:, 0], sections.principal[:, 0], rtol=1e-10)


@pytest.mark.parametrize(("part", "radius"), [("root", 42.5), ("tip", 47.0)])
def test_lands_are_cylinders(part, radius):
    found = surface_curvatures(CURVED, 0.03, np.array([-5.0, 5.0]), part=part)
    np.testing.assert_allclose(found.principal, [[1 / radius, 0.0]] * 2, rtol=1e-11, atol=1e-13)


@each_side
def test_fillet_is_hollow(side):
    gear = without_taper(tooth())
    roll = between(fillet_span(gear, side), 5)
    found = surface_curvatures(gear, roll, 0.0, side=side, part="fillet")
    np.testing.assert_allclose(found.principal[:, 0], 0.0, atol=1e-12)
    # At the root: ρ + (h − ρ)²/(R + h − ρ), h the depth of the cutter, as tooth root stress has it.
    deep = 2.5 - 0.6
    assert -1 / found.principal[0, 1] == pytest.approx(0.6 + deep**2 / (45.0 + deep), rel=1e-10)


@each_side
@pytest.mark.parametrize("part", ["flank", "fillet"])
def test_forms_are_those_of_differences(side, part):
    span = (fillet_span if part == "fillet" else flank_span)(CURVED, side)
    place = jnp.array([span[0] + 0.4 * (span[1] - span[0]), 3.0])
    found = surface_curvatures(CURVED, place[0], place[1], side=side, part=part)
    step = np.array([2e-5, 2e-3])

    def point(*units):
        roll, z = place + step * np.array(units)
        return np.asarray(tooth_surface(CURVED, roll, z, side=side, part=part))

    def normal(*units):
        roll, z = place + step * np.array(units)
        return np.asarray(surface_normal(CURVED, roll, z, side=side, part=part))

    along = np.array([point(1, 0) - point(-1, 0), point(0, 1) - point(0, -1)]) / (2 * step[:, None])
    turns = np.array([normal(1, 0) - normal(-1, 0), normal(0, 1) - normal(0, -1)])
    first, second = along @ along.T, (turns / (2 * step[:, None])) @ along.T
    np.testing.assert_allclose(found.first, first, rtol=1e-6, atol=1e-6)
    # Weingarten: −n · Xᵢⱼ = nᵢ · Xⱼ
    np.testing.assert_allclose(found.second, second, rtol=1e-6, atol=1e-6)
    shape = np.linalg.solve(first, second)
    wanted = np.sort(np.linalg.eigvals(shape).real)[::-1]
    np.testing.assert_allclose(found.principal, wanted, rtol=1e-5, atol=1e-8)
    assert abs(found.gaussian) > 1e-5  # not developable: the comparison has something to see


def test_shape_and_gradient():
    roll, z = between(flank_span(CURVED, "left"), 3)[:, None], np.array([0.0, 4.0])
    found = surface_curvatures(CURVED, roll, z)
    assert found.first.shape == found.second.shape == (3, 2, 2, 2)
    assert found.principal.shape == (3, 2, 2)
    assert np.all(found.principal[..., 0] >= found.principal[..., 1])

    def smallest(crowning):
        gear = tooth(recession=(crowned(0.0, crowning), Taper(0.0)))
        return surface_curvatures(gear, 0.0, 0.0).principal[1]

    radius = float(tooth().base_radii[0])
    assert jax.jit(jax.grad(smallest))(0.1) == pytest.approx(8 / 20**2 * radius / 45.0, rel=1e-9)


def test_principal_curvatures_that_are_equal_have_a_gradient():
    """Where the two are one, as on a sphere, the derivative is finite."""
    form = jnp.eye(2)
    value, slope = jax.value_and_grad(lambda size: _principal(form, size * form).sum())(0.3)
    assert (value, slope) == (pytest.approx(0.6), pytest.approx(2.0))
