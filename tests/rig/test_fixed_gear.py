"""Readings with gear 1 held against the exact backlash and against the passes of a log."""

from dataclasses import replace
from typing import Any

import equinox as eqx
import numpy as np
import pytest
from numpy.typing import ArrayLike
from scipy.interpolate import CubicSpline

import vttig_jax
from tests.rig.test_synthetic import shifted
from vttig_jax.base.units import DEG
from vttig_jax.kinematics.backlash_map import BacklashMap
from vttig_jax.logs.motion.segments import find_segments
from vttig_jax.rig.imperfections import EncoderError
from vttig_jax.rig.motion import PassMotion
from vttig_jax.rig.paper import paper_rig as rig_of_the_paper
from vttig_jax.rig.synthetic import SyntheticRig, fixed_gear_readings

ANGLES = np.array([0.0, 90.0, 1080.0, 2106.0, 3600.0, 5761.3, 7560.0, -45.0])
COUNT_DEG = 360.0 / 90_000


@pytest.fixture(scope="module")
def bare(paper_pair, paper_rig) -> SyntheticRig:
    """Nothing but two eccentric gears: no counts, perfect encoders."""
    return SyntheticRig(paper_pair, paper_rig)


@pytest.fixture(scope="module")
def full() -> SyntheticRig:
    """The paper's rig with orders, encoder errors and counts."""
    return rig_of_the_paper(3)


def read_deg(rig: SyntheticRig, angles: ArrayLike = ANGLES, **options) -> np.ndarray:
    return fixed_gear_readings(rig, angles, **options).backlash / DEG


def true_deg(rig: SyntheticRig, angles=ANGLES) -> np.ndarray:
    return np.asarray(BacklashMap(rig.flank_model(), None, rig.pair).at(angles * DEG)) / DEG


def test_is_the_exact_backlash(bare):
    moved, _ = shifted(bare.pair, bare.eccentricities)
    expected = np.asarray(vttig_jax.exact_backlash(ANGLES * DEG, bare.pair, moved)) / DEG
    np.testing.assert_allclose(read_deg(bare), expected, atol=1e-9)
    forgotten = vttig_jax.exact_backlash(ANGLES * DEG, bare.pair, bare.eccentricities)
    assert np.abs(read_deg(bare) - np.asarray(forgotten) / DEG).max() > 1e-6


def test_is_the_gap_between_the_two_passes_of_a_log(bare, full):
    """At one shown driving angle, whatever orders and encoders add; the two share their zero."""
    rig = replace(
        bare,
        orders=full.orders,
        motion=PassMotion(reversal_deg=1200.0, dwell_s=0.3, ramp_s=0.25),
        driving_encoder=EncoderError(3600.0, 70.0),
        driven_encoder=EncoderError(3600.0, 200.0),
    )
    log = rig.log()
    angle, error = log.driving_angle / DEG, log.transmission_error / DEG
    passes = {segment.flank: segment for segment in find_segments(log).segments}
    shown = np.array([250.0, 333.3, 700.0, 1000.0])
    at = {}
    for flank, run in passes.items():
        order = slice(run.start, run.stop)
        upwards = np.argsort(angle[order])
        at[flank] = CubicSpline(angle[order][upwards], error[order][upwards])(shown)
    gap = at["B"] - at["A"]
    np.testing.assert_allclose(read_deg(rig, shown), gap, rtol=0, atol=1e-8)
    assert np.abs(read_deg(bare, shown) - gap).max() > 1e-4


def test_counts_are_whole_and_at_most_one_away(full):
    gap = read_deg(full)
    counts = gap / COUNT_DEG
    np.testing.assert_allclose(counts, np.round(counts), atol=1e-9)
    miss = np.abs(gap - true_deg(full))
    assert 1e-5 < miss.max() < COUNT_DEG + 1e-5  # beside the count: both encoders' own errors


def test_noise_has_the_stated_width_and_comes_from_the_seed(bare):
    angles = np.full(4000, 90.0)
    gap = read_deg(bare, angles, std_deg=0.002, seed=1)
    assert np.std(gap) == pytest.approx(0.002, rel=0.05)
    assert abs(np.mean(gap) - true_deg(bare, angles[:1])[0]) < 4 * 0.002 / np.sqrt(4000)
    first, again, other = (read_deg(bare, std_deg=0.001, seed=seed) for seed in (5, 5, 6))
    np.testing.assert_array_equal(first, again)
    assert np.all(first != other)
    np.testing.assert_array_equal(read_deg(bare, seed=5), read_deg(bare, seed=6))
    assert fixed_gear_readings(bare, angles, seed=2).source == "synthetic rig, gear 1 held, seed 2"


def test_arguments_out_of_range(bare):
    cases: list[tuple[Any, dict[str, Any], str]] = [
        ([], {}, "Argument `driving_deg` must be finite angles"),
        ([[0.0]], {}, "Argument `driving_deg` must be finite angles"),
        ([0.0, np.nan], {}, "Argument `driving_deg` must be finite angles"),
        ([0.0], {"std_deg": -0.001}, "Argument `std_deg` must not be negative"),
        ([0.0], {"std_deg": np.nan}, "Argument `std_deg` must not be negative"),
        (np.zeros(50), {"std_deg": 0.1}, "Argument `std_deg` must leave the readings positive"),
    ]
    for angles, options, sentence in cases:
        with pytest.raises(ValueError, match=sentence):
            fixed_gear_readings(bare, angles, **options)


def test_a_closed_gap_is_refused(bare):
    """Table 2 with 0.02°: closed near 2106°, open at 0°."""
    tight = eqx.tree_at(lambda e: e.constant_backlash_deg, bare.eccentricities, np.asarray(0.02))
    rig = replace(bare, eccentricities=tight)
    assert read_deg(rig, [0.0])[0] > 0
    with pytest.raises(ValueError, match=r"keep the gap open, .* -0\.0\d+° at 2106\.0°"):
        fixed_gear_readings(rig, [0.0, 2106.0])
