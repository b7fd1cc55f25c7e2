"""Curves of pictures, and the picture of what a fit leaves."""

from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace as changed
from scipy.signal import lfilter

from tests.plotting.axes import data, legend_texts
from vttig_jax.base import ARCSEC, DEG, REV, NoAnswerError
from vttig_jax.identify.records import FoundLine, Noise
from vttig_jax.kinematics import TECurve
from vttig_jax.logs import EncoderLog
from vttig_jax.pair import Drive
from vttig_jax.plotting import plot_residual
from vttig_jax.plotting.curves import (
    FALSE_ALARM,
    MOST_POINTS,
    mean_spectrum,
    noise_level,
    residual_spectrum,
    thinned,
)
from vttig_jax.plotting.residual import autocorrelation, plot_log
from vttig_jax.rig import PassMotion, paper_rig


@given(size=st.integers(2, 500), most=st.integers(4, 60), seed=st.integers(0, 99))
def test_the_outline_stays(size, most, seed):
    x = np.arange(float(size))
    y = np.random.default_rng(seed).standard_normal(size)
    thin_x, thin_y = thinned(x, y, most)
    assert len(thin_x) <= max(most, 2)
    assert thin_x[0] == 0 and thin_x[-1] == size - 1
    assert np.all(np.diff(thin_x) > 0)
    np.testing.assert_array_equal(thin_y, y[thin_x.astype(int)])
    assert thin_y.min() == y.min() and thin_y.max() == y.max()


def test_short_lines_are_left_alone_and_long_ones_keep_their_peaks():
    x = np.arange(float(MOST_POINTS))
    assert thinned(x, x)[0] is x
    assert len(thinned(np.arange(MOST_POINTS + 1.0), np.arange(MOST_POINTS + 1.0))[0]) < MOST_POINTS
    x, y = np.arange(1000.0), np.zeros(1000)
    y[[105, 505, 905]] = 1.0, -1.0, 2.0
    assert {105.0, 505.0, 905.0} <= set(thinned(x, y, 50)[0])
    y = np.where(x % 2, np.sin(x), np.nan)
    _, thin = thinned(x, y, 100)
    assert np.nanmax(thin) == np.nanmax(y) and np.isfinite(thin).sum() >= 90
    assert np.isnan(thinned(x, np.full(1000, np.nan), 100)[1]).all()
    with pytest.raises(ValueError, match="`most` must be at least 4, but is 3"):
        thinned(np.zeros(9), np.zeros(9), 3)


ANGLE = REV * np.linspace(0.0, 10.0, 1000)
NOISE = np.random.default_rng(0).standard_normal(1000) * ARCSEC
LINE = FoundLine(3.09, 0.001, 5.0, 0.1, 0.0, 1e-9, joined=False)
WHITE = Noise("AR(1)", (0.0,), 0.01, 1 / 3600, 1 / 3600, 0.005, 0.0)


@pytest.fixture
def left(make_fit):
    """A fit that leaves white noise of 1″ on both flanks, or other residuals, and lines."""

    def make(angle=ANGLE, residuals=(NOISE, -NOISE), lines=(), source="here/log.csv"):
        time = np.linspace(0.0, 10.0, len(angle))
        curves = tuple(TECurve(flank, angle, 0 * angle, time) for flank in ("A", "B"))
        fit = replace(make_fit(curves=curves, source=source), residuals=residuals, noise=WHITE)
        return replace(fit, checks=changed(fit.checks, lines=tuple(lines)))

    return make


def test_the_first_panel_is_the_residual_and_lines_are_named_in_the_last(left):
    figure = plot_residual(left(lines=[LINE]))
    figure.draw_without_rendering()
    rows, _, spectrum = figure.axes
    assert legend_texts(rows) == ["flank A", "flank B"]
    x, y = data(rows, 0)
    np.testing.assert_allclose(x, ANGLE / DEG)
    np.testing.assert_allclose(y, NOISE / ARCSEC)
    assert [text.get_text() for text in spectrum.texts] == ["3.09"]
    assert spectrum.get_ylim()[1] > 5.0


