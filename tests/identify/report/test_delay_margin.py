"""Gap of a log at one speed, where a delay passes for a part of it."""

import numpy as np
import pytest

from tests.identify.drives import drive, drive_log, known, level, there_and_back
from vttig_jax.base.units import DEG
from vttig_jax.identify.backlash import backlash_map
from vttig_jax.identify.fit_result import Fit
from vttig_jax.identify.fitting import fit
from vttig_jax.logs.encoder_log import EncoderLog
from vttig_jax.runs.map_table import COLUMNS, columns_of, map_table

PAIR = drive("1/2")
GAP_DEG = 200 / 3600
DELAY_S = 5e-4
DRIVEN_DEG_PER_S = 180.0
SUM_DEG = GAP_DEG + 2 * DRIVEN_DEG_PER_S * DELAY_S
NAME = "constant_backlash_deg"
SUM = "backlash_plus_delay_deg"


def _log(ramp_s: float) -> EncoderLog:
    return drive_log(
        PAIR,
        there_and_back([60, 60], 6, ramp_s=ramp_s),
        gap=level(200.0),
        error=lambda angle, _: 20 * np.sin(angle + 0.3) + 30 * np.sin(angle / 2 + 1),
        delay_s=level(DELAY_S),
    )


@pytest.fixture(scope="module")
def log() -> EncoderLog:
    """One speed, with ramps of 5 ms, which lie between two samples."""
    return _log(0.005)


@pytest.fixture(scope="module")
def fits(log) -> dict[float | None, Fit]:
    """Fits by the bound of the delay in ms."""
    return {within: fit(log, PAIR, delay_within_ms=within) for within in (None, 0.6, 1.2)}


def test_the_sum_of_gap_and_delay_is_determined(fits):
    for result in fits.values():
        found = result.parameters[SUM]
        assert found.determined
        assert abs(known(found.value) - SUM_DEG) < 4 * known(found.std) < 1e-3


def test_the_intervals_contain_the_gap_and_nothing_below_zero(fits):
    for within in (None, 0.6, 1.2):
        parameter = fits[within].parameters[NAME]
        covered = fits[within].checks.gap_over_angles_covered
        for found in (parameter, covered):
            assert known(found.low95) <= GAP_DEG <= known(found.high95)
            assert known(found.low95) >= 0 and known(found.value) >= 0
    assert fits[None].parameters[NAME].low95 == 0
    assert fits[None].checks.gap_over_angles_covered.low95 == 0
    assert "together with the delay" in fits[None].parameters[NAME].reason


def test_the_width_is_in_proportion_to_the_bound(fits):
    for within, bound_s in ((0.6, 6e-4), (1.2, 1.2e-3), (None, 1e-2)):  # None: a sampling interval
        half = 2 * DRIVEN_DEG_PER_S * bound_s
        parameter = fits[within].parameters[NAME]
        assert known(parameter.high95) - known(parameter.value) == pytest.approx(half, rel=1e-3)
        covered = fits[within].checks.gap_over_angles_covered
        assert known(covered.high95) - known(covered.value) == pytest.approx(half, rel=1e-3)


def test_a_given_delay_leaves_the_gap_alone(log):
    result = fit(log, PAIR, delay=DELAY_S)
    assert SUM not in result.parameters
    for found in (result.parameters[NAME], result.checks.gap_over_angles_covered):
        assert abs(known(found.value) - GAP_DEG) < 4 * known(found.std) < 1e-3


def test_a_delay_that_is_free_has_no_margin(log):
    result = fit(log, PAIR, delay="free")
    assert SUM not in result.parameters
    assert not result.parameters[NAME].determined


def test_ramps_of_a_few_samples_tell_no_delay():
    """The smoothed speed does not follow a ramp of three samples."""
    result = fit(_log(0.03), PAIR)
    gap = result.parameters[NAME]
    assert not result.parameters["delay_s"].determined
    assert known(gap.low95) <= GAP_DEG <= known(gap.high95)


def test_ramps_of_many_samples_tell_the_delay():
    result = fit(_log(0.4), PAIR)
    gap, delay = result.parameters[NAME], result.parameters["delay_s"]
    assert abs(known(gap.value) - GAP_DEG) < 4 * known(gap.std) < 1e-3
    assert abs(known(delay.value) - DELAY_S) < 4 * known(delay.std) < 1e-5


def test_a_sum_below_zero_is_told_with_both_causes(fits):
    """Exchanged columns at a ratio of 1, and the same log as it is, which has no such warning."""
    pair = drive("1")
    log = drive_log(
        pair, there_and_back([60, 60], 6, ramp_s=0.005), gap=level(200.0), delay_s=level(0.0)
    )
    turned = EncoderLog.from_arrays(
        log.time, log.driven_angle, log.driving_angle, pair=pair, unit="rad"
    )
    found = fit(turned, pair)
    assert known(found.parameters[SUM].value) == pytest.approx(-GAP_DEG, rel=0.05)
    told = [one for one in found.warnings if "below zero" in one]
    # 200″ of gap are twice 77 µs at 360 degrees a second.
    assert len(told) == 1 and "late by at least 0.077 ms" in told[0] and "exchange" in told[0]
    for good in (fit(log, pair), fits[None]):
        assert not any("below zero" in one for one in good.warnings)


@pytest.mark.parametrize("within", [None, 0.6])
def test_the_map_has_the_interval_of_the_gap(fits, within):
    result = fits[within]
    grid, parameter = backlash_map(result), result.parameters[NAME]
    low, high = (end / DEG for end in grid.interval(grid.smallest.backlash))
    assert low <= GAP_DEG <= high  # the errors are common to both flanks
    at_zero = result.value(NAME)
    assert known(parameter.high95) - at_zero == pytest.approx(high - grid.smallest.backlash / DEG)
    table = map_table(grid, 5.0, 1.0)
    assert columns_of(grid)[-2:] == ("low95_deg", "high95_deg") and table.shape == (72, 7)
    backlash, lower, upper = table[:, 1], table[:, 5], table[:, 6]
    assert np.all((lower >= 0) & (lower <= backlash) & (backlash <= upper))
    assert np.ptp(upper - backlash) < 1e-9
    assert "with the delay that the log leaves open" in str(grid)
    given = backlash_map(result, constant_backlash_deg=GAP_DEG)
    assert given.shift is None and columns_of(given) == COLUMNS
    assert "leaves open" not in str(given)


def test_the_map_of_a_given_delay_has_no_interval(log):
    grid = backlash_map(fit(log, PAIR, delay=DELAY_S))
    assert grid.shift is None
    assert grid.interval(grid.smallest.backlash) == (grid.smallest.backlash,) * 2
