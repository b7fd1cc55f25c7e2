"""Slips beside noise that is correlated over a quarter of a turn."""

import numpy as np
import pytest
from scipy.signal import lfilter

from tests.logs.profiles import drive, geared, trapezoid
from vttig_jax.logs.checks.slip import find_slips
from vttig_jax.logs.encoder_log import EncoderLog
from vttig_jax.logs.motion.segments import find_segments

RATE = 250.0
NOISE = 0.03
"""Standard deviation of the noise in degrees."""

AT = 2.0
"""Time of the slip in s: the middle of the motion forward."""


def coloured(seed, slip=0.0, off=0.0):
    """A log of three turns each way, with a slip in degrees and a ratio that is off by `off`."""
    time, angle, _ = trapezoid(rate=RATE, reversal=1080.0, dwell=0.5)
    driven, _ = geared(angle, ratio=9 / 16 * (1 + off))
    memory = np.exp(-4 / RATE)  # one turn takes a second
    innovation = np.random.default_rng(seed).standard_normal(len(time) + 2000)
    noise = NOISE * np.sqrt(1 - memory**2) * np.asarray(lfilter([1.0], [1.0, -memory], innovation))
    driven = driven + noise[2000:] + slip * (time >= AT)
    return EncoderLog.from_arrays(time, angle, driven, pair=drive("9/16"), unit="deg")


def found(log):
    return max(find_slips(log, find_segments(log)), key=lambda one: abs(one.size_deg), default=None)


@pytest.mark.parametrize("off", [0.003, 0.0])
def test_coloured_noise_is_no_slip(off):
    """No slip is claimed, whether the given ratio is exact or 0.3 % off."""
    assert [found(coloured(seed, off=off)) for seed in range(8)] == [None] * 8


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("seed", [0, 3])
def test_a_slip_above_the_noise_is_found(seed, sign):
    """A step of eight times the noise is found within 0.1 s, with its size up to two noises."""
    slip = sign * 8 * NOISE
    seen = found(coloured(seed, slip))
    assert seen is not None
    assert seen.time_s == pytest.approx(AT, abs=0.1)
    assert seen.size_deg == pytest.approx(slip, abs=2 * NOISE)
