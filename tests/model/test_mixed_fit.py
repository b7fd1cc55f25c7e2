"""Fits of logs with known truth."""

from typing import Any

import numpy as np
import pytest

from tests.model.rigs import DRIVE, WAVES, Columns, drive, fitted, harmonic_columns, logged
from vttig_jax.base import ARCSEC, DEG
from vttig_jax.model import (
    DELAY,
    RATIO,
    TORQUE,
    Assumptions,
    ColumnName,
    MixedFit,
    RowName,
    found_lines,
    parameters_of,
    waves_of,
)
from vttig_jax.pair import HarmonicOrders

GAP = "gap_over_angles_covered"
TRUTH = {
    "driving_amplitude_arcsec": 72.0,
    "driving_phase_deg": np.degrees(0.7),
    "driven_amplitude_arcsec": 108.0,
    "driven_phase_deg": np.degrees(2.0),
    "delay_s": 4e-4,
    GAP: 0.1,
}


def _claims(found: MixedFit | Columns) -> Any:
    fit = found if isinstance(found, MixedFit) else fitted(logged(found))
    return parameters_of(fit, DRIVE)


@pytest.fixture(scope="module")
def columns() -> Columns:
    return harmonic_columns()


@pytest.fixture(scope="module")
def claims(columns) -> dict:
    return _claims(columns)


def test_claims_hold_and_are_narrow(claims):
    for name, truth in TRUTH.items():
        one = claims[name]
        assert abs(one.value - truth) < 2.0 * (one.high95 - one.low95), name
        assert one.significant, name
    assert claims[GAP].std < 1e-3
    assert claims["delay_s"].std < 2e-5


def test_intervals_hold_over_seeds():
    """96 claims: outside 5 % of 95 % intervals would be 5, and 14 have a probability of 2e-4."""
    outside = 0
    for seed in range(16):
        found = _claims(harmonic_columns(seed=seed))
        outside += sum(not found[n].low95 < true < found[n].high95 for n, true in TRUTH.items())
    assert outside < 14


def test_a_ratio_that_is_off_is_found(columns):
    """A ratio 1e-4 off makes a slope of TE, which is no gap and no order."""
    time, driving, driven = columns
    off = logged((time, driving, driven + 1e-4 * driving))
    fit = fitted(off)
    ratio = fit.posterior.one(fit.posterior.row(RATIO), moved=True)
    assert abs(ratio.value - 1e-4) < 3 * ratio.std < 3e-5
    assert abs(_claims(fit)[GAP].value - 0.1) < 0.002
    exact = fitted(off, assumed=Assumptions(ratio=0.0))
    assert RATIO not in exact.posterior.problem.index


@pytest.mark.parametrize("one_in", [500, 100, 50])
def test_readings_that_stand_alone_move_nothing(columns, claims, one_in):
    time, driving, driven = columns
    rng, driven = np.random.default_rng(4), driven.copy()
    bad = rng.choice(len(driven), len(driven) // one_in, replace=False)
    driven[bad] += rng.choice([-1, 1], len(bad)) * DEG
    found = _claims((time, driving, driven))
    for name, truth in TRUTH.items():
        assert found[name].std < 3 * claims[name].std, name
        assert abs(found[name].value - truth) < 4 * found[name].std, name
    assert fitted(logged(columns)).weights is None


def test_a_line_that_is_no_order_is_found(columns):
    log = logged(harmonic_columns(WAVES | {("driving", 2.37): (0.01, 0.3)}))
    (cycles,) = (line.cycles_per_rev for line in found_lines(fitted(log)))
    assert cycles == pytest.approx(2.37, abs=0.01)
    fit = fitted(log, lines=[cycles])
    names = [ColumnName(RowName("line", cycles, part), 0) for part in ("cos", "sin")]
    rows = np.stack([fit.posterior.row(name) for name in names])
    mean, covariance, _ = fit.posterior.told(rows, moved=True)
    assert np.hypot(*mean) == pytest.approx(36 * ARCSEC, abs=5 * covariance[0, 0] ** 0.5)
    assert not found_lines(fit)
    assert not found_lines(fitted(logged(columns)))


def test_what_the_motion_does_not_tell_is_said(columns):
    short = _claims(harmonic_columns(turns=0.6))
    for name in ("driving_amplitude_arcsec", "driven_amplitude_arcsec", "constant_backlash_deg"):
        assert not short[name].determined and short[name].reason
    assert abs(short[GAP].value - 0.1) < 4 * short[GAP].std
    assert short[GAP].std < 0.02
    time, driving, driven = (column[: len(column) // 2] for column in columns)
    forth = _claims((time, driving, driven))
    assert GAP not in forth
    assert not forth["constant_backlash_deg"].determined
    assert forth["driving_amplitude_arcsec"].determined


def test_a_known_delay_is_no_column_and_torque_is_one(columns):
    fit = fitted(logged(columns), assumed=Assumptions(delay_s=4e-4))
    assert DELAY not in fit.posterior.problem.index
    assert abs(_claims(fit)[GAP].value - 0.1) < 3 * _claims(fit)[GAP].std
    time, driving, driven = columns
    torque = np.sign(np.gradient(driving)) + np.sin(2 * np.pi * time / 1.7)
    fit = fitted(logged((time, driving, driven + 30 * ARCSEC * torque), torque=torque))
    found = fit.posterior.one(fit.posterior.row(TORQUE), moved=True)
    assert abs(found.value - 30 * ARCSEC) < 5 * found.std
    assert found.std < 2 * ARCSEC
    gap = _claims(fit)[GAP]
    assert abs(gap.value - 0.1) < 2 * (gap.high95 - gap.low95)


def test_an_amplitude_of_noise_has_an_upper_limit():
    found = _claims(harmonic_columns({("driven", 1): (0.03, 2.0)}))
    one = found["driving_amplitude_arcsec"]
    assert one.determined and not one.significant and 0 < one.upper95 < 3
    assert found["driving_phase_deg"].value is None


def test_the_prior_of_the_delay_is_what_is_left_at_one_speed():
    """One speed and no ramps: the gap has the interval of the assumed delay."""
    time = np.arange(0, 8, 0.004)
    angle = 12.0 * np.where(time < 4, time, 8 - time)
    noise = 1e-5 * np.random.default_rng(0).normal(size=len(time))
    log = logged((time, angle, 9 / 16 * angle + 0.1 * DEG * (time >= 4) + noise))
    half = []
    for within in (2.5e-4, 1e-3):
        fit = fitted(log, ramps=False, assumed=Assumptions(delay_within_s=within))
        found = _claims(fit)
        assert found[GAP].low95 < 0.1 < found[GAP].high95
        assert not found["delay_s"].determined
        half.append(found[GAP].std)
    assert half[0] == pytest.approx(2 * 9 / 16 * 12.0 * 2.5e-4 / DEG, rel=0.2)
    assert half[1] == pytest.approx(4 * half[0], rel=0.2)


def test_waves_name_each_frequency_once():
    names = [(w.shaft, w.order) for w in waves_of(drive("1/2"), HarmonicOrders((1, 2), (1, 2), 0))]
    assert names == [("driving", 1), ("driving", 2), ("driven", 1)]
    both = waves_of(drive("2/3"), HarmonicOrders((1,), (1,), 0), [2.5])
    assert [w.cycles(2 / 3) for w in both] == pytest.approx([1, 2 / 3, 2.5])
