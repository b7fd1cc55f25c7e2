"""Where the gap is smallest and largest: against a dense grid, in ties, and as pure functions."""

from dataclasses import replace
from fractions import Fraction
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from tests.geometry.pairs import pair_of
from vttig_jax.base.arrays import Numbers
from vttig_jax.base.errors import PairError
from vttig_jax.kinematics.backlash_map import BacklashMap
from vttig_jax.kinematics.exact import exact_model
from vttig_jax.kinematics.first_order import closed_model
from vttig_jax.kinematics.flank_model import FIRST_ORDERS, FlankModel
from vttig_jax.kinematics.functions import backlash, exact_backlash
from vttig_jax.kinematics.harmonic import CombinedModel, OrderModel
from vttig_jax.pair.gear_pair import Drive, Eccentricities, Gear, GearPair

TURN = 2 * np.pi
RIG = np.array([0.0226, 49.5, 0.0273, 79.3, 0.038, 0.02])
"""Eccentricities in mm and their phases in degrees, backlash in degrees, displacement in mm."""

STEPS = np.array([1e-4, 0.1, 1e-4, 0.1, 1e-3, 1e-3])


def exact_map(rig):
    return BacklashMap(exact_model(pair_of(), Eccentricities(*rig)), None, pair_of())


def meshing_map(rig, size=1e-4):
    """The exact relation with a mesh ripple that differs between the flanks: 720 minima compete."""
    exact = exact_model(pair_of(), Eccentricities(*rig))
    cosine = jnp.array([[0.0, 0.2 * size], [size, 0.0]])
    orders = OrderModel(exact.ratio, ((45, 0), (3, 0)), jnp.zeros(2), cosine, cosine[::-1])
    return BacklashMap(CombinedModel(exact.ratio, exact, orders), None, pair_of())


@pytest.fixture(scope="module")
def grid(paper_pair, paper_rig):
    closed = closed_model(paper_pair, paper_rig)
    return BacklashMap(exact_model(paper_pair, paper_rig), closed, paper_pair)


def test_maps_are_the_backlash_of_their_models(grid, paper_pair, paper_rig):
    """One by one, and in pieces for rows of any length."""
    angles = np.linspace(0.0, 120.0, 60).reshape(6, 10)
    found = grid.at(angles)
    assert found.shape == (6, 10)
    np.testing.assert_array_equal(found, exact_backlash(angles, paper_pair, paper_rig))
    assert grid.at(7) == grid.at(7.0)
    without = BacklashMap(grid.model, None, paper_pair)
    for length in (0, 1, 8192, 20_000):
        angles = np.linspace(0.0, 100.0, length)
        found, first = grid.over(angles), grid.first_order_over(angles)
        np.testing.assert_allclose(found, grid.at(angles), rtol=0, atol=1e-15)
        expected = backlash(angles, paper_pair, paper_rig)
        np.testing.assert_allclose(first, expected, rtol=0, atol=1e-16)
        assert np.all(np.isnan(without.first_order_over(angles)))
    assert np.abs(first - found).max() > 1e-8


def test_extremes_lie_where_they_say(grid):
    for extreme in (grid.smallest, grid.largest):
        assert 0.0 <= extreme.driving_angle < 16 * TURN
        wanted = float(grid.at(extreme.driving_angle))
        assert extreme.backlash == pytest.approx(wanted, abs=1e-15)
        first, second = extreme.tooth_pair
        passed = int(extreme.driving_angle / TURN * 45)
        assert first == passed % 45 + 1 and second == passed % 80 + 1
        assert str(extreme).endswith(f"(teeth {first} and {second})")
    text = str(grid)
    assert "16 driving turns" in text and "safe axial closing" in text
    assert f"{np.degrees(grid.smallest.backlash):.5f}°" in text


def test_constant_backlash_alone_has_no_place_of_its_own(paper_pair):
    rig = Eccentricities(constant_backlash_deg=0.05)
    found = BacklashMap(exact_model(paper_pair, rig), None, paper_pair)
    for extreme in (found.smallest, found.largest):
        assert extreme.backlash == pytest.approx(np.radians(0.05), rel=1e-12)


