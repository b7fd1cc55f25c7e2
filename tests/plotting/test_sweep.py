"""The picture of a sweep: its lines are its columns."""

from collections.abc import Mapping

import numpy as np
import pytest
from matplotlib.figure import Figure

from tests.control.sweep_files import table_of
from vttig_jax.plotting import plot
from vttig_jax.plotting.sweep import plot_sweep

pytestmark = pytest.mark.smoke


def lines(figure: Figure, row: int) -> Mapping[str, np.ndarray]:
    found = figure.axes[row].get_lines()
    return {str(line.get_label()): np.asarray(line.get_xydata()) for line in found}


def turns(count: int, times: int) -> np.ndarray:
    return np.repeat(np.linspace(0.0, 360.0, count), times)


def test_one_case_a_place_is_a_line_and_a_long_axis_is_taken_together():
    table = table_of(**{"motion.reversal_deg": turns(5, 1)})
    found = lines(plot(table), 0)
    np.testing.assert_allclose(found["all"][:, 1], table.columns["residual_gap_deg"])
    assert not plot(table).axes[0].collections
    table = table_of(**{"motion.reversal_deg": turns(5000, 1)})
    found = lines(plot_sweep(table), 0)["all"]
    assert len(found) == 400
    assert np.all(np.diff(found[:, 0]) > 0) and np.all(np.diff(found[:, 1]) > 0)


def test_many_cases_a_place_are_a_median_and_a_band():
    table = table_of(**{"motion.reversal_deg": turns(5, 40), "draw": np.tile(np.arange(40), 5)})
    figure = plot_sweep(table)
    for row, metric in enumerate(("residual_gap_deg", "interference_mm")):
        values = table.columns[metric].reshape(5, 40)
        np.testing.assert_allclose(lines(figure, row)["all"][:, 1], np.median(values, axis=1))
        (band,) = figure.axes[row].collections
        heights = np.asarray(band.get_paths()[0].vertices)[:, 1]
        assert heights.min() == pytest.approx(np.quantile(values[0], 0.025))
        assert heights.max() == pytest.approx(np.quantile(values[-1], 0.975))


def test_every_controller_has_its_line_and_missing_values_are_left_out():
    names = np.tile(["none", "predictive"], 6)
    table = table_of(**{"motion.reversal_deg": turns(6, 2), "controller": names})
    table.columns["residual_gap_deg"][0] = np.nan
    found = lines(plot_sweep(table), 0)
    assert list(found) == ["none", "predictive"]
    assert len(found["none"]) == 5 and len(found["predictive"]) == 6
    table.columns["residual_gap_deg"][names == "none"] = np.nan
    assert len(lines(plot_sweep(table), 0)["none"]) == 0


def test_the_axis_is_the_longest_one_or_the_one_asked_for():
    axes = {"motion.speed_rpm": turns(3, 8), "seed": np.tile(np.arange(8), 3)}
    table = table_of(draw=np.arange(24), **axes)
    assert len(lines(plot_sweep(table), 0)) == 3  # speeds
    labels = {"seed": None, "speed [rpm]": "motion.speed_rpm", "draw of the posterior": "draw"}
    for words, axis in labels.items():
        assert plot_sweep(table, axis=axis).axes[1].get_xlabel() == words
    with pytest.raises(ValueError, match=r"`axis` must be one of draw, motion\.speed_rpm, seed"):
        plot_sweep(table, axis="controller")
    with pytest.raises(ValueError, match="axis of numbers"):
        plot_sweep(table_of(controller=np.array(["none", "predictive"])))


def test_colours_are_those_of_a_short_axis_or_the_one_asked_for():
    axes = {"motion.reversal_deg": turns(10, 4), "judgement.margin_mm": np.tile([0.0, 0.01], 20)}
    table = table_of(**axes)
    names = ["judgement.margin_mm = 0.0", "judgement.margin_mm = 0.01"]
    assert list(lines(plot_sweep(table), 0)) == names
    with_texts = table_of(**axes, controller=np.tile(["none", "none", "play", "play"], 10))
    assert list(lines(plot_sweep(with_texts), 0)) == ["none", "play"]
    assert list(lines(plot_sweep(with_texts, by="judgement.margin_mm"), 0)) == names
    with pytest.raises(ValueError, match="`by` must be one of"):
        plot_sweep(table, by="seed")


def test_a_feedforward_controller_has_the_error_of_the_output_below():
    names = np.tile(["none", "feedforward"], 6)
    table = table_of(**{"motion.reversal_deg": turns(6, 2), "controller": names})
    table.columns["output_error_deg"][names == "none"] += 1.0
    figure = plot_sweep(table)
    assert len(figure.axes) == 3
    # Two styles, so that a curve on another one is seen.
    assert len({line.get_linestyle() for line in figure.axes[0].get_lines()}) == 2
    found = lines(figure, 2)
    np.testing.assert_allclose(found["none"][:, 1] - found["feedforward"][:, 1], 1 - 1e-5)
    table.columns["controller"] = np.tile(["none", "predictive"], 6)
    assert len(plot_sweep(table).axes) == 2
