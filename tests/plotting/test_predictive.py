from dataclasses import replace

import numpy as np
import pytest

from tests.posterior.made import made_posterior, quick_fit
from vttig_jax.base.units import ARCSEC
from vttig_jax.plotting.dispatch import plot
from vttig_jax.plotting.predictive import plot_predictive
from vttig_jax.posterior.summary.predictive import predictive


@pytest.fixture(scope="module")
def found():
    return predictive(made_posterior(quick_fit(), chosen=300), 60)


@pytest.fixture(scope="module")
def figure(found):
    figure = plot(found)
    figure.draw_without_rendering()
    return figure


def test_a_panel_a_flank_then_the_difference_and_the_memory(figure):
    labels = [ax.get_ylabel() for ax in figure.axes]
    assert labels == [
        "TE, flank A [arcsec]",
        "TE, flank B [arcsec]",
        "residual [arcsec]",
        "autocorrelation",
    ]
    assert figure.axes[-1].get_xlabel() == "lag [blocks]"


def test_means_outside_the_interval_are_marked(figure, found):
    curve, low, high = found.curves[0], found.low[0], found.high[0]
    first = curve.driving_angle <= curve.driving_angle.min() + 4 * np.pi
    error = curve.transmission_error
    outside = ((error < low) | (error > high)) & first
    dots, rings = figure.axes[0].lines
    assert len(dots.get_xdata()) == first.sum()
    assert len(rings.get_xdata()) == outside.sum() > 0
    np.testing.assert_allclose(
        np.sort(rings.get_ydata()), np.sort(error[outside] / ARCSEC), atol=1e-9
    )


def test_the_words_give_the_share_and_what_was_expected(figure, found):
    words = figure.axes[2].get_title(loc="left")
    share = found.share
    assert words == (
        f"within 1.96 std of a draw: {100 * share.measured:.1f} %"
        f" (replicates {100 * share.low:.1f} % … {100 * share.high:.1f} %)"
    )
    assert f"{found.outside_lags} of {len(found.correlation)} lags outside" in figure.axes[
        3
    ].get_title(loc="left")


def test_the_memory_is_that_of_the_check(figure, found):
    (line, _) = figure.axes[3].lines
    np.testing.assert_allclose(line.get_ydata(), found.correlation)


def test_degrees_and_more_turns(found):
    degrees = plot_predictive(found, unit="deg", turns=4.0)
    assert degrees.axes[0].get_ylabel() == "TE, flank A [°]"
    low, high = degrees.axes[0].get_xlim()
    assert high - low > 1440


def test_one_flank_has_three_panels(found):
    parts = ("curves", "centre", "low", "high")
    one = replace(found, **{name: getattr(found, name)[:1] for name in parts})
    assert len(plot_predictive(one).axes) == 3


def test_legends_and_titles_do_not_overlap(figure):
    for ax in figure.axes:
        box = ax.get_legend().get_window_extent()
        assert box.y0 >= ax.get_window_extent().y1 - 1
        title = ax._left_title.get_window_extent()
        assert not ax.get_title(loc="left") or title.x1 < box.x0


def test_no_turns_are_refused(found):
    with pytest.raises(ValueError, match="`turns` must be positive"):
        plot_predictive(found, turns=0.0)
