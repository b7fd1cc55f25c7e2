from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
from scipy.signal import lfilter

from vttig_jax.base.errors import NoAnswerError
from vttig_jax.base.units import ARCSEC, DEG, REV
from vttig_jax.logs.encoder_log import EncoderLog
from vttig_jax.logs.lines.search import Line
from vttig_jax.pair.gear_pair import Drive
from vttig_jax.plotting.residual import (
    amplitude_spectrum,
    autocorrelation,
    plot_log,
    residual_picture,
)
from vttig_jax.rig.motion import PassMotion
from vttig_jax.rig.paper import paper_rig

ANGLE = REV * np.linspace(0.0, 10.0, 1000)
NOISE = np.random.default_rng(0).standard_normal(1000) * ARCSEC
LINE = Line(3.09, 0.001, 5.0, 0.1, 0.0, 1e-9)


def test_three_panels_and_their_words():
    figure = residual_picture(
        [ANGLE, ANGLE],
        [NOISE, -NOISE],
        highest=8.0,
        whitened=[NOISE, -NOISE],
        order=0,
        lines=[LINE],
        labels=["A", "B"],
        name="rig",
        source="log.csv",
    )
    figure.draw_without_rendering()
    axes = figure.axes
    assert figure.get_suptitle() == "residual, which should look like noise · rig · log.csv"
    assert [ax.get_ylabel() for ax in axes] == [
        "residual [arcsec]",
        "autocorrelation",
        "amplitude [arcsec]",
    ]
    assert [ax.get_xlabel() for ax in axes] == [
        "driving angle [°]",
        "lag [rows]",
        "cycles per driving revolution",
    ]
    legend = axes[0].get_legend()
    assert legend is not None and [t.get_text() for t in legend.get_texts()] == [
        "flank A",
        "flank B",
    ]
    x, y = axes[0].lines[0].get_data()
    np.testing.assert_allclose(np.asarray(x), ANGLE / DEG)
    np.testing.assert_allclose(np.asarray(y), NOISE / ARCSEC)
    assert axes[2].get_title(loc="left") == "1 line found"
    assert [text.get_text() for text in axes[2].texts] == ["3.09"]
    assert axes[2].get_ylim()[1] > 5.0


def test_without_lines_and_names():
    figure = residual_picture(
        [ANGLE], [np.zeros(1000)], highest=8.0, whitened=[np.zeros(1000)], order=0
    )
    figure.draw_without_rendering()
    assert figure.axes[2].get_title(loc="left") == "no line that the noise does not explain"
    assert figure.axes[0].get_legend() is None


def test_the_correlation_of_whitened_rows_stays_in_the_band():
    """And leaves it where the rows are not whitened."""
    path = np.asarray(lfilter([1.0], [1.0, -0.9], np.random.default_rng(1).standard_normal(4000)))
    white = [np.convolve(part, [1.0, -0.9], "valid") for part in (path[:1500], path[1500:])]
    found, pairs = autocorrelation(white, 60)
    assert found[0] == 1 and len(found) == 61
    assert np.mean(np.abs(found[1:]) < 1.96 / np.sqrt(pairs[1:])) > 0.85
    assert pairs[5] == 1499 - 5 + 2499 - 5
    raw, _ = autocorrelation([path], 60)
    np.testing.assert_allclose(raw[1:4], [0.9, 0.81, 0.729], atol=0.04)


def test_a_log_before_any_fit_shows_both_flanks_and_its_waves():
    rig = paper_rig(0, PassMotion(reversal_deg=4 * 360.0))
    log = replace(rig, rate_hz=500.0).log(0)
    figure = plot_log(log)
    figure.draw_without_rendering()
    top, bottom = figure.axes
    legend = top.get_legend()
    assert legend is not None
    assert [text.get_text() for text in legend.get_texts()] == ["flank A", "flank B"]
    assert "before any fit" in figure.get_suptitle() and "[arcsec]" in top.get_ylabel()
    shown = np.concatenate([np.asarray(line.get_ydata()) for line in top.lines])
    assert np.isin(shown, log.transmission_error / ARCSEC).all() and len(shown) > 1000
    cycles, size = (np.asarray(values) for values in bottom.lines[0].get_data())
    near = np.abs(cycles - 45) < 0.5  # the mesh of 45 teeth
    assert size[near].max() > 5 * np.median(size[np.abs(cycles - 45) < 5])
    assert bottom.get_xlim()[1] > 45


def test_a_log_without_a_run_has_no_picture():
    angle = np.arange(12.0)
    log = EncoderLog.from_arrays(angle, angle, angle / 2, pair=Drive(Fraction(1, 2)), unit="deg")
    with pytest.raises(NoAnswerError, match="no run of this log has 16 samples"):
        plot_log(log)


def test_runs_too_short_to_correlate():
    found, _ = autocorrelation([], 10)
    np.testing.assert_array_equal(found, [0.0])


def test_the_spectrum_is_least_squares_beside_the_means_of_the_runs():
    angles = [REV * np.linspace(0, 3.3, 70), REV * np.linspace(4.1, 6.0, 90)]
    values = [np.sin(2.2 * angles[0]) + 5, np.sin(2.2 * angles[1]) - 7]
    cycles, amplitude = amplitude_spectrum(angles, values, 4.0)
    constants = np.repeat(np.eye(2), [70, 90], axis=0)
    angle, value = np.concatenate(angles), np.concatenate(values)
    for f, found in list(zip(cycles, amplitude, strict=True))[::7]:
        design = np.column_stack([np.cos(f * angle), np.sin(f * angle), constants])
        fitted = np.linalg.lstsq(design, value, rcond=None)[0]
        assert found == pytest.approx(np.hypot(fitted[0], fitted[1]), rel=1e-7)
    assert cycles[np.argmax(amplitude)] == pytest.approx(2.2, abs=0.05)


def test_no_spectrum_below_one_cycle():
    cycles, amplitude = amplitude_spectrum([ANGLE / 100], [NOISE], 8.0)
    assert len(cycles) == len(amplitude) == 0
    figure = residual_picture([ANGLE / 100], [NOISE], highest=8.0, whitened=[NOISE], order=0)
    figure.draw_without_rendering()


@pytest.mark.parametrize(("angles", "residuals"), [([], []), ([ANGLE], [NOISE, NOISE])])
def test_arrays_that_do_not_match(angles, residuals):
    with pytest.raises(ValueError, match=r"`residuals` must hold one array for each"):
        residual_picture(angles, residuals, highest=8.0, whitened=residuals, order=0)
