"""Strokes to and fro in which the teeth cross the gap over a notable part of the travel."""

from fractions import Fraction

import numpy as np
import pytest

from tests.identify.drives import known
from tests.logs.profiles import played
from vttig_jax.base.errors import LogError, NoAnswerError
from vttig_jax.identify.result import Fit
from vttig_jax.identify.identification import fit
from vttig_jax.identify.preliminary.delay import TOO_SHORT
from vttig_jax.logs.checks.lost_motion import without_lost_motion
from vttig_jax.logs.encoder_log import EncoderLog
from vttig_jax.logs.motion.flank_assignment import assigned_segments
from vttig_jax.pair.gear_pair import Drive
from vttig_jax.pair.schema import HarmonicOrders


def strokes(
    cross_deg: float,
    stroke_deg: float,
    *,
    ratio: str = "1/100",
    leg_s: float = 2.0,
    legs: int = 6,
    rate_hz: float = 500.0,
    ramp: float = 0.1,
    unequal: float = 0.0,
    late_s: float = 0.0,
    noise: float = 0.01,
    seed: int = 0,
) -> tuple[EncoderLog, Drive, float]:
    """A log of strokes by the play operator, its drive and its gap, deg.

    `cross_deg` is the travel of the driving shaft that crosses the gap, `ramp` the share of a leg
    that each ramp takes, `noise` the standard deviation of a reading in gaps, and `unequal` that of
    the relative speeds of the legs.
    """
    rng = np.random.default_rng(seed)
    gain, fine = float(Fraction(ratio)), 10
    time = np.arange(0, leg_s * legs, 1 / (rate_hz * fine))
    leg, phase = np.divmod(time, leg_s)
    speed = np.clip(np.minimum(phase, leg_s - phase) / (ramp * leg_s), 0, 1)
    speed *= stroke_deg / (leg_s * (1 - ramp)) * np.where(leg % 2 == 0, 1.0, -1.0)
    speed *= (1 + unequal * rng.standard_normal(legs + 1))[leg.astype(int)]
    driving = np.cumsum(speed) / (rate_hz * fine)
    gap = gain * cross_deg
    driven = played(gain * driving, gap)
    seen = np.interp(time[::fine] - late_s, time, driven)
    noisy = seen + noise * gap * rng.standard_normal(len(seen))
    shown = np.round(driving[::fine] / 0.088) * 0.088
    pair = Drive(Fraction(ratio), fit=HarmonicOrders((1,), (1,), 0), name="strokes")
    log = EncoderLog.from_arrays(time[::fine], shown, noisy, pair=pair, unit="deg")
    return log, pair, gap


def holds(result: Fit, gap: float) -> bool:
    found = result.checks.gap_over_angles_covered
    return known(found.low95) <= gap <= known(found.high95)


@pytest.mark.parametrize("cross_deg", [4.0, 12.0, 20.0])
def test_a_crossing_that_is_a_large_part_of_a_stroke_is_no_contradiction(cross_deg):
    log, pair, gap = strokes(cross_deg, 60.0)
    followed = without_lost_motion(log)
    rest = followed.driven - 0.01 * followed.driving
    assert np.degrees(np.std(rest)) < 0.05 * gap
    assert np.std(rest) < 0.2 * np.std(log.driven_angle - 0.01 * log.driving_angle)
    assert holds(fit(log, pair), gap)


def test_shafts_that_turn_opposite_ways_are_clear():
    log, pair, _ = strokes(4.0, 1000.0, ratio="1/3", leg_s=4.0)
    turned = Drive(-pair.ratio, fit=pair.fit, name="opposite")
    angles = np.degrees(log.driving_angle), -np.degrees(log.driven_angle)
    opposite = EncoderLog.from_arrays(log.time, *angles, pair=turned, unit="deg")
    assert not assigned_segments(opposite).unclear


def test_shafts_that_turn_apart_stay_refused():
    log, pair, _ = strokes(12.0, 60.0)
    other = np.degrees(log.driving_angle[::-1]) / 100 + 0.2 * np.sin(1.7 * log.time)
    angles = np.degrees(log.driving_angle), other
    apart = EncoderLog.from_arrays(log.time, *angles, pair=pair, unit="deg")
    with pytest.raises(LogError, match="do not turn together"):
        fit(apart, pair)


def test_strokes_too_short_for_the_gap_say_so():
    log, pair, _ = strokes(44.0, 54.0)
    with pytest.raises(NoAnswerError, match=r"need (43|44|45)° .* log longer strokes"):
        fit(log, pair)


def test_legs_too_short_for_a_steady_stretch_are_used():
    log, pair, gap = strokes(2.0, 54.0, leg_s=0.5, rate_hz=100.0, ramp=0.3, ratio="9/16", legs=7)
    result = fit(log, pair)
    assert any("no steady speed in 7 of 7 runs" in note for note in result.notes)
    assert holds(result, gap)


@pytest.mark.parametrize("stroke_deg", [330.0, 437.0])
def test_strokes_of_about_a_turn_keep_both_flanks(stroke_deg):
    log, pair, gap = strokes(18.0, stroke_deg, ratio="9/16", leg_s=4.0)
    result = fit(log, pair)
    assert holds(result, gap)
    assert not any("is left out" in note for note in result.warnings)


def test_speeds_of_short_strokes_tell_no_delay_within_an_interval():
    log, pair, gap = strokes(4.0, 200.0, ratio="1/7", unequal=0.2, late_s=0.9 / 500)
    result = fit(log, pair)
    delay = result.parameters["delay_s"]
    assert not delay.determined and delay.reason == TOO_SHORT
    assert result.conditional_on == ("delay_within_one_sampling_interval",)
    assert any("so short a log does not tell a delay" in note for note in result.warnings)
    assert holds(result, gap)


@pytest.mark.parametrize("seed", range(4))
def test_speeds_of_a_few_percent_tell_no_delay(seed):
    """The delay of half a sampling interval is a twentieth of the gap, and larger than its std."""
    log, pair, gap = strokes(
        4.0, 300.0, unequal=0.02, late_s=0.5 / 500, noise=0.1, leg_s=3.0, ratio="1/7", seed=seed
    )
    result = fit(log, pair)
    assert not result.parameters["delay_s"].significant
    assert holds(result, gap)
