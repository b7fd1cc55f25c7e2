"""Rounding that the motion freezes: by brute force, and where it averages out."""

from dataclasses import replace

import numpy as np
import pytest

from tests.identify.drives import drive
from vttig_jax.logs.checks.frozen_rounding import (
    frozen_share,
    frozen_share_between_clocks,
    frozen_stds,
)
from vttig_jax.logs.encoder_log import EncoderLog
from vttig_jax.logs.motion.segments import Segment

pytestmark = pytest.mark.smoke


def bias_std(advance: float, samples: int = 2000) -> float:
    """Standard deviation of the mean rounding error over the place of the first sample."""
    places = (np.arange(600) + 0.5) / 600
    exact = places[:, None] + advance * np.arange(samples)
    return float(np.std(np.mean(np.rint(exact) - exact, axis=1)))


@pytest.mark.parametrize("advance", [45.0, 45.5, 45.25, 30 + 1 / 3, 151.875, 45.1234])
def test_the_share_is_that_of_the_mean_error(advance):
    """With R places within a step the mean has 1/R of the standard deviation of one error."""
    shares = [
        frozen_share(np.rint(place + advance * np.arange(2000)))
        for place in np.linspace(0.03, 0.97, 9)
    ]
    assert np.sqrt(np.mean(shares) / 12) == pytest.approx(bias_std(advance), abs=0.02)


def test_motion_and_noise_average_it_out():
    generator, line = np.random.default_rng(0), 45.0 * np.arange(2000)
    assert frozen_share(np.rint(line + generator.normal(size=2000))) == 0.0
    assert frozen_share(np.rint(line + 2 * np.sin(0.01 * np.arange(2000)))) == 0.0
    assert frozen_share(np.rint(line + 0.02 * np.sin(0.01 * np.arange(2000)) + 0.3)) > 0.9


def test_samples_a_step_apart_tell_no_step():
    assert frozen_share(np.arange(100.0)) == 0.0


def test_between_two_clocks_any_constant_speed_freezes_it():
    """Whole counts with a part of the advance, rounded again: constant unless speed changes."""
    generator = np.random.default_rng(1)
    for advance, change in ((33.7512, 0.0), (33.7512, 3.0)):
        exact = np.cumsum(advance + change * generator.normal(size=3000))
        first = np.rint(exact)
        again = np.rint(first[:-1] + 0.4 * np.diff(first))
        bias = float(np.mean(again - (exact[:-1] + 0.4 * np.diff(exact))))
        assert (abs(bias) > 0.2) == (change == 0)
        assert (frozen_share_between_clocks(again) > 0.8) == (change == 0)


def test_both_shafts_count_in_angles_of_the_driven_one():
    """The driven shaft advances unequally, which shows its step; the driving one has it, too."""
    pair, turns = drive("1/2"), np.arange(500)
    driven = 0.018 * np.rint(30 * turns + 3 * np.sin(0.05 * turns))
    log = EncoderLog.from_arrays(turns / 100, 1.08 * turns, driven, pair=pair, unit="deg")
    whole, alone = [Segment(0, 500, "A", 1.0)], np.radians(0.018) / np.sqrt(12)
    assert frozen_stds(log, whole) == pytest.approx(alone / 2, rel=1e-6)
    assert log.driven is not None
    clocked = replace(log, driven=replace(log.driven, step=0.054))
    (std,) = frozen_stds(clocked, whole)
    assert std == pytest.approx(np.hypot(3 * alone / 2, 3 * alone), rel=0.05)


def test_a_table_of_transmission_errors_has_places():
    turns = np.arange(500)
    table = EncoderLog.from_arrays(
        turns / 100,
        1.08 * turns,
        pair=drive("1/2"),
        unit="deg",
        transmission_error=np.sin(turns * 0.02),
    )
    assert frozen_stds(table, [Segment(0, 500, "A", 1.0)]) == 0.0
