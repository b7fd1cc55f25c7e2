"""The smallest and the largest gap as pure functions, and where many minima nearly tie."""

from dataclasses import replace
from fractions import Fraction

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from vttig_jax.base.arrays import Numbers
from vttig_jax.base.errors import PairError
from vttig_jax.kinematics.backlash_map import BacklashMap
from vttig_jax.kinematics.exact import exact_model
from vttig_jax.kinematics.first_order import closed_model
from vttig_jax.kinematics.flank_model import FIRST_ORDERS, FlankModel
from vttig_jax.kinematics.harmonic import CombinedModel, OrderModel
from vttig_jax.pair.gear_pair import Drive, Eccentricities, Gear, GearPair

RIG = np.array([0.0226, 49.5, 0.0273, 79.3, 0.038, 0.02])
"""Eccentricities in mm and their phases in degrees, backlash in degrees, displacement in mm."""

STEPS = np.array([1e-4, 0.1, 1e-4, 0.1, 1e-3, 1e-3])


def pair_of(helix_deg=3.0):
    gears = Gear(45, helix_deg, helix_deg), Gear(80, helix_deg, helix_deg)
    return GearPair(*gears, module_mm=2.0, pressure_angles_deg=20.0, centre_distance_mm=125.12)


def exact_map(rig):
    return BacklashMap(exact_model(pair_of(), Eccentricities(*rig)), None, pair_of())


def meshing_map(rig):
    """The exact relation with a mesh ripple, so that 720 minima compete."""
    exact = exact_model(pair_of(), Eccentricities(*rig))
    cosine = jnp.array([[0.0, 2e-5], [1e-4, 0.0]])
    orders = OrderModel(exact.ratio, ((45, 0), (3, 0)), jnp.zeros(2), cosine, cosine[::-1])
    return BacklashMap(CombinedModel(exact.ratio, exact, orders), None, pair_of())


def smallest(rig):
    return exact_map(rig).smallest.backlash


def central(function, at, steps):
    """Richardson's central differences by every entry of `at`."""

    def differences(share):
        moves = share * np.diag(steps)
        return [(function(at + by) - function(at - by)) / (2 * share) for by in moves]

    coarse, fine = (np.array(differences(share)) for share in (1.0, 0.5))
    return (4 * fine - coarse) / 3 / steps.reshape(-1, *(1,) * (fine.ndim - 1))


def orders_of(terms, ratio, seed, sizes):
    draw = np.random.default_rng(seed)
    cosine, sine = (jnp.asarray(draw.normal(size=(2, len(terms))) * sizes) for _ in range(2))
    model = OrderModel(jnp.asarray(float(ratio)), terms, jnp.array([0.0, 1e-3]), cosine, sine)
    return BacklashMap(model, None, Drive(ratio))


def searched(grid, sense):
    """The extreme by 100 points a period and fine grids around the 500 best of them."""
    width = 2 * np.pi / (100 * np.ceil(grid.model.highest_order))
    angle = np.arange(round(grid.pair.hunting_turns * 2 * np.pi / width)) * width
    best = angle[np.argsort(-sense * grid.over(angle))[:500]]
    for zoom in width / 20.0 ** np.arange(4):
        around = best[:, None] + zoom * np.linspace(-1, 1, 41)
        height = sense * grid.over(around.ravel()).reshape(around.shape)
        best = np.take_along_axis(around, height.argmax(1)[:, None], 1)[:, 0]
    return sense * (sense * grid.over(best)).max()


NEAR = ((45, 0), (44, 0), (1, 0), (0, 1))
"""Two mesh orders beat: the minima of all turns differ by the small first orders only."""


