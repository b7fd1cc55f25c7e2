"""A steady speed in one direction tells no delay, however much its readings jitter."""

import numpy as np

from tests.identify.drives import drive
from vttig_jax.identify.fit_result import Fit
from vttig_jax.identify.fitting import fit
from vttig_jax.logs.encoder_log import EncoderLog

DELAY_S = 0.02
STEP_DEG = 360 / 65536


def fitted(swing: float, jitter_deg: float) -> Fit:
    """Fit of a motor at 688°/s, of which a twentieth of the readings is off, on a drive of 100:1.

    Its speed varies by the share `swing`, without a period.
    """
    generator, time = np.random.default_rng(2), 0.01 * np.arange(12_000)
    fine = np.arange(-1.0, 121.0, 1e-3)
    speed = np.interp(fine, np.linspace(-1.0, 121.0, 25), generator.uniform(-1, 1, 25))
    travel = np.cumsum(688.0 * (1 + swing * speed)) * 1e-3

    def turned(t: np.ndarray) -> np.ndarray:
        return np.interp(t, fine, travel)

    off = (generator.random(len(time)) < 0.05) * generator.choice([-1, 1], len(time)) * jitter_deg
    driven = turned(time - DELAY_S) / 100
    driven = driven + 0.1 * np.cos(np.radians(driven) * 3)
    pair = drive("1/100")
    readings = (turned(time) + off, STEP_DEG * np.rint(driven / STEP_DEG))
    return fit(EncoderLog.from_arrays(time, *readings, unit="deg", pair=pair), pair)


def test_jitter_tells_no_delay():
    delay = fitted(0.0, 0.69).parameters["delay_s"]
    assert delay.value is None and "noise of the readings" in str(delay.reason)


def test_a_speed_that_varies_tells_it():
    delay = fitted(0.1, 0.01).parameters["delay_s"]
    assert delay.low95 is not None and delay.high95 is not None
    assert delay.low95 < DELAY_S < delay.high95
