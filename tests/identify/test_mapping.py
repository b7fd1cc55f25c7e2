"""From a fit to the backlash map, to both flanks, and to the angles that the logs cover."""

from dataclasses import replace
from fractions import Fraction

import msgspec
import numpy as np
import pytest

import vttig_jax
from tests.identify.quick import quick_rig
from tests.posterior.made import quick_fit
from vttig_jax.base import DEG, REV, NoAnswerError
from vttig_jax.identify import backlash_map, fit
from vttig_jax.identify.backlash import contact_map
from vttig_jax.identify.records import LogStart
from vttig_jax.kinematics import BacklashMap
from vttig_jax.logs import EncoderLog
from vttig_jax.model import Parameter
from vttig_jax.pair import Drive, HarmonicOrders
from vttig_jax.pair.gear_pair import pair_from_spec, spec_of
from vttig_jax.rig import PassMotion

ANGLES = np.linspace(0.0, 16 * REV, 500)


def test_two_flanks_give_the_map_which_another_constant_backlash_shifts(
    noisy_fit, noisy_rig, clean_fit, clean_rig
):
    found = backlash_map(noisy_fit)
    assert found.model is noisy_fit.model
    true = BacklashMap(noisy_rig.flank_model(), None, noisy_rig.pair).over(ANGLES)
    assert np.std(found.over(ANGLES) - true) / DEG < 0.0012
    # The first-order map beside it misses the pitch orders.
    assert np.std(found.first_order_over(ANGLES) - true) / DEG > 0.0015
    plain = backlash_map(noisy_fit)
    moved = backlash_map(noisy_fit, constant_backlash_deg=0.05)
    shift = (0.05 - noisy_fit.value("constant_backlash_deg")) * DEG
    # The extra angle of gear 2 on flank B moves its orders by 1e-7 rad.
    np.testing.assert_allclose(moved.over(ANGLES) - plain.over(ANGLES), shift, atol=3e-7)
    first = moved.first_order_over(ANGLES) - plain.first_order_over(ANGLES)
    np.testing.assert_allclose(first, shift, atol=1e-12)
    true = BacklashMap(clean_rig.flank_model(), None, clean_rig.pair).over(ANGLES)
    np.testing.assert_allclose(backlash_map(clean_fit).over(ANGLES), true, atol=2e-4 * DEG)


def test_one_flank_needs_the_constant_backlash(noisy_log, noisy_rig):
    one_flank = fit(noisy_log, noisy_rig.pair, flank="A")
    with pytest.raises(NoAnswerError, match="constant backlash is undetermined") as caught:
        backlash_map(one_flank)
    assert caught.value.exit_code == 4
    found = backlash_map(one_flank, constant_backlash_deg=0.05)
    expected = vttig_jax.exact_backlash(ANGLES, noisy_rig.pair, one_flank.eccentricities(0.05))
    # The driven gear stands the TE of the start beside i φ₁: see test_mounting.
    np.testing.assert_allclose(found.over(ANGLES), np.asarray(expected), atol=2e-5 * DEG)


def test_a_drive_maps_from_two_flanks_only(noisy_rig):
    """On turns enough that no order of one shaft lies within a cycle of one of the other."""
    log = replace(noisy_rig, motion=PassMotion(reversal_deg=5800.0)).log(0)
    drive = Drive(Fraction(45, 80), fit=noisy_rig.pair.fit)
    found = backlash_map(fit(log, drive))
    assert found.first_order is None
    # A drive has no tooth mesh.
    options = HarmonicOrders(mesh_orders=0)
    pair_map = backlash_map(fit(log, noisy_rig.pair, orders=options)).over(ANGLES)
    assert np.std(found.over(ANGLES) - pair_map) / DEG < 5e-4
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


GAP_DEG = 0.038


@pytest.fixture(scope="module")
def fits():
    """Fits of one run with the driven encoder mounted at an angle: (flank, counts) → fit."""
    rig = quick_rig(3)
    log = rig.log(3)
    assert log.driven is not None
    spec = spec_of(rig.pair)
    layout = msgspec.structs.replace(spec.log, zero="reading")
    pair = pair_from_spec(msgspec.structs.replace(spec, log=layout))
    found = {}
    for flank, counts in ((None, 0), ("A", 0), ("A", 3_000), ("B", 3_000), (None, 3_000)):
        mounted = EncoderLog.from_arrays(
            log.time, log.driving.reading, log.driven.reading + counts, pair=pair
        )
        alone = {} if flank is None else {"flank": flank, "perfect_encoders": True}
        found[flank, counts] = fit(mounted, pair, **alone)
    return found


def flanks(fitted, **options):
    grid, contact = contact_map(fitted, **options)
    errors = [np.asarray(contact.transmission_error(ANGLES, flank)) for flank in ("A", "B")]
    return grid, errors


