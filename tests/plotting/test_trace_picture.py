from dataclasses import replace

import numpy as np
import pytest

from tests.posterior.made import quick_posterior
from vttig_jax.plotting.corner_picture import picture_unit
from vttig_jax.plotting.style import COLOURS
from vttig_jax.plotting.trace_picture import plot_trace


@pytest.fixture(scope="module")
def posterior():
    return quick_posterior()


@pytest.fixture(scope="module")
def figure(posterior):
    return plot_trace(posterior)


def thick(ax) -> list:
    return [line for line in ax.lines if line.get_linewidth() > 1]


def test_every_coordinate_and_the_log_density_has_a_panel(figure, posterior):
    words = [ax.get_title(loc="left") for ax in figure.axes if ax.axison]
    assert len(words) == len(posterior.names) + 1
    assert words[0] == "constant backlash [°]"
    assert {"driving x [µm]", "partial 2", "log density"} <= set(words)


def test_the_delay_is_the_whole_delay(posterior):
    """The coordinate is what is left of it after the fit has removed a part."""
    names = tuple("delay" if name == "driving_x" else name for name in posterior.names)
    moved = replace(posterior, names=names, delay_offset_s=0.25)
    (ax, *_) = plot_trace(moved, names=["delay"]).axes
    low, high = ax.get_ylim()
    assert (
        low < (0.25 + posterior.values("driving_x").mean()) / picture_unit(moved, "delay")[1] < high
    )


def test_each_ensemble_has_its_colour_and_its_mean(figure, posterior):
    place = posterior.names.index("driving_x")
    (ax,) = [ax for ax in figure.axes if ax.get_title(loc="left") == "driving x [µm]"]
    lines = thick(ax)
    assert [line.get_color() for line in lines] == list(COLOURS[:3])
    for ensemble, line in enumerate(lines):
        expected = posterior.draws[ensemble, :, :, place].mean(axis=1) / 1e-3
        np.testing.assert_allclose(line.get_ydata(), expected)
    walkers = [drawn.get_segments() for drawn in ax.collections]
    assert [len(one) for one in walkers] == [12] * 3  # at most twelve of an ensemble
    own = posterior.draws[0, :, :, place] / 1e-3
    assert any(np.allclose(walkers[0][0][:, 1], own[:, k]) for k in range(own.shape[1]))


def test_nothing_overlaps(figure):
    figure.draw_without_rendering()
    shown = [ax for ax in figure.axes if ax.axison]
    boxes = [ax.get_tightbbox() for ax in shown]
    (legend,) = figure.legends
    boxes += [legend.get_window_extent(), figure._suptitle.get_window_extent()]
    for index, box in enumerate(boxes):
        assert all(not box.overlaps(other) for other in boxes[:index])
        assert 0 <= box.xmin < box.xmax <= figure.bbox.xmax
        assert 0 <= box.ymin < box.ymax <= figure.bbox.ymax


def test_an_ensemble_that_stands_apart_is_seen(posterior):
    from dataclasses import replace

    draws = posterior.draws.copy()
    draws[2, ..., 0] += 0.01
    ax = plot_trace(replace(posterior, draws=draws), names=posterior.names[:1]).axes[0]
    levels = [np.mean(line.get_ydata()) for line in thick(ax)]
    assert abs(levels[1] - levels[0]) < 1e-3 < levels[2] - levels[0]


def test_long_traces_are_thinned(posterior):
    long = made_posterior(posterior.fit, ensembles=2, steps=2500, walkers=2)
    ax = plot_trace(long, names=("driving_x",)).axes[0]
    assert len(thick(ax)[0].get_xdata()) == 1250 and thick(ax)[0].get_xdata()[-1] == 2498


def test_the_legend_stands_below_everything(figure):
    figure.draw_without_rendering()
    (legend,) = figure.legends
    assert [text.get_text() for text in legend.get_texts()] == [f"ensemble {k}" for k in (1, 2, 3)]
    top = legend.get_window_extent().y1
    assert all(ax.get_tightbbox().y0 >= top - 1 for ax in figure.axes if ax.axison)


def test_an_unknown_name_is_refused(posterior):
    with pytest.raises(ValueError, match="must be one of"):
        plot_trace(posterior, names=("nonesuch",))