def test_it_says_whether_a_line_rises_above_the_noise_or_the_log_is_too_short(left):
    quiet = plot_residual(left()).axes[2]
    assert "no line of the rest rises" in quiet.get_title(loc="left") and not quiet.texts
    wave = NOISE + 0.5 * ARCSEC * np.sin(4.4 * ANGLE)
    loud = plot_residual(left(residuals=(wave, wave))).axes[2]
    assert "at 4.4 cycles per driving turn" in loud.get_title(loc="left")
    spectrum, level = (np.asarray(line.get_ydata()) for line in loud.lines[:2])
    assert np.count_nonzero(spectrum > level) <= 4
    short = left(angle=ANGLE / 100)
    assert residual_spectrum(short) is None
    figure = plot_residual(short)
    figure.draw_without_rendering()
    assert "too short" in figure.axes[2].get_title(loc="left")


def test_the_level_is_that_of_false_alarms(monkeypatch):
    """Of noise with memory, which rises above a level of 30 % anywhere in about 30 % of logs."""
    monkeypatch.setattr("vttig_jax.plotting.curves.FALSE_ALARM", 0.3)
    random, turns = np.random.default_rng(1), np.linspace(0.0, 20.0, 600)
    noise = Noise("AR(1)", (0.7,), 0.01, 1.4 / 3600, 1 / 3600, 0.02, 0.5)
    seen = 0
    for _ in range(200):
        white = random.standard_normal((2, 700))
        paths = np.asarray(lfilter([1.0], [1.0, -0.7], white, axis=1))[:, 100:]
        cycles, size = mean_spectrum([(turns, path) for path in paths])
        level = noise_level(noise, [(turns, path) for path in paths], cycles)
        seen += bool(np.any(size[2:] > level[2:]))
    assert 30 <= seen <= 85 and FALSE_ALARM == 1e-3


def test_correlation_and_spectrum_are_those_of_known_rows():
    """And leaves it where the rows are not whitened."""
    path = np.asarray(lfilter([1.0], [1.0, -0.9], np.random.default_rng(1).standard_normal(4000)))
    white = [np.convolve(part, [1.0, -0.9], "valid") for part in (path[:1500], path[1500:])]
    found, pairs = autocorrelation(white, 60)
    assert found[0] == 1 and len(found) == 61
    assert np.mean(np.abs(found[1:]) < 1.96 / np.sqrt(pairs[1:])) > 0.85
    assert pairs[5] == 1499 - 5 + 2499 - 5
    raw, _ = autocorrelation([path], 60)
    np.testing.assert_allclose(raw[1:4], [0.9, 0.81, 0.729], atol=0.04)
    np.testing.assert_array_equal(autocorrelation([], 10)[0], [0.0])
    places = np.random.default_rng(2).uniform(0, 20, 4000)
    up, down = np.sort(places), np.sort(places)[::-1]
    runs = [(up, 3 * np.sin(REV * 5.0 * up) + 5), (down, 3 * np.sin(REV * 5.0 * down) - 7)]
    cycles, size = mean_spectrum(runs)
    assert cycles[size.argmax()] == pytest.approx(5.0, abs=0.01)
    assert size.max() == pytest.approx(3.0, rel=0.02) and size[0] < 0.1


def test_a_log_before_any_fit_shows_both_flanks_and_its_waves():
    rig = paper_rig(0, PassMotion(reversal_deg=4 * 360.0))
    log = replace(rig, rate_hz=500.0).log(0)
    figure = plot_log(log)
    figure.draw_without_rendering()
    top, bottom = figure.axes
    assert legend_texts(top) == ["flank A", "flank B"]
    assert "before any fit" in figure.get_suptitle() and "[arcsec]" in top.get_ylabel()
    shown = np.concatenate([np.asarray(line.get_ydata()) for line in top.lines])
    assert np.isin(shown, log.transmission_error / ARCSEC).all() and len(shown) > 1000
    cycles, size = (np.asarray(values) for values in bottom.lines[0].get_data())
    near = np.abs(cycles - 45) < 0.5  # the mesh of 45 teeth
    assert size[near].max() > 5 * np.median(size[np.abs(cycles - 45) < 5])
    assert bottom.get_xlim()[1] > 45
    angle = np.arange(12.0)
    log = EncoderLog.from_arrays(angle, angle, angle / 2, pair=Drive(Fraction(1, 2)), unit="deg")
    with pytest.raises(NoAnswerError, match="no run of this log has 16 samples"):
        plot_log(log)
