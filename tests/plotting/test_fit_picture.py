"""Pictures of a curve and of a fit."""

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.figure import Figure
from msgspec.structs import replace as changed

from tests.plotting.axes import data, legend_texts
from vttig_jax.base import ARCSEC, DEG
from vttig_jax.identify.records import GapAtSpeed
from vttig_jax.kinematics import TECurve
from vttig_jax.plotting import plot_te
from vttig_jax.plotting.curves import MOST_POINTS, folded_turns
from vttig_jax.plotting.fit import plot_fit
from vttig_jax.plotting.style import FLANK_COLOURS, unit_size

pytestmark = pytest.mark.smoke


@pytest.mark.parametrize(
    ("unit", "per_rad", "sign"), [("arcsec", 648000 / np.pi, "arcsec"), ("deg", 180 / np.pi, "°")]
)
def test_the_line_is_the_curve_with_its_words(make_curve, unit, per_rad, sign):
    curve = make_curve("B")
    (ax,) = plot_te(curve, unit=unit).axes
    (line,) = ax.lines
    x, y = np.asarray(line.get_xdata()), np.asarray(line.get_ydata())
    np.testing.assert_allclose(x, np.degrees(curve.driving_angle), rtol=1e-13)
    np.testing.assert_allclose(y, curve.transmission_error * per_rad, rtol=1e-13)
    assert ax.get_xlabel() == "driving angle [°]"
    assert ax.get_ylabel() == f"transmission error [{sign}]"
    assert ax.get_title(loc="left") == "transmission error, flank B"
    assert line.get_color() == FLANK_COLOURS["B"] != FLANK_COLOURS["A"]
    with pytest.raises(ValueError, match="`unit` must be arcsec or deg, but is 'mm'"):
        unit_size("mm")


def test_a_curve_on_given_axes_is_thinned_and_has_ticks_at_whole_turns(make_curve):
    (ax,) = plot_te(make_curve("A", 0.0, 7560.0)).axes
    assert np.all(np.asarray(ax.get_xticks()) % 360 == 0)
    assert 5 <= len(ax.get_xticks()) <= 12
    (ax,) = plot_te(make_curve("A", 0.0, 90.0)).axes
    assert np.any(np.asarray(ax.get_xticks()) % 360 != 0)
    figure, curve = Figure(), make_curve("A", points=3 * MOST_POINTS)
    upper, lower = figure.subplots(2)
    assert plot_te(curve, ax=lower, unit="deg") is figure
    assert len(lower.lines) == 1 and not upper.lines
    y = np.asarray(lower.lines[0].get_ydata())
    assert len(y) <= MOST_POINTS
    assert np.ptp(y) == pytest.approx(np.degrees(curve.peak_to_peak), rel=1e-14)


@pytest.mark.parametrize(("unit", "size"), [("arcsec", ARCSEC), ("deg", DEG)])
def test_panels_hold_measured_fitted_and_residual(make_fit, unit, size):
    fit = make_fit()
    axes = plot_fit(fit, unit=unit).axes
    assert len(axes) == 3
    for number, (curve, residual) in enumerate(zip(fit.curves, fit.residuals, strict=True)):
        assert len(axes[number].lines) == 2
        for line, expected in enumerate([0.0, residual]):
            x, y = data(axes[number], line)
            np.testing.assert_allclose(x, curve.driving_angle / DEG, rtol=1e-13)
            np.testing.assert_allclose(
                y, (curve.transmission_error - expected) / size, rtol=1e-10, atol=1e-10
            )
        np.testing.assert_allclose(data(axes[2], number)[1], residual / ARCSEC, rtol=1e-13)


@pytest.mark.parametrize(
    ("angle_deg", "time"),
    [([0, 10, 20, 60, 70, 80], [0, 1, 2, 3, 4, 5]), ([0, 10, 20, 30, 40, 50], [0, 1, 2, 6, 7, 8])],
)
def test_the_fitted_line_breaks_between_far_points(make_fit, angle_deg, time):
    """Once the shaft turns 40° from point to point, and once samples are left out."""
    angle, error = DEG * np.array(angle_deg, float), 1e-5 * np.arange(6.0)
    curve = TECurve("A", angle, error, np.array(time, float))
    fit = replace(make_fit(curves=(curve,)), residuals=(np.zeros(6),))
    x, y = data(plot_fit(fit).axes[0], 1)
    assert np.flatnonzero(np.isnan(y)).tolist() == [3]
    np.testing.assert_allclose(np.delete(x, 3), angle_deg)
    np.testing.assert_allclose(np.delete(y, 3), error / ARCSEC)


