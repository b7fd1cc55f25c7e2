"""Rounding that the motion freezes: by brute force, and where it averages out."""

from dataclasses import replace

import numpy as np
import pytest

from tests.identify.drives import drive
from vttig_jax.logs.checks import frozen_rounding as checked
from vttig_jax.logs.checks.frozen_rounding import (
    frozen_rounding,
    frozen_share,
    frozen_share_between_clocks,
    moves_by_whole_steps,
)
from vttig_jax.logs.encoder_log import EncoderLog
from vttig_jax.logs.motion.segments import Segment
from vttig_jax.pair.gear_pair import Flank

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


def ramped(growths: list[tuple[int, float]], place: float = 0.3) -> np.ndarray:
    """Rounded readings whose advance per sample grows by these amounts, so many times each."""
    growth = np.concatenate([np.full(times, each) for times, each in growths])
    return np.rint(place + np.cumsum(np.cumsum(growth)))


RAMP = [(1, 45.0), (99, 0), (1, -1.0), (44, -2.0), (1, -1.0), (99, 0)]


@pytest.mark.parametrize(
    ("growths", "whole"),
    [
        ([(1, 45.0), (99, 0), (1, -90.0), (99, 0)], True),
        (RAMP, True),
        ([*RAMP, (1, 1.0), (44, 2.0), (1, 1.0), (99, 0)], True),
        ([(1, 45.0), (299, 0)], False),  # one speed shows no change
        ([(1, 45.0), (99, 0), (1, -50.0), (1, -40.0), (99, 0)], False),  # a reversal in a sample
        ([(1, 45.0), (99, 0), (45, -2.1), (99, 0)], False),  # a ramp of no whole number
        ([(1, 45.0), (99, 0), (20, 0.05), (99, 0)], False),  # a slow change by a step
        ([(1, 45.0), (99, 0), (1, -20.0), (1, -40.0), (1, -30.0), (99, 0)], False),
    ],
)
@pytest.mark.parametrize("piece", [65_536, 7, 1])
def test_whole_steps_through_every_change_of_speed(growths, whole, piece, monkeypatch):
    monkeypatch.setattr(checked, "_PIECE", piece)
    assert moves_by_whole_steps(ramped(growths)[1:]) == whole
    assert moves_by_whole_steps(0.25 * ramped(growths)[1:], 0.25) == whole
    errors = {place: ramped(growths, place) - ramped(growths, 0.0) for place in (0.12, 0.31, 0.49)}
    assert all(len(np.unique(error)) == 1 for error in errors.values()) or not whole


def test_whole_steps_move_the_zero_alone():
    """A trajectory that a program computed shares its error; one more sample of rest ends it."""
    pair, sample = drive("1/2"), np.arange(400)
    advance = np.repeat([1.08, -1.08, 0.72, -0.72], 100)
    rough = np.sin(sample * 1.3)
    flanks: tuple[Flank, ...] = ("A", "B", "A", "B")
    runs = [Segment(100 * k, 100 * k + 99, flank, 1.0) for k, flank in enumerate(flanks)]
    for stays in (False, True):
        moved = advance.copy()
        moved[200] -= 0.36 * stays
        driving = np.cumsum(moved)
        log = EncoderLog.from_arrays(
            sample / 100, driving, driving / 2 + rough, pair=pair, unit="deg"
        )
        found = frozen_rounding(log, runs)
        assert np.all(found.stds > 0) == stays and np.any(found.stds > 0) == stays
        assert found.shared.shape == (0 if stays else 1, 4)


def test_both_shafts_count_in_angles_of_the_driven_one():
    """The driven shaft advances unequally, which shows its step; the driving one has it, too."""
    pair, turns = drive("1/2"), np.arange(500)
    driven = 0.018 * np.rint(30 * turns + 3 * np.sin(0.05 * turns))
    log = EncoderLog.from_arrays(turns / 100, 1.08 * turns, driven, pair=pair, unit="deg")
    whole, alone = [Segment(0, 500, "A", 1.0)], np.radians(0.018) / np.sqrt(12)
    assert frozen_rounding(log, whole).stds == pytest.approx(alone / 2, rel=1e-6)
    assert log.driven is not None
    clocked = replace(log, driven=replace(log.driven, step=0.054))
    (std,) = frozen_rounding(clocked, whole).stds
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
    assert frozen_rounding(table, [Segment(0, 500, "A", 1.0)]).stds == 0.0
