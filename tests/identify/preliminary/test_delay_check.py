"""A delay that leaves more than none does is open, and a right one of many samples stays."""

from dataclasses import replace

import numpy as np
import pytest

from tests.identify.drives import drive, drive_log, known, level, there_and_back
from vttig_jax.identify.fitting import fit
from vttig_jax.identify.preliminary import model_selection
from vttig_jax.identify.preliminary.delay import Delay
from vttig_jax.identify.preliminary.delay_check import explaining
from vttig_jax.logs.encoder_log import EncoderLog

PAIR = drive("1/2")


def test_a_delay_must_explain_the_log(monkeypatch):
    """The driven channel is late by five samples; thirty samples explain nothing."""
    seen = []

    def kept(delay, weights, linear, *, bound_s):
        seen.append((delay, weights, linear))
        return explaining(delay, weights, linear, bound_s=bound_s)

    monkeypatch.setattr(model_selection, "explaining", kept)
    motion = there_and_back([60, 30], 6)

    def error(angle, _):
        return 900 * np.sin(angle + 0.3)

    log = drive_log(PAIR, motion, gap=level(300.0), error=error, delay_s=level(0.05))
    delay = fit(log, PAIR).parameters["delay_s"]
    assert delay.significant and delay.value == pytest.approx(0.05, abs=1e-3)
    right, weights, linear = seen[-1]
    assert explaining(right, weights, linear, bound_s=0.01) is right
    off = weights.look(linear.inputs, replace(linear.model, regressors=()), 0.3, linear.block_s)
    wrong = Delay("fitted", 0.3, 1e-6, 1e-4)
    found = explaining(wrong, weights, off, bound_s=0.01)
    assert found.state == "open" and "larger residual" in found.reason and found.within_s == 0.01
    for bound_s in (0.3, np.inf):
        assert explaining(wrong, weights, off, bound_s=bound_s) is wrong
    other = Delay("insignificant", 0.0, 0.3, 0.1)
    assert explaining(other, weights, off, bound_s=0.01) is other


def _sampled_at(log: EncoderLog, time: np.ndarray) -> EncoderLog:
    """Return the log as if it had been read at other times, s."""
    driving, driven = (
        np.degrees(np.interp(time, log.time, angle))
        for angle in (log.driving_angle, log.driven_angle)
    )
    return EncoderLog.from_arrays(time, driving, driven, pair=PAIR, unit="deg")


def _stamps(kind: str, log: EncoderLog) -> np.ndarray:
    """Return time stamps of a kind at about 100 Hz."""
    rng = np.random.default_rng(0)
    count = len(log.time) - 20
    time = log.time[0] + 0.01 * np.arange(count)
    if kind == "polled":
        return log.time[0] + np.cumsum(0.01 * (1 + 0.1 * rng.standard_normal(count)))
    return time


@pytest.fixture(scope="module")
def two_speeds() -> EncoderLog:
    """The driven channel is read 2 ms after the driving one; the noise hides it."""
    motion = there_and_back([60, 55], 6)
    return drive_log(
        PAIR, motion, gap=level(3000.0), delay_s=level(-0.002), noise_arcsec=900.0, rate_hz=100.0
    )


@pytest.mark.parametrize("kind", ["clock", "polled"])
def test_speeds_that_hardly_tell_a_delay_allow_for_an_interval(two_speeds, kind):
    """The gap without the delay is 2 · 0.002 s · 180°/s = 0.7° off, and its interval says so."""
    result = fit(_sampled_at(two_speeds, _stamps(kind, two_speeds)), PAIR)
    delay = result.parameters["delay_s"]
    assert not delay.significant
    assert abs(known(delay.value) + 0.002) < 3 * known(delay.std)
    gap, of_delay = result.checks.gap_over_angles_covered, result.checks.gap_of_delay
    assert known(gap.low95) <= 3000 / 3600 <= known(gap.high95)
    assert of_delay is not None and of_delay.half_width_deg < 2 * 180 * 0.01
