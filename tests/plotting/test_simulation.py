from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.colors import to_rgb

from tests.control.texts import MINIMAL
from tests.plotting.axes import data
from vttig_jax.control import Simulation, parse_scenario_spec, simulate
from vttig_jax.plotting import plot
from vttig_jax.plotting.simulation import plot_simulation
from vttig_jax.rig import paper_pair

FLANK_B, FLANK_A, TRUE = 1, 2, 3
"""Places of the lines in a panel of the transmission error; 0 is what the encoders show."""


@pytest.fixture(scope="module")
def run() -> Simulation:
    """Two turns, a dwell of 2 s and back; the paper's controller closes too far."""
    motion = {"motion": {"reversal_deg": 720.0}}
    spec = parse_scenario_spec({**MINIMAL, "plant": "play", "flanks": "closed", **motion})
    return simulate(spec, paper_pair(), trace_every=1)


@pytest.fixture(scope="module")
def panels(run) -> list[Axes]:
    """The whole run; transmission error, shift and speed, each at the brakes and at the turn."""
    return plot_simulation(run).axes


def with_times(run: Simulation, **times: float) -> Simulation:
    """The run with other landmarks of its motion."""
    motion = replace(run.case.motion, **{name: np.asarray(one) for name, one in times.items()})
    return replace(run, case=replace(run.case, motion=motion))


def marks(ax: Axes) -> list[float]:
    """Times of the vertical lines."""
    found = [np.asarray(line.get_xdata()) for line in ax.lines]
    return sorted({float(x[0]) for x in found if len(x) == 2 and x[0] == x[1]})


def words(figure: Any) -> list[list[str]]:
    """Those of the legends, a list a row."""
    found = [ax.get_legend() for ax in figure.axes]
    return [[text.get_text() for text in one.get_texts()] for one in found if one]


def test_transmission_error_is_that_of_the_metrics_and_lies_between_the_flanks(run, panels):
    shown = data(panels[0], 0)[1]
    assert shown[0] == 0
    assert shown.max() == pytest.approx(run.metrics["te_max_deg"])
    assert shown.min() == pytest.approx(run.metrics["te_min_deg"])
    in_arcsec = data(plot_simulation(run, unit="arcsec").axes[0], 0)[1]
    np.testing.assert_allclose(in_arcsec, 3600 * shown, rtol=1e-12)
    time, error = data(panels[0], TRUE)
    lower, upper = (np.interp(time, *data(panels[0], line)) for line in (FLANK_A, FLANK_B))
    assert (error >= lower - 1e-9).all() and (error <= upper + 1e-9).all()
    before, after = (time > 0.6) & (time < 1.9), (time > 5.0) & (time < 6.4)
    np.testing.assert_allclose(error[before], lower[before], atol=1e-9)
    np.testing.assert_allclose(error[after], upper[after], atol=1e-9)
    assert (upper - lower)[before].min() > 0.01 and (upper - lower)[after].min() > 0.01


def test_the_close_views_hold_the_ramps_and_marks(run, panels):
    whole, brakes, turns = panels[:3]
    assert whole.get_xlim() == (0, 9)
    assert brakes.get_xlim() == pytest.approx((1.9, 2.65), abs=0.01)
    assert turns.get_xlim() == pytest.approx((4.4, 5.15), abs=0.01)
    for ax in panels[3:]:
        assert ax.get_xlim() in (brakes.get_xlim(), turns.get_xlim())
    closes = float(run.accumulators.detection_s)
    assert marks(whole) == []
    for left, right in zip(panels[1::2], panels[2::2], strict=True):
        assert left.get_ylim() == right.get_ylim()
        assert marks(left) == pytest.approx([2.0, closes])
        assert marks(right) == pytest.approx([4.5])


def test_what_is_commanded_beyond_the_closed_gap_is_filled_and_speeds_are_shown(run, panels):
    shift = panels[3]
    closed, commanded, reached = (data(shift, line) for line in range(3))
    too_far = np.maximum(commanded[1] - closed[1], 0).max()
    assert too_far == pytest.approx(run.metrics["interference_mm"], rel=0.02)
    assert (reached[1] <= closed[1] + 1e-9).all()
    after = closed[0] > 2.1  # the play is taken up
    np.testing.assert_allclose(reached[1][after], closed[1][after], atol=1e-9)
    (beyond,) = (c for c in shift.collections if isinstance(c, PolyCollection))
    colour = np.ravel(np.asarray(beyond.get_facecolor()))[:3]
    np.testing.assert_allclose(colour, to_rgb(shift.lines[0].get_color()))
    box = beyond.get_paths()[0].get_extents()
    assert box.y1 == pytest.approx(commanded[1].max())
    time, speed = data(panels[5], 1)
    np.testing.assert_allclose(speed, np.interp(time, [2.0, 2.5], [60.0, 0.0]), atol=1e-9)
    assert 0 < np.abs(data(panels[5], 0)[1] - speed).max() < 5  # what the observer sees


def test_a_span_of_your_own_and_views_that_meet_are_one(run):
    for figure, span in (
        (plot(run, span_s=(2.0, 2.1)), (2.0, 2.1)),
        (plot_simulation(with_times(run, turn_s=2.55)), (1.9, 3.2)),
        (plot_simulation(with_times(run, braking_s=4.5)), (4.482, 4.617)),  # no ramp at all
    ):
        assert len(figure.axes) == 4
        assert figure.axes[1].get_xlim() == pytest.approx(span, abs=0.01)
    time, _ = data(plot(run, span_s=(2.0, 2.1)).axes[1], TRUE)
    assert len(time) == pytest.approx(101, abs=3)
    words = "`span_s` must hold two samples or more of the 0 … 9 s"
    for span_s in ((3.0, 2.0), (2.0, 2.0), (20.0, 30.0), (2.0001, 2.0004)):
        with pytest.raises(ValueError, match=words):
            plot_simulation(run, span_s=span_s)
    with pytest.raises(ValueError, match="`trace_every` must be at least 1"):
        plot_simulation(replace(run, trace=None))


@pytest.mark.parametrize("times", [{"turn_s": 9.0}, {"turn_s": 9.0, "braking_s": 9.0}])
def test_without_a_turn_the_whole_run_is_shown_alone(run, times):
    panels = plot_simulation(with_times(run, **times)).axes
    assert [ax.get_xlim() for ax in panels] == [(0, 9)] * 3
    closes = float(run.accumulators.detection_s)
    assert marks(panels[0]) == pytest.approx([*([] if "braking_s" in times else [2.0]), closes])


def test_where_the_drive_blocks_the_picture_ends(run):
    blocked = replace(run.accumulators, blocked=np.asarray(True), blocked_s=np.asarray(2.4))
    figure = plot_simulation(replace(run, accumulators=blocked))
    assert len(figure.axes) == 4
    assert figure.axes[1].get_xlim() == pytest.approx((1.9, 2.4), abs=0.01)
    assert marks(figure.axes[1])[-1] == 2.4
    assert "drive blocks" in words(figure)[0] and "outcome bound" in figure.get_suptitle()
