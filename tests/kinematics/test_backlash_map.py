"""Where the gap is smallest and largest, against a dense grid."""

from dataclasses import replace
from fractions import Fraction

import jax.numpy as jnp
import numpy as np
import pytest

from vttig_jax.base.errors import PairError
from vttig_jax.kinematics.backlash_map import BacklashMap
from vttig_jax.kinematics.exact import exact_model
from vttig_jax.kinematics.first_order import closed_model
from vttig_jax.kinematics.functions import backlash, exact_backlash
from vttig_jax.kinematics.harmonic import CombinedModel, OrderModel
from vttig_jax.pair.gear_pair import Drive, Eccentricities, Gear, GearPair

TURN = 2 * np.pi


@pytest.fixture(scope="module")
def grid(paper_pair, paper_rig):
    closed = closed_model(paper_pair, paper_rig)
    return BacklashMap(exact_model(paper_pair, paper_rig), closed, paper_pair)


def with_mesh(pair, rig, size):
    """The exact relation with a mesh ripple that differs between the flanks."""
    exact = exact_model(pair, rig)
    cosine = jnp.asarray([[0.0, 0.2 * size], [size, 0.0]])
    orders = OrderModel(
        ratio=exact.ratio,
        terms=((pair.driving.teeth, 0), (3, 0)),
        offset=jnp.zeros(2),
        cosine=cosine,
        sine=cosine[::-1],
    )
    return CombinedModel(ratio=exact.ratio, exact=exact, orders=orders)


def dense(model, turns, per_turn):
    """Extremes over an even grid by nothing but evaluation."""
    angles = np.arange(turns * per_turn) * (TURN / per_turn)
    gaps = BacklashMap(model, None, Drive(Fraction(9, 16))).over(angles)
    return gaps.min(), angles[gaps.argmin()], gaps.max(), angles[gaps.argmax()]


def test_at_is_the_backlash_of_the_model(grid, paper_pair, paper_rig):
    angles = np.linspace(0.0, 120.0, 60).reshape(6, 10)
    found = grid.at(angles)
    assert found.shape == (6, 10)
    np.testing.assert_array_equal(found, exact_backlash(angles, paper_pair, paper_rig))
    assert grid.at(7) == grid.at(7.0)


@pytest.mark.parametrize("length", [0, 8193])
def test_over_equals_at_for_any_length(grid, length):
    angles = np.linspace(0.0, 100.0, length)
    np.testing.assert_allclose(grid.over(angles), grid.at(angles), rtol=0, atol=1e-15)


def test_first_order_map_stands_beside(grid, paper_pair, paper_rig):
    angles = np.linspace(0.0, 100.0, 9000)
    found = grid.first_order_over(angles)
    np.testing.assert_allclose(found, backlash(angles, paper_pair, paper_rig), rtol=0, atol=1e-16)
    assert np.abs(found - grid.over(angles)).max() > 1e-8
    without = BacklashMap(grid.model, None, paper_pair)
    assert np.all(np.isnan(without.first_order_over(angles[:3])))


@pytest.mark.parametrize("ripple", [3e-5, 1e-3])
def test_extremes_against_a_dense_grid(paper_pair, paper_rig, ripple):
    """Ripples of the mesh are far finer than the eccentricities that carry them."""
    model = with_mesh(paper_pair, paper_rig, ripple)
    found = BacklashMap(model, None, paper_pair)
    low, low_at, high, high_at = dense(model, 16, 9000)
    assert found.smallest.backlash <= low + 1e-17
    assert found.largest.backlash >= high - 1e-17
    assert found.smallest.backlash == pytest.approx(low, abs=1e-8)
    assert found.largest.backlash == pytest.approx(high, abs=1e-8)
    assert found.smallest.driving_angle == pytest.approx(low_at, abs=2e-3)
    assert found.largest.driving_angle == pytest.approx(high_at, abs=2e-3)


def test_extremes_of_any_rig(paper_pair):
    for seed in range(6):
        draw = np.random.default_rng(seed)
        numbers = draw.uniform([0.01, 0, 0.01, 0, 0.02], [0.1, 360, 0.1, 360, 0.1])
        model = exact_model(paper_pair, Eccentricities(*map(float, numbers)))
        found = BacklashMap(model, None, paper_pair)
        low, _, high, _ = dense(model, 16, 4000)
        assert low - 1e-9 < found.smallest.backlash <= low + 1e-17
        assert high - 1e-17 <= found.largest.backlash < high + 1e-9


def test_extremes_lie_where_they_say(grid):
    for extreme in (grid.smallest, grid.largest):
        assert 0.0 <= extreme.driving_angle < 16 * TURN
        wanted = float(grid.at(extreme.driving_angle))
        assert extreme.backlash == pytest.approx(wanted, abs=1e-15)
        first, second = extreme.tooth_pair
        passed = int(extreme.driving_angle / TURN * 45)
        assert first == passed % 45 + 1 and second == passed % 80 + 1
    assert str(grid.smallest).endswith(
        f"(teeth {grid.smallest.tooth_pair[0]} and {grid.smallest.tooth_pair[1]})"
    )


def test_a_speed_increaser_is_resolved():
    """One driving turn is ten driven turns here: the grid must follow the faster shaft."""
    pair = GearPair(Gear(200), Gear(20), module_mm=1.0, pressure_angles_deg=20.0)
    rig = Eccentricities(0.001, 10.0, 0.03, 100.0, 0.5)
    model = exact_model(pair, rig)
    low, low_at, _, _ = dense(model, 1, 200_000)
    found = BacklashMap(model, None, pair).smallest
    assert found.backlash == pytest.approx(low, abs=1e-10)
    assert found.driving_angle == pytest.approx(low_at, abs=1e-3)


def test_constant_backlash_alone_has_no_place_of_its_own(paper_pair):
    rig = Eccentricities(constant_backlash_deg=0.05)
    found = BacklashMap(exact_model(paper_pair, rig), None, paper_pair)
    assert found.smallest.backlash == pytest.approx(np.radians(0.05), rel=1e-12)
    assert found.largest.backlash == pytest.approx(np.radians(0.05), rel=1e-12)


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
    spur = GearPair(
        Gear(45), Gear(80), module_mm=2.0, pressure_angles_deg=20.0, centre_distance_mm=125.12
    )
    assert BacklashMap(exact_model(spur, paper_rig), None, spur).safe_closing_mm == np.inf
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


def test_text_says_where_and_how_far(grid, paper_rig):
    text = str(grid)
    assert "16 driving turns" in text and "safe axial closing" in text
    assert f"{np.degrees(grid.smallest.backlash):.5f}°" in text
    spur = GearPair(
        Gear(45), Gear(80), module_mm=2.0, pressure_angles_deg=20.0, centre_distance_mm=125.12
    )
    assert "safe axial closing" not in str(BacklashMap(exact_model(spur, paper_rig), None, spur))


def test_a_hunting_period_beyond_search_is_said(grid):
    endless = BacklashMap(grid.model, None, Drive(Fraction("0.562500001")))
    with pytest.raises(PairError, match="too long to search") as caught:
        _ = endless.smallest
    assert caught.value.where == "drive.ratio"
