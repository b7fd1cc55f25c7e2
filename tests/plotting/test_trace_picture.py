from dataclasses import replace

import numpy as np
import pytest

from tests.posterior.made import quick_posterior
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
    assert len(words) == len(posterior.chains.header.names) + 1
    assert {"log innovation std", "log width driven", "log density"} <= set(words)


def test_each_ensemble_has_its_colour_and_its_mean(figure, posterior):
    chains = posterior.chains
    place = chains.header.names.index("log_innovation_std")
    (ax,) = [ax for ax in figure.axes if ax.get_title(loc="left") == "log innovation std"]
    lines = thick(ax)
    assert [line.get_color() for line in lines] == list(COLOURS[:4])
    for ensemble, line in enumerate(lines):
        expected = chains.draws[ensemble, :, :, place].mean(axis=1)
        np.testing.assert_allclose(line.get_ydata(), expected)
    walkers = [drawn.get_segments() for drawn in ax.collections]
    assert [len(one) for one in walkers] == [12] * 4  # at most twelve of an ensemble
    own = chains.draws[0, :, :, place]
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
    names = [f"ensemble {k}" for k in (1, 2, 3, 4)]
    assert [text.get_text() for text in legend.get_texts()] == names
    top = legend.get_window_extent().y1  # below everything
    assert all(ax.get_tightbbox().y0 >= top - 1 for ax in shown)


def with_draws(posterior, draws: np.ndarray):
    """The posterior with other stored steps."""
    record = replace(posterior.chains.record, draws=draws, log_density=np.zeros(draws.shape[:3]))
    return replace(posterior, chains=replace(posterior.chains, record=record))


def test_an_ensemble_that_stands_apart_is_seen(posterior):
    draws = posterior.chains.record.draws.copy()
    draws[2, ..., 0] += 10.0
    names = posterior.chains.header.names[:1]
    ax = plot_trace(with_draws(posterior, draws), names=names).axes[0]
    levels = [np.mean(line.get_ydata()) for line in thick(ax)]
    assert abs(levels[1] - levels[0]) < 1 < levels[2] - levels[0]


def test_long_traces_are_thinned_and_unknown_names_refused(posterior):
    long = with_draws(posterior, np.tile(posterior.chains.record.draws, (1, 100, 1, 1)))
    ax = plot_trace(long, names=("log_innovation_std",)).axes[0]
    steps = long.chains.draws.shape[1]
    assert steps > 2000 and 1000 <= len(thick(ax)[0].get_xdata()) <= steps // 2
    with pytest.raises(ValueError, match="`names`"):
        plot_trace(posterior, names=("nonesuch",))
