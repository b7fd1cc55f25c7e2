"""Where the logs of a fit lie in the hunting period."""

from dataclasses import replace

import msgspec
import numpy as np
import pytest

from tests.posterior.made import quick_fit, quick_posterior
from vttig_jax.identify.backlash import backlash_map
from vttig_jax.identify.records import LogStart
from vttig_jax.posterior.summary.bands import band_map

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


def test_one_log_lies_at_its_own_zero():
    found = quick_fit().coverage
    assert found.share == pytest.approx(ALONE, abs=0.1 / 16)
    assert found.unplaced == 0 and found.both[0, 0] > 0 and found.both[-1, 1] < 5 * 2 * np.pi


@pytest.mark.parametrize(("turns", "least", "most"), [(0, 1, 1), (7.25, 2, 2), (13.9, 1.01, 1.99)])
def test_a_log_with_its_own_zero_is_placed_by_both_start_angles(turns, least, most):
    """Far from the first log it doubles the share; over the end of the period both overlap."""
    found = two_logs(start_at(turns)).coverage
    alone = quick_fit().coverage.share
    assert (least - 1e-6) * alone < found.share < (most + 1e-6) * alone
    inside = 2 * np.pi * (np.mod(turns, 16) + np.array([0.5, 2.5, 4.0]))
    assert found.holds(inside).all()


def test_start_angles_that_do_not_tell_the_turn_place_nothing():
    alone = quick_fit().coverage
    for std in (6.0, 0.0, np.inf, np.nan):
        found = two_logs(start_at(7.25, driven_std_deg=std)).coverage
        assert found.share == alone.share and found.unplaced == 2
        assert str(found).startswith("at least")


def test_logs_are_told_apart_by_their_time_or_not_at_all():
    """A time that runs on hides where the second log begins."""
    hidden = two_logs(start_at(7.25), later_s=1e4)
    assert hidden.coverage.share == 0.0 and "unknown part" in str(hidden.coverage)
    common = LogStart(driving_deg=0.0, driving_std_deg=0.0, driven_deg=0.0, driven_std_deg=0.0)
    same = two_logs(common, later_s=1e4).coverage
    assert same.share == quick_fit().coverage.share and same.unplaced == 0


def test_maps_know_what_was_covered():
    fit, banded = quick_fit(), band_map(quick_posterior(), 10.0)
    for grid in (banded.map, backlash_map(fit)):
        assert grid.coverage is not None and grid.coverage.share == fit.coverage.share
    assert "of the 16 driving turns of the hunting period on both flanks" in str(banded)
    assert grid.is_extrapolated(grid.smallest) is not None
    assert str(grid.coverage) in str(grid)
