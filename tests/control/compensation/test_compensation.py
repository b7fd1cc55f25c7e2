"""The harmonics of both angles against the map they were made of, and what readings they refuse."""

import dataclasses
import math
from fractions import Fraction

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from tests.oracles.compensated import gap_at, shift_at
from vttig_jax.base.errors import NoAnswerError, PairError, UsageError
from vttig_jax.base.units import ARCSEC, DEG, REV
from vttig_jax.control.compensation.c_header import HeaderOrigin, c_header
from vttig_jax.control.compensation.compensation import compensation_of
from vttig_jax.kinematics.backlash_map import BacklashMap
from vttig_jax.kinematics.exact import exact_model
from vttig_jax.kinematics.first_order import closed_model
from vttig_jax.kinematics.harmonic import OrderModel
from vttig_jax.pair.gear_pair import Drive, Gear, GearPair
from vttig_jax.rig.paper import paper_eccentricities, paper_pair

PAIR = paper_pair()
RATIO = 45 / 80
CLOSING = 2 * math.tan(3 * DEG) / 80.0
ALLOWED = 60 * ARCSEC
ORIGIN = HeaderOrigin("VTTIG rig", "0.1.0", "start")
ANGLES = np.random.default_rng(1).uniform(0, 16 * REV, 2000)


def readings(
    grid: BacklashMap, share: float | np.ndarray = 0.5, angles: np.ndarray = ANGLES
) -> tuple[np.ndarray, np.ndarray]:
    """Both shafts, the driven one at a share of the way from flank A to B; turns are kept."""
    lower, upper = (
        np.asarray(grid.model.transmission_error(angles, flank)) for flank in ("A", "B")
    )
    return angles, float(grid.pair.ratio) * angles + lower + share * (upper - lower)


def wrapped(angle):
    return np.remainder(angle + np.pi, REV) - np.pi


@pytest.mark.parametrize("share", [0.0, 1.0])
def test_single_turn_readings_give_the_map_of_the_hunting_period(grid, compensation, share):
    first, second = readings(grid, share)
    gap = gap_at(compensation, wrapped(first), wrapped(second))
    assert gap.known.all()
    np.testing.assert_allclose(gap.backlash_rad, grid.over(ANGLES), atol=1e-10)
    assert compensation.error_rad < 1e-10
    slope = np.asarray(jax.vmap(jax.grad(lambda angle: grid.at(angle)))(jnp.asarray(ANGLES)))
    np.testing.assert_allclose(gap.slope, slope, atol=1e-8)
    shift = shift_at(compensation, wrapped(first), wrapped(second), 0.2)
    expected = np.maximum(0, grid.over(ANGLES) / CLOSING - 0.2)
    np.testing.assert_allclose(shift.shift_mm, expected, atol=1e-7)
    assert 0 < np.count_nonzero(shift.shift_mm == 0) < 500
    np.testing.assert_array_equal(shift.slope_mm_per_rad[shift.shift_mm == 0], 0)
    closes = shift.shift_mm > 0
    np.testing.assert_allclose(shift.slope_mm_per_rad[closes], (slope / CLOSING)[closes], atol=1e-5)


def test_readings_of_another_place_are_unknown(grid, compensation):
    first, second = readings(grid)
    limit = compensation.tolerance_rad
    assert limit > (float(grid.largest.backlash) / 2 + ALLOWED)
    off = np.linspace(2 * limit + 1e-6, compensation.spacing_rad / 2, len(first))
    gap = gap_at(compensation, first, second + off)
    assert not gap.known.any() and not gap.backlash_rad.any() and not gap.slope.any()
    # Foreign readings pass as seldom as the tolerance is narrow.
    share = gap_at(compensation, first, np.random.default_rng(0).uniform(0, REV, 2000)).known
    assert share.mean() == pytest.approx(2 * limit / compensation.spacing_rad, abs=0.01)


def test_the_range_of_the_transmission_error_is_that_of_both_flanks(grid, compensation):
    _, lower = readings(grid, 0.0)
    _, upper = readings(grid, 1.0)
    low, high = (lower - RATIO * ANGLES).min(), (upper - RATIO * ANGLES).max()
    half = compensation.tolerance_rad - ALLOWED
    # 2000 places come near the extremes without reaching them.
    assert 0 < low - (compensation.offset_rad - half) < 10 * ARCSEC
    assert 0 < compensation.offset_rad + half - high < 10 * ARCSEC