@pytest.mark.parametrize(
    ("terms", "sizes", "ratio"),
    [
        (NEAR, (1e-4, 1e-4, 1e-7, 1e-7), Fraction(71, 112)),
        (NEAR, (1e-4, 1e-4, 1e-7, 1e-7), Fraction(9, 116)),
        (((45, 0), (1, 0), (0, 1)), (1e-4, 1e-9, 1e-9), Fraction(9, 16)),
        (((7, 0), (13, 1), (0, 1), (1, -1)), (1e-4, 1e-4, 1e-8, 1e-8), Fraction(303, 313)),
        (((1, 0), (2, 0), (0, 1), (0, 3)), (1e-4,) * 4, Fraction(7, 325)),
    ],
)
def test_extremes_where_minima_nearly_tie(terms, sizes, ratio):
    grid = orders_of(terms, ratio, 5, np.array(sizes))
    low, high = searched(grid, -1), searched(grid, 1)
    tolerance = 1e-12 * (high - low)
    assert grid.smallest.backlash == pytest.approx(low, abs=tolerance)
    assert grid.largest.backlash == pytest.approx(high, abs=tolerance)


def test_a_grid_alone_does_not_tell_the_turn_of_the_smallest_gap():
    grid = orders_of(NEAR, Fraction(71, 112), 5, np.array([1e-4, 1e-4, 1e-7, 1e-7]))
    angle = np.arange(112 * 32 * 45) * (2 * np.pi / (32 * 45))
    lowest = angle[grid.over(angle).argmin()]
    assert abs(lowest - grid.smallest.driving_angle) > np.pi


class Kinked(FlankModel):
    """A gap of 1 mrad + 1 mrad |sin(φ₁ − place)|, whose smallest value is a kink."""

    ratio: Numbers
    place: jax.Array

    @property
    def grid_orders(self):
        return FIRST_ORDERS

    def transmission_error(self, driving_angle, flank):
        shape = jnp.abs(jnp.sin(jnp.asarray(driving_angle) - self.place))
        return 1e-3 * (1 + shape) if flank == "B" else 0 * shape


def test_a_kink_is_found_too():
    grid = BacklashMap(Kinked(jnp.asarray(0.5), jnp.asarray(1.234)), None, Drive(Fraction(1, 2)))
    assert grid.smallest.backlash == pytest.approx(1e-3, abs=1e-11)
    assert grid.smallest.driving_angle % np.pi == pytest.approx(1.234, abs=1e-8)
    assert grid.largest.backlash == pytest.approx(2e-3, abs=1e-18)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("made", "name"),
    [(exact_map, "largest"), (meshing_map, "smallest")],
    ids=["exact", "meshing"],
)
def test_gradient_is_that_of_differences(made, name):
    def extreme(rig):
        return getattr(made(rig), name).backlash

    found = np.asarray(jax.jit(jax.grad(extreme))(RIG))
    expected = central(lambda rig: float(extreme(rig)), RIG, STEPS)
    np.testing.assert_allclose(found * STEPS, expected * STEPS, rtol=1e-6, atol=1e-13)
    assert np.all(np.abs(found * STEPS) > 1e-9)


def test_gradient_of_a_first_order_pair_has_a_closed_form():
    """j = j_c + 2 K sin α [e₂ cos χ₂ − e₁ cos ψ₁] − s (tan β_L + tan β_R)/R₂ at a fixed angle."""
    pair = pair_of()

    def extreme(rig):
        return BacklashMap(closed_model(pair, Eccentricities(*rig)), None, pair).smallest.backlash

    angle = BacklashMap(closed_model(pair, Eccentricities(*RIG)), None, pair).smallest.driving_angle
    scale = 2 * np.sin(pair.working_pressure_angles[0]) / pair.base_radii[1, 0]
    first, second = np.radians(RIG[[1, 3]]) + angle * np.array([1.0, 9 / 16])
    expected = [
        -scale * np.cos(first),
        scale * RIG[0] * np.sin(first) * np.pi / 180,
        scale * np.cos(second),
        -scale * RIG[2] * np.sin(second) * np.pi / 180,
        np.pi / 180,
        -2 * np.tan(np.radians(3.0)) / 80.0,
    ]
    np.testing.assert_allclose(jax.grad(extreme)(RIG), expected, rtol=1e-6)