def test_panels_share_the_angle_axis_and_show_any_name(make_fit):
    axes = plot_fit(make_fit(), unit="deg").axes
    units = [ax.get_ylabel().partition("[")[2] for ax in axes]
    assert units == ["°]", "°]", "arcsec]"]
    axes[0].set_xlim(100, 200)
    assert all(ax.get_xlim() == (100, 200) for ax in axes)
    figure = plot_fit(make_fit(source=r"run $\nonsense$.csv"))
    figure.draw_without_rendering()
    assert figure.get_suptitle().endswith(r"run $\nonsense$.csv")


def test_panels_of_one_flank_and_of_several_runs(make_fit, make_curve, worm_fit):
    for flank, fit in (("B", make_fit(curves=(make_curve("B"),))), ("A", worm_fit)):
        figure = plot_fit(fit)
        figure.draw_without_rendering()
        words = [ax.get_ylabel() for ax in figure.axes]
        assert words == [f"TE, flank {flank} [arcsec]", "residual [arcsec]"]
        assert all(np.isfinite(data(ax, 0)[1]).all() for ax in figure.axes)
    assert np.isnan(np.asarray(worm_fit.model.offset)[1])  # B was not measured
    curves = (make_curve("A", 0, 400), make_curve("A", 500, 900), make_curve("B", 100, 700))
    axes = plot_fit(make_fit(curves=curves)).axes
    assert [len(ax.lines) for ax in axes] == [4, 2, 3]
    assert [len(legend_texts(ax)) for ax in axes] == [2, 2, 2]
    ax = plot_fit(make_fit(curves=(make_curve("A", points=30_000),) * 2)).axes[0]
    assert len(data(ax, 0)[0]) + len(data(ax, 2)[0]) <= MOST_POINTS
    many = (make_curve("A", points=8),) * (MOST_POINTS // 3)  # each keeps its extremes
    assert len(plot_fit(make_fit(curves=many)).axes[0].lines) == 2 * len(many)


def test_the_span_selects(make_fit):
    fit = make_fit()
    axes = plot_fit(fit, span_deg=(400.0, 700.0)).axes
    assert axes[0].get_xlim() == (400.0, 700.0)
    curve = fit.curves[0]
    inside = (curve.driving_angle >= 400 * DEG) & (curve.driving_angle <= 700 * DEG)
    x, y = data(axes[0], 0)
    np.testing.assert_allclose(x, curve.driving_angle[inside] / DEG)
    np.testing.assert_allclose(y, curve.transmission_error[inside] / ARCSEC)
    rms = np.sqrt(np.mean(fit.residuals[0][inside] ** 2)) / ARCSEC
    assert legend_texts(axes[2])[0] == f"flank A: {rms:.3g}″ rms"

    with pytest.raises(ValueError, match=r"`span_deg` must overlap .* 30° … 1800°, but is 2000°"):
        plot_fit(fit, span_deg=(2000.0, 2100.0))


def test_gaps_at_several_speeds_have_a_panel(make_fit):
    fit = make_fit()
    assert len(plot_fit(fit).axes) == 3
    gaps = tuple(GapAtSpeed(speed_rpm=rpm, value=0.1, std=0.01) for rpm in (10.0, 20.0))
    *above, last = plot_fit(replace(fit, checks=changed(fit.checks, gap_by_speed=gaps))).axes
    assert len(above) == 3 and last.get_title(loc="left") == "gap by speed, beside the delay"
    assert last.lines[0].get_xdata() == pytest.approx([10.0, 20.0])
    assert last.get_xlabel() == "speed of the driving shaft [rpm]"
    low, high = last.get_ylim()
    assert low < 0.1 - 1.96 * 0.01 and high > 0.1 + 1.96 * 0.01
    assert last.get_xlim() != above[0].get_xlim()


def test_a_log_of_many_turns_is_folded(make_fit, make_curve):
    """Over a turn of each shaft: measured means and orders are those of the report."""
    curves = tuple(make_curve(flank, 0.0, 178 * 360.0, 20_000) for flank in ("A", "B"))
    fit = make_fit(curves=curves)
    *folded, residual = plot_fit(fit).axes
    assert len(folded) == 2 and residual.get_xlabel() == "driving angle [turns]"
    for ax, fold in zip(folded, folded_turns(fit), strict=True):
        assert f"angle of the {fold.shaft} shaft" in ax.get_xlabel() and ax.get_xlim() == (0, 360)
        x, y = data(ax, 0)
        np.testing.assert_allclose(x, fold.middle)
        np.testing.assert_allclose(y, fold.measured["A"])
        np.testing.assert_allclose(data(ax, 1)[1], fold.fitted["A"])
    turned = plot_fit(fit, span_deg=(0.0, 720.0)).axes
    assert len(turned) == 3 and "TE, flank A" in turned[0].get_ylabel()