def test_both_flanks_are_the_model_of_the_map_wherever_the_encoder_reads_zero(fits):
    grid, (lower, upper) = flanks(fits[None, 0])
    np.testing.assert_allclose(upper - lower, grid.over(ANGLES), atol=1e-12)
    np.testing.assert_array_equal(grid.over(ANGLES), backlash_map(fits[None, 0]).over(ANGLES))
    plain, _ = flanks(fits["A", 0], constant_backlash_deg=GAP_DEG)
    mounted, _ = flanks(fits["A", 3_000], constant_backlash_deg=GAP_DEG)
    np.testing.assert_allclose(mounted.over(ANGLES), plain.over(ANGLES), atol=1e-5 * DEG)
    by_formula = backlash_map(fits["A", 0], constant_backlash_deg=GAP_DEG)
    np.testing.assert_allclose(plain.over(ANGLES), by_formula.over(ANGLES), atol=5e-5 * DEG)


def test_one_flank_is_that_of_both_and_the_other_a_gap_away(fits):
    _, both = flanks(fits[None, 3_000])
    for place, flank in enumerate("AB"):
        grid, one = flanks(fits[flank, 3_000], constant_backlash_deg=GAP_DEG)
        np.testing.assert_allclose(one[place], both[place], atol=0.004 * DEG)
        np.testing.assert_allclose(one[1] - one[0], grid.over(ANGLES), atol=1e-12)
        assert np.median(one[place]) == pytest.approx(3_000 / 90_000 * REV, abs=0.1 * DEG)


def test_no_constant_backlash_and_shafts_that_slip_are_no_answer(fits):
    with pytest.raises(NoAnswerError, match="--constant-backlash-deg"):
        contact_map(fits["A", 0])
    ratio = Parameter("ratio", "1", 0.5631, 1e-6, 0.563, 0.5632, determined=True, significant=True)
    with pytest.raises(NoAnswerError, match=r"turn at 0\.5631 and not at 9/16"):
        contact_map(replace(fits[None, 0], regressors=(ratio,)))
    steady = Parameter("ratio", "1", 0.5625, 1e-6, determined=True)
    contact_map(replace(fits[None, 0], regressors=(steady,)))


ALONE = 5 / 16
"""Share that five turns there and back cover; the ramps stay on their flank."""


def two_logs(start: LogStart, *, later_s: float = 0.0):
    """The quick fit, as if its log had been recorded twice, with another zero the second time."""
    fit = quick_fit()
    again = tuple(replace(curve, time=curve.time + later_s) for curve in fit.curves)
    second = msgspec.structs.replace(fit.logs[0], start=start)
    return replace(fit, curves=(*fit.curves, *again), logs=(fit.logs[0], second))


def start_at(turns: float, **std) -> LogStart:
    """Start angles of a log whose zero lies this many driving turns after that of the first."""
    stds = {"driving_std_deg": 0.1, "driven_std_deg": 0.1} | std
    angles = {"driving_deg": 360 * turns % 360, "driven_deg": 360 * turns * 9 / 16 % 360}
    return LogStart(**angles, **stds)


def test_one_log_lies_at_its_own_zero_and_its_map_knows_it():
    fit = quick_fit()
    found = fit.coverage
    assert found.share == pytest.approx(ALONE, abs=0.1 / 16)
    assert found.unplaced == 0 and found.both[0, 0] > 0 and found.both[-1, 1] < 5 * 2 * np.pi
    grid = backlash_map(fit)
    assert grid.coverage is not None and grid.coverage.share == found.share
    assert grid.is_extrapolated(grid.smallest) is not None
    assert str(grid.coverage) in str(grid)


@pytest.mark.parametrize(("turns", "least", "most"), [(0, 1, 1), (7.25, 2, 2), (13.9, 1.01, 1.99)])
def test_a_log_with_its_own_zero_is_placed_by_both_start_angles(turns, least, most):
    """Far from the first log it doubles the share; over the end of the period both overlap."""
    found = two_logs(start_at(turns)).coverage
    alone = quick_fit().coverage.share
    assert (least - 1e-6) * alone < found.share < (most + 1e-6) * alone
    inside = 2 * np.pi * (np.mod(turns, 16) + np.array([0.5, 2.5, 4.0]))
    assert found.holds(inside).all()


def test_what_does_not_tell_the_turn_or_the_log_places_nothing():
    alone = quick_fit().coverage
    for std in (6.0, 0.0, np.inf, np.nan):
        found = two_logs(start_at(7.25, driven_std_deg=std)).coverage
        assert found.share == alone.share and found.unplaced == 2
        assert str(found).startswith("at least")
    hidden = two_logs(start_at(7.25), later_s=1e4)
    assert hidden.coverage.share == 0.0 and "unknown part" in str(hidden.coverage)
    common = LogStart(driving_deg=0.0, driving_std_deg=0.0, driven_deg=0.0, driven_std_deg=0.0)
    same = two_logs(common, later_s=1e4).coverage
    assert same.share == quick_fit().coverage.share and same.unplaced == 0