@pytest.mark.slow
def test_second_derivatives_contain_the_motion_of_the_place():
    slope, bend = jax.jit(jax.grad(smallest)), jax.jit(jax.hessian(smallest))
    found, expected = np.asarray(bend(RIG)), central(slope, RIG, STEPS)
    size = np.outer(STEPS, STEPS)
    np.testing.assert_allclose(found * size, expected * size, rtol=1e-6, atol=1e-14)
    angle = exact_map(RIG).smallest.driving_angle

    def fixed(rig):
        return exact_map(rig).at(angle)

    still = jax.jit(jax.hessian(fixed))(RIG)
    assert np.max(np.abs((found - still) * size)) > 100 * np.max(np.abs((found - expected) * size))


@pytest.mark.slow
def test_the_place_moves_as_differences_say():
    def place(rig):
        return exact_map(rig).smallest.driving_angle

    found = np.asarray(jax.jit(jax.grad(place))(RIG))
    expected = central(lambda rig: float(jax.jit(place)(rig)), RIG, STEPS)
    np.testing.assert_allclose(found * STEPS, expected * STEPS, rtol=1e-5, atol=1e-9)
    assert np.abs(found[1]) > 1e-3


@pytest.mark.slow
def test_a_batch_of_rigs_is_a_loop():
    draw = np.random.default_rng(0)
    rigs = RIG * (1 + 0.1 * draw.normal(size=(6, len(RIG))))

    def extremes(rig):
        grid = meshing_map(rig)
        return grid.smallest, grid.largest, grid.safe_closing_mm

    batch = jax.jit(jax.vmap(extremes))(rigs)
    for lane, rig in enumerate(rigs):
        low, high, closing = extremes(rig)
        for found, alone in zip(batch[:2], (low, high), strict=True):
            assert float(found.backlash[lane]) == pytest.approx(alone.backlash, abs=1e-15)
            angle = float(found.driving_angle[lane])
            assert angle == pytest.approx(alone.driving_angle, abs=1e-6)
            assert alone.tooth_pair is not None
            assert [int(tooth[lane]) for tooth in found.tooth_pair] == list(alone.tooth_pair)
        assert float(batch[2][lane]) == pytest.approx(closing, rel=1e-12)
    assert np.ptp(batch[0].backlash) > 1e-5


@pytest.mark.slow
def test_every_number_of_a_model_may_be_traced():
    """Also the ratio: the number of grid points follows from the teeth."""
    grid = meshing_map(RIG)
    traced = eqx.filter_jit(lambda model: replace(grid, model=model).smallest)
    found = traced(grid.model)
    assert str(found) == str(grid.smallest)
    slopes = eqx.filter_grad(lambda model: replace(grid, model=model).smallest.backlash)
    offset = eqx.filter_jit(slopes)(grid.model).orders.offset
    np.testing.assert_allclose(offset, [-1.0, 1.0], rtol=1e-3)


def test_a_known_map_in_a_traced_program_leaves_nothing_behind():
    grid = exact_map(RIG)
    found = jax.jit(lambda factor: factor * grid.smallest.backlash)(2.0)
    assert isinstance(grid.smallest.backlash, float)
    assert float(found) == pytest.approx(2 * grid.smallest.backlash, abs=1e-15)


def test_safe_closing_by_the_helix_angle():
    def closing(helix_deg):
        rig = Eccentricities(*RIG)
        return BacklashMap(
            exact_model(pair_of(helix_deg), rig), None, pair_of(helix_deg)
        ).safe_closing_mm

    slope = (closing(3.001) - closing(2.999)) / 0.002
    assert float(jax.jit(jax.grad(closing))(3.0)) == pytest.approx(slope, rel=1e-6)
    assert slope < -1e-3


def test_a_long_hunting_period_is_said_where_numbers_are_traced():
    endless = Drive(Fraction("0.562500001"))

    def gap(rig):
        return BacklashMap(exact_map(rig).model, None, endless).smallest.backlash

    with pytest.raises(PairError) as caught:
        jax.jit(gap)(RIG)
    assert caught.value.where == "drive.ratio"