def test_weak_harmonics_are_left_out_as_far_as_asked(grid, compensation):
    coarse = compensation_of(grid, allowed_rad=ALLOWED, left_out_rad=1e-7)
    assert len(coarse.terms) < len(compensation.terms) / 2
    assert 1e-9 < coarse.error_rad < 1e-7
    left_out = set(compensation.terms) - set(coarse.terms)
    sizes = np.hypot(compensation.cosine_rad, compensation.sine_rad)
    amplitude = dict(zip(compensation.terms, sizes, strict=True))
    weakest = min(amplitude[term] for term in coarse.terms)
    assert 1e-7 - weakest < sum(amplitude[term] for term in left_out) <= 1e-7


def test_a_mounted_driven_encoder_moves_the_offset_alone(grid, compensation):
    contact = eqx.tree_at(lambda model: model.exact.offset, grid.model, replace_fn=lambda o: o + 9)
    mounted = compensation_of(grid, contact, allowed_rad=ALLOWED)
    # The eccentricities of this contact stand elsewhere, the range stays.
    assert mounted.offset_rad - compensation.offset_rad == pytest.approx(9, abs=0.02 * DEG)
    first, second = readings(grid)
    gap = gap_at(mounted, first, second + mounted.offset_rad - compensation.offset_rad)
    assert gap.known.all()
    np.testing.assert_allclose(gap.backlash_rad, grid.over(ANGLES), atol=1e-10)


@pytest.mark.parametrize("build", [exact_model, closed_model])
def test_models_of_eccentricities_alone(build):
    grid = BacklashMap(build(PAIR, paper_eccentricities()), None, PAIR)
    found = compensation_of(grid, allowed_rad=ALLOWED)
    gap = gap_at(found, *readings(grid)).backlash_rad
    np.testing.assert_allclose(gap, grid.over(ANGLES), atol=1e-11)
    assert len(found.terms) < 20


def drive_map(ratio: Fraction, gap: float = 4e-4) -> BacklashMap:
    model = OrderModel(
        ratio=jnp.asarray(float(ratio)),
        terms=((1, 0), (0, 1)),
        offset=jnp.array([0.0, gap]),
        cosine=jnp.array([[1e-4, 5e-5], [5e-5, 1e-4]]),
        sine=jnp.zeros((2, 2)),
    )
    return BacklashMap(model, None, Drive(ratio))


@pytest.mark.parametrize("helix_deg", [(3.0, -3.0), (-3.0, -3.0)])
def test_gears_that_do_not_thin_have_no_shift(helix_deg):
    gears = Gear(45, *helix_deg), Gear(80, *helix_deg)
    pair = GearPair(*gears, module_mm=2.0, pressure_angles_deg=20.0, centre_distance_mm=125.12)
    grid = BacklashMap(exact_model(pair, paper_eccentricities()), None, pair)
    with pytest.raises(UsageError, match="no axial displacement closes this gap"):
        c_header(compensation_of(grid, allowed_rad=ALLOWED), ORIGIN, name="rig")


def test_too_many_turns_leave_the_turn_open():
    grid = drive_map(Fraction(7, 1798))
    found = compensation_of(grid, allowed_rad=0.1 * DEG)
    assert not found.is_locating and not found.to_json()["locating"]
    with pytest.raises(NoAnswerError, match=r"1798 turns .* 0\.2° apart"):
        c_header(found, ORIGIN, name="rig", quantity="backlash")
    finer = compensation_of(grid, allowed_rad=10 * ARCSEC)
    first, second = readings(grid, angles=np.linspace(0, 1798 * REV, 500))
    gap = gap_at(finer, first, second)
    assert gap.known.all()
    np.testing.assert_allclose(gap.backlash_rad, grid.over(first), atol=1e-11)


def test_bad_arguments_are_refused(grid):
    with pytest.raises(ValueError, match="`allowed_rad` must be 0 or more"):
        compensation_of(grid, allowed_rad=-1.0)
    with pytest.raises(ValueError, match="`left_out_rad` must be 0 or more"):
        compensation_of(grid, allowed_rad=0.0, left_out_rad=math.nan)
    with pytest.raises(PairError, match="too long to search"):
        compensation_of(drive_map(Fraction("0.003893214683")), allowed_rad=0.0)
    steep = drive_map(Fraction(1, 2)).model
    steep = dataclasses.replace(steep, terms=((40_000, 0), (0, 400)))
    with pytest.raises(PairError, match="too many to work out"):
        compensation_of(BacklashMap(steep, None, Drive(Fraction(1, 2))), allowed_rad=0.0)
