"""The step of readings, and the digits in which a log holds them."""

from fractions import Fraction

import numpy as np
import pytest

from vttig_jax.base.units import DEG
from vttig_jax.logs.channel.unwrap import digits_note, step_of
from vttig_jax.logs.encoder_log import EncoderLog
from vttig_jax.pair.gear_pair import Drive

TRAVEL = np.cumsum(np.random.default_rng(0).integers(1, 4, 900_000)).astype(np.float64)
"""Counts of a shaft that moves by one to three counts a sample."""


@pytest.mark.parametrize(
    ("values", "step"),
    [
        (np.array([3, 9, 12]), 1.0),
        (np.array([0.012, 0.004, 0.4, 0.408, 0.404]), 0.004),
        (np.array([3.11256, 6.20162, 9.22864, 12.32334]), 1e-5),
        (np.sqrt(np.arange(2, 50.0)), 0.0),
        (360 / 16384 * TRAVEL[:90000], 360 / 16384),
        (0.004 * TRAVEL * (1 + 1e-12 * np.sin(1e6 * np.arange(9e5))), 0.004),
        (np.round(0.0054931640625 * TRAVEL[:4000], 6), 0.0054931640625),
        (np.float32(360 / 4096 * TRAVEL[:2000]), 360 / 4096),
        (27.0 * np.arange(99) + np.round(0.02 * np.sin(np.arange(99.0)), 4), 1e-4),
        (0.012 * TRAVEL[::2] + 0.004 * 7 * np.cumsum(np.arange(450000) % 5 == 0), 0.004),
    ],
)
def test_step(values, step):
    assert step_of(values) == pytest.approx(step)


def test_steps_of_a_constant_speed_say_nothing_about_the_encoder():
    """A motor at 1.08° a sample is no encoder of 333 counts; the printed digits remain."""
    turning = np.round(1.08 * np.arange(20000.0), 6)
    assert step_of(turning) == pytest.approx(0.01)
    assert step_of(360 / 16384 * np.arange(20000.0)) == 0.0


TURNS = np.cumsum(np.random.default_rng(1).uniform(0.5, 2.0, 6000))
"""Degrees of a shaft that turns up to some 7500°."""


def printed(values: np.ndarray, form: str) -> np.ndarray:
    return np.array([float(format(value, form)) for value in values])


@pytest.mark.parametrize(
    ("values", "arcsec"),
    [
        (TURNS.astype(np.float32), 1.76),
        (printed(TURNS, ".6g"), 36.0),
        (printed(TURNS, ".7g"), 3.6),
        (printed(0.900391 + 0.01 * np.arange(3000), ".6g"), 0.36),
    ],
)
def test_digits_that_hide_small_angles_are_said(values, arcsec):
    (note,) = digits_note("driven", values, DEG)
    assert f"cannot show less than {arcsec:.3g}″" in note


def test_other_readings_have_no_such_note():
    """More digits, fixed decimals, an encoder of 16 384 counts, counts, a shaft that stands."""
    encoder = 360 / 16384 * np.rint(TURNS / 360 * 16384)
    whole, still = np.rint(TURNS).astype(np.int64), np.zeros(5)
    for values in (TURNS, np.round(TURNS, 4), printed(TURNS, ".10g"), encoder, whole, still):
        assert digits_note("driven", values, DEG) == []


def test_a_log_of_32_bits_says_so():
    time = np.arange(6000) * 0.01
    driven = (TURNS / 2).astype(np.float32).astype(np.float64)
    log = EncoderLog.from_arrays(time, TURNS, driven, pair=Drive(Fraction(1, 2)), unit="deg")
    assert any("numbers of 32 bits" in note for note in log.notes)
