"""Covered part of the hunting period, against counting on a fine grid."""

from fractions import Fraction

import numpy as np
import pytest

from vttig_jax.kinematics.backlash_map import BacklashMap
from vttig_jax.kinematics.exact import exact_model
from vttig_jax.kinematics.hunting_coverage import hunting_coverage
from vttig_jax.kinematics.te_curve import TECurve
from vttig_jax.pair.gear_pair import Drive, Gear, GearPair

TURN = 2 * np.pi
PAIR = GearPair(Gear(21), Gear(64), module_mm=2.0, pressure_angles_deg=20.0)


def curve(flank, first_turn, last_turn, per_turn=100):
    """A curve of means of a hundredth of a turn between two driving angles, either way."""
    count = round(abs(last_turn - first_turn) * per_turn)
    angle = TURN * (first_turn + (np.arange(count) + 0.5) / count * (last_turn - first_turn))
    return TECurve(flank, angle, 0 * angle, np.arange(count, dtype=float))


def test_eight_of_sixty_four_turns():
    found = hunting_coverage([curve("A", 0, 8), curve("B", 8, 0)], PAIR)
    assert found.share == pytest.approx(0.125)
    np.testing.assert_allclose(found.both, [[0.0, 8 * TURN]], atol=1e-9)
    assert found.tooth_pairs == (8 * 21, 64 * 21)
    assert str(found) == (
        "8 of the 64 driving turns of the hunting period on both flanks (12.5 %, 168 of 1344 tooth"
        " pairs); elsewhere the map is extrapolated by the fitted orders"
    )
    assert found.holds(TURN * np.array([0.5, 7.9, 8.1, 63.0, 64.5, -0.1])).tolist() == [
        True,
        True,
        False,
        False,
        True,
        False,
    ]


def test_spans_wrap_join_and_meet_on_both_flanks():
    """Random curves, some over the end of the period, against a grid of points."""
    generator = np.random.default_rng(2)
    curves, starts = [], []
    for _ in range(14):
        first, length = generator.uniform(-90, 90), generator.uniform(1, 15)
        ends = (first, first + length) if generator.random() < 0.5 else (first + length, first)
        curves.append(curve("AB"[len(curves) % 2], *ends))
        starts.append(float(generator.integers(0, 64)) * TURN)
    found = hunting_coverage(curves, PAIR, starts)
    grid = TURN * (np.arange(6400) + 0.37) / 100
    seen = {"A": np.zeros(6400, bool), "B": np.zeros(6400, bool)}
    for one, start in zip(curves, starts, strict=True):
        half = 0.5 * np.ptp(one.driving_angle) / (len(one) - 1)
        low = start + one.driving_angle.min() - half
        seen[one.flank] |= np.mod(grid - low, 64 * TURN) < np.ptp(one.driving_angle) + 2 * half
    both = seen["A"] & seen["B"]
    assert 0.05 < both.mean() < 0.9
    np.testing.assert_array_equal(found.holds(grid), both)
    assert found.share == pytest.approx(both.mean(), abs=1e-3)
    assert (np.diff(found.both.ravel()) > 0).all()
    shares = found.to_json()["flank_shares"]
    assert shares == pytest.approx({f: seen[f].mean() for f in "AB"}, abs=1e-3)


def test_more_than_a_period_is_the_whole():
    found = hunting_coverage([curve("A", -3, 65), curve("B", 70, 5)], PAIR)
    assert found.share == 1.0
    assert str(found) == "all 64 driving turns of the hunting period on both flanks"
    one = hunting_coverage([curve("A", 0.1, 1.2), curve("B", 1.2, 0.1)], Drive(Fraction(2)))
    assert str(one) == "all 1 driving turn of the hunting period on both flanks"
    assert one.tooth_pairs is None


def test_one_flank_alone_measures_no_gap():
    found = hunting_coverage([curve("B", 8, 0)], PAIR)
    assert found.share == 0.0 and found.both.shape == (0, 2)
    assert "8 of the 64 driving turns of the hunting period on flank B only" in str(found)
    assert not found.holds(np.array([1.0])).any()


def test_curves_without_a_place_are_not_counted():
    curves = [curve("A", 0, 8), curve("B", 8, 0), curve("A", 0, 30), curve("B", 30, 0)]
    found = hunting_coverage(curves, PAIR, [0.0, 0.0, None, None])
    assert found.share == pytest.approx(0.125) and found.to_json()["unplaced_curves"] == 2
    assert str(found).startswith("at least 8 of the 64")
    nowhere = hunting_coverage(curves, PAIR, [None] * 4)
    assert nowhere.share == 0.0 and str(nowhere).startswith("an unknown part of the 64")


def test_the_map_marks_extremes_that_nobody_saw(paper_pair, paper_rig):
    model = exact_model(paper_pair, paper_rig)
    plain = BacklashMap(model, None, paper_pair)
    assert plain.is_extrapolated(plain.smallest) is None and "covered" not in str(plain)
    turn = plain.smallest.driving_angle / TURN
    for first, extrapolated in ((turn - 0.5, False), (turn + 0.5, True)):
        curves = [curve("A", first, first + 2), curve("B", first + 2, first)]
        grid = BacklashMap(model, None, paper_pair, hunting_coverage(curves, paper_pair))
        assert grid.is_extrapolated(grid.smallest) is extrapolated
        (line,) = [line for line in str(grid).splitlines() if "smallest" in line]
        assert line.endswith(", extrapolated") is extrapolated
        assert "2 of the 16 driving turns" in str(grid)


def test_a_tooth_pair_counts_where_its_middle_is_covered():
    """The spans are in pitches of the driving gear."""
    for first, last, pairs in (
        (0.4, 0.6, 1),
        (0.0, 0.3, 0),
        (0.7, 1.2, 0),
        (0.4, 2.6, 3),
    ):
        ends = (first / 21, last / 21)
        found = hunting_coverage(
            [curve("A", *ends, per_turn=2100), curve("B", *ends[::-1], per_turn=2100)], PAIR
        )
        assert found.tooth_pairs == (pairs, 64 * 21)
        np.testing.assert_allclose(found.both, [TURN * np.array(ends)], atol=1e-12)


@pytest.mark.parametrize(("points", "covered"), [([1.0], 0.0), ([1.0, 1.5], 1.0)])
def test_a_point_covers_half_the_distance_to_its_neighbour(points, covered):
    """One point alone has no neighbour and covers nothing."""
    angle = TURN * np.array(points)
    curves = [TECurve(flank, angle, 0 * angle, angle) for flank in ("A", "B")]
    found = hunting_coverage(curves, PAIR)
    assert found.share * 64 == pytest.approx(covered, abs=1e-12)
    assert found.holds(TURN * np.array([0.74, 0.76, 1.74, 1.76])).tolist() == (
        [False, True, True, False] if covered else [False] * 4
    )
