"""Magnetic encoders: their own orders, against a Fourier transform of the tables."""

from pathlib import Path

import numpy as np
import pytest

import vttig_jax
from tests.test_fits import FITS

AS5047 = FITS / "as5047"


def encoder_lines(true_deg: np.ndarray) -> np.ndarray:
    """c_k of the error reading − true over a full turn, Re[c e^{−jkφ}], degrees."""
    true = np.unwrap(true_deg, period=360.0)
    reading = 360.0 * np.arange(len(true)) / len(true)
    return 2 * np.conj(np.fft.rfft(reading - (true - true[0]))) / len(true)


@pytest.mark.parametrize("number", ["01", "09", "21"])
def test_encoder_against_the_fourier_transform(data_dir: Path, number: str):
    path = data_dir / "as5047" / f"lookup_{number}.csv"
    pair = vttig_jax.load_pair(AS5047 / "pair.toml")
    log = vttig_jax.read_log(path, pair)
    fit = vttig_jax.fit(log, pair, perfect_gears=True, delay="off", ratio_within=0)
    lines = encoder_lines(np.loadtxt(path))
    size, phase = (fit.parameters[f"driven_encoder_{n}"] for n in ("arcsec", "phase_deg"))
    assert size.std is not None and phase.std is not None and phase.value is not None
    assert 0.007 < abs(lines[1]) < 0.47
    assert size.value == pytest.approx(3600 * abs(lines[1]), abs=3 * size.std)
    # a sin(φ + p) is Re[c e^{−jφ}] with c = a e^{j(90° − p)}.
    expected = 90.0 - np.degrees(np.angle(lines[1]))
    assert (phase.value - expected + 180) % 360 - 180 == pytest.approx(0.0, abs=3 * phase.std)
    for order in fit.orders[1:4]:
        known = 3600 * abs(lines[int(order.order)])
        assert order.amplitude_arcsec == pytest.approx(known, abs=4 * order.std_arcsec)
    assert fit.conditional_on == ("perfect_gears", "no_delay")
    (step,) = [one for one in fit.checks.lines if abs(one.cycles_per_rev - 100) < 0.1]
    assert step.amplitude_arcsec == pytest.approx(3600 * abs(lines[100]), rel=0.05)


def test_encoder_lines_are_recovered():
    angle = 2 * np.pi * np.arange(4096) / 4096
    error = 0.2 * np.sin(angle + np.radians(30.0)) + 0.1 * np.sin(2 * angle)
    lines = encoder_lines(np.degrees(angle) - error + 200.0)
    assert abs(lines[1]) == pytest.approx(0.2) and abs(lines[2]) == pytest.approx(0.1)
    assert 90 - np.degrees(np.angle(lines[1])) == pytest.approx(30.0)
    assert abs(lines[3]) < 1e-12


def test_encoder_reference_shows_its_steps(data_dir: Path):
    """Orders 50 and 100 belong to the stepper motor that was the ruler: 200 steps a turn."""
    for number in ("01", "09", "21"):
        table = np.loadtxt(data_dir / "as5047" / f"lookup_{number}.csv")
        lines = 3600 * np.abs(encoder_lines(table))
        assert 90 < lines[100] < 300 and 25 < lines[50] < 75
        assert np.argmax(lines[20:150]) == 80
