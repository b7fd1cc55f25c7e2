"""From a fit to the backlash map."""

from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest

import vttig_jax
from vttig_jax.base.errors import NoAnswerError
from vttig_jax.base.units import DEG, REV
from vttig_jax.identify.backlash import backlash_map
from vttig_jax.identify.identification import fit
from vttig_jax.kinematics.backlash_map import BacklashMap
from vttig_jax.pair.gear_pair import Drive
from vttig_jax.pair.schema import HarmonicOrders
from vttig_jax.rig.motion import PassMotion

GRID = np.linspace(0, 16 * REV, 1001)


def test_two_flanks_give_the_order_complete_map(noisy_fit, noisy_rig):
    found = backlash_map(noisy_fit)
    assert found.model is noisy_fit.model
    true = BacklashMap(noisy_rig.flank_model(), None, noisy_rig.pair).over(GRID)
    assert np.std(found.over(GRID) - true) / DEG < 0.0012
    # The first-order map beside it misses the pitch orders.
    assert np.std(found.first_order_over(GRID) - true) / DEG > 0.0015


def test_without_noise_the_map_is_exact(clean_fit, clean_rig):
    true = BacklashMap(clean_rig.flank_model(), None, clean_rig.pair).over(GRID)
    np.testing.assert_allclose(backlash_map(clean_fit).over(GRID), true, atol=2e-4 * DEG)


def test_one_flank_needs_the_constant_backlash(noisy_log, noisy_rig):
    one_flank = fit(noisy_log, noisy_rig.pair, flank="A")
    with pytest.raises(NoAnswerError, match="constant backlash is undetermined") as caught:
        backlash_map(one_flank)
    assert caught.value.exit_code == 4
    found = backlash_map(one_flank, constant_backlash_deg=0.05)
    expected = vttig_jax.exact_backlash(GRID, one_flank.pair, one_flank.eccentricities(0.05))
    # The driven gear stands the TE of the start beside i φ₁: see test_mounting.
    np.testing.assert_allclose(found.over(GRID), np.asarray(expected), atol=2e-5 * DEG)


def test_another_constant_backlash_shifts_the_map(noisy_fit):
    plain = backlash_map(noisy_fit)
    moved = backlash_map(noisy_fit, constant_backlash_deg=0.05)
    shift = (0.05 - noisy_fit.value("constant_backlash_deg")) * DEG
    # The extra angle of gear 2 on flank B moves its orders by 1e-7 rad.
    np.testing.assert_allclose(moved.over(GRID) - plain.over(GRID), shift, atol=3e-7)
    first = moved.first_order_over(GRID) - plain.first_order_over(GRID)
    np.testing.assert_allclose(first, shift, atol=1e-12)


def test_a_drive_maps_from_two_flanks_only(noisy_rig):
    """On turns enough that no order of one shaft lies within a cycle of one of the other."""
    log = replace(noisy_rig, motion=PassMotion(reversal_deg=5800.0)).log(0)
    drive = Drive(Fraction(45, 80), fit=noisy_rig.pair.fit)
    found = backlash_map(fit(log, drive))
    assert found.first_order is None
    # A drive has no tooth mesh.
    options = HarmonicOrders(mesh_orders=0)
    pair_map = backlash_map(fit(log, noisy_rig.pair, orders=options)).over(GRID)
    assert np.std(found.over(GRID) - pair_map) / DEG < 5e-4
    assert np.std(pair_map) / DEG > 5e-3
    for constant in (None, 0.05):
        with pytest.raises(NoAnswerError):
            backlash_map(fit(log, drive, flank="A"), constant_backlash_deg=constant)


def test_a_part_of_a_turn_has_the_map_of_the_angles_it_covers(noisy_rig):
    """One flank of it has none, whatever the constant backlash."""
    rig = replace(noisy_rig, motion=PassMotion(reversal_deg=450.0, ramp_s=0.1))
    one_flank = fit(rig.log(), rig.pair, flank="A")
    for constant in (None, 0.05):
        with pytest.raises(NoAnswerError, match="undetermined"):
            backlash_map(one_flank, constant_backlash_deg=constant)
    result = fit(rig.log(), rig.pair)
    assert not result.parameters["constant_backlash_deg"].determined
    gap = result.parameters["gap_over_angles_covered"]
    grid = backlash_map(result)
    assert grid.coverage is not None and 0 < grid.coverage.share < 0.2
    angles = np.concatenate([np.arange(low, high, DEG) for low, high in grid.coverage.both])
    assert np.mean(grid.over(angles)) / DEG == pytest.approx(gap.value, abs=gap.std)