@pytest.mark.parametrize(
    ("teeth", "shares"), [((45, 80), (0.996, 0.998)), ((20, 40), (0.781, 0.880))]
)
def test_share_of_the_largest_possible_variation(teeth, shares):
    """p-p of backlash on the line of action is at most 4 sin α_w (e₁ + e₂) (physics.md §7)."""
    pair = GearPair(Gear(teeth[0]), Gear(teeth[1]), module_mm=2.0, pressure_angles_deg=20.0)
    bound = 4 * np.sin(pair.working_pressure_angles[0]) * 0.04 / pair.base_radii[1, 0]
    reached = []
    for phase in np.arange(0.0, 360.0, 15.0):
        rig = Eccentricities(0.02, float(phase), 0.02, 0.0)
        found = BacklashMap(closed_model(pair, rig), None, pair)
        reached.append((found.largest.backlash - found.smallest.backlash) / bound)
    assert max(reached) <= 1.0
    assert min(reached) == pytest.approx(shares[0], abs=1e-3)
    assert max(reached) == pytest.approx(shares[1], abs=1e-3)


def test_safe_closing_takes_up_the_smallest_gap_and_binds_nowhere(grid, paper_pair, paper_rig):
    safe = grid.safe_closing_mm
    thinning = 2 * np.tan(np.radians(3.0))
    assert safe == pytest.approx(grid.smallest.backlash * 80.0 / thinning, rel=1e-12)
    closed = replace(paper_rig, axial_mm=safe)
    left = BacklashMap(exact_model(paper_pair, closed), None, paper_pair).smallest.backlash
    assert abs(left) < 2e-7
    assert left < 0.01 * grid.smallest.backlash


def test_safe_closing_without_taper_or_geometry(grid, paper_rig):
    untapered = pair_of((0.0, 0.0))
    spur = BacklashMap(exact_model(untapered, paper_rig), None, untapered)
    assert spur.safe_closing_mm == np.inf and "safe axial closing" not in str(spur)
    drive = BacklashMap(grid.model, None, Drive(Fraction(9, 16)))
    assert np.isnan(drive.safe_closing_mm)
    assert drive.smallest.tooth_pair is None
    assert str(drive.smallest).endswith("°")
    assert drive.smallest.backlash == grid.smallest.backlash


def test_a_gap_that_closes_has_no_safe_closing(paper_pair):
    rig = Eccentricities(0.0226, 49.5, 0.0273, 79.3, 0.01)
    found = BacklashMap(exact_model(paper_pair, rig), None, paper_pair)
    assert found.smallest.backlash < 0 and found.safe_closing_mm < 0
    assert "none, because the smallest backlash may already be zero" in str(found)


def test_a_hunting_period_beyond_search_is_said(grid):
    def gap(factor):
        model = jax.tree.map(lambda leaf: factor * leaf, grid.model)
        return BacklashMap(model, None, Drive(Fraction("0.562500001"))).smallest.backlash

    for evaluate in (gap, jax.jit(gap)):
        with pytest.raises(PairError, match="too long to search") as caught:
            evaluate(1.0)
        assert caught.value.where == "drive.ratio"


# Pure functions, and where many minima nearly tie.


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
    if ratio == Fraction(71, 112):  # a grid alone does not tell the turn of the smallest gap
        angle = np.arange(112 * 32 * 45) * (2 * np.pi / (32 * 45))
        lowest = angle[grid.over(angle).argmin()]
        assert abs(lowest - grid.smallest.driving_angle) > np.pi


def test_extremes_of_any_rig(paper_pair):
    """Also where one driving turn is ten driven turns: the grid follows the faster shaft."""
    fast = GearPair(Gear(200), Gear(20), module_mm=1.0, pressure_angles_deg=20.0)
    rigs: list[tuple[GearPair, Any]] = [(fast, (0.001, 10.0, 0.03, 100.0, 0.5))]
    for seed in range(4):
        draw = np.random.default_rng(seed)
        rigs.append((paper_pair, draw.uniform([0.01, 0, 0.01, 0, 0.02], [0.1, 360, 0.1, 360, 0.1])))
    for pair, numbers in rigs:
        grid = BacklashMap(exact_model(pair, Eccentricities(*numbers)), None, pair)
        low, high = searched(grid, -1), searched(grid, 1)
        assert grid.smallest.backlash == pytest.approx(low, abs=1e-12 * (high - low))
        assert grid.largest.backlash == pytest.approx(high, abs=1e-12 * (high - low))


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
        return BacklashMap(closed_model(pair, Eccentricities(*rig)), None, pair).smallest

    angle = extreme(RIG).driving_angle
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
    found = jax.grad(lambda rig: extreme(rig).backlash)(RIG)
    np.testing.assert_allclose(found, expected, rtol=1e-6)


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
