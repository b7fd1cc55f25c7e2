"""What each controller leaves and over-closes, against the backlash of the exact kinematics.

Encoders are free of noise. Prescribed motion and closed gap decide what the actuator does, so that
the play operator, the cheapest plant, serves wherever the driven shaft does not matter.
"""

import math
from functools import cache
from typing import Any

import numpy as np
import pytest

from tests.control.parts import at
from tests.control.scenarios import (
    CLOSING,
    INSTANT,
    UNQUANTISED,
    HoldShift,
    exact_gap,
    samples_of,
    simulated,
)
from vttig_jax.base.units import DEG
from vttig_jax.control.simulation.result import Simulation

IDEAL = {"plant": "play", "judgement.margin_mm": 0.0, **UNQUANTISED, **INSTANT}

RUNS = (
    *[(30.0, 1080.0), (60.0, 1800.0), (100.0, 1800.0), (100.0, 1764.0)],
    *[(60.0, 733.0), (60.0, 1290.5), (45.0, 2011.0), (80.0, 2800.0), (25.0, 901.0)],
)
"""Speed in rpm and angle in degrees: as in the paper, but for whole hunting periods, and reversals
whose turn falls between two samples."""


def reversal(speed: float, angle: float, **motion: Any) -> dict[str, Any]:
    values = {"speed_rpm": speed, "reversal_deg": angle, "dwell_s": 0.2, "ramp_s": 0.5} | motion
    return {f"motion.{name}": value for name, value in values.items()}


# The paper's controller.


@pytest.fixture(scope="module")
def papers() -> list[Simulation]:
    """The paper's controller with ideal encoders and an instantaneous actuator."""
    margin = {"motion.dwell_s": 0.0, "judgement.margin_mm": 0.05}
    changes: list[dict[str, float]] = [{}, margin]
    return [simulated(IDEAL, reversal(*run), more) for run in RUNS for more in changes]


def asked(run: Simulation, detected: float) -> float:
    """Backlash that the controller means to take up, rad: j(detected) less its margin."""
    return exact_gap(detected) - float(run.case.controller.margin_mm) * CLOSING  # pyright: ignore


def test_the_paper_controller_leaves_what_the_gap_has_grown_since_it_judged(papers):
    left = np.array([run.accumulators.residual_gap for run in papers])
    grown = np.array(
        [
            exact_gap(run.case.motion.at(run.case.motion.turn_s).angle)
            - asked(run, run.accumulators.detection)
            for run in papers
        ]
    )
    np.testing.assert_allclose(left, np.maximum(grown, 0.0), rtol=0, atol=1e-9)
    assert (grown > 1e-5).sum() > 3 and (grown < -1e-5).sum() > 3  # both signs are among them


def test_the_paper_controller_wants_further_by_what_the_gap_has_shrunk_on_the_way(papers):
    for run in papers:
        closed = samples_of(run).command > 0
        first = int(np.argmax(closed))
        last = first + int(np.argmin(closed[first:]))
        assert samples_of(run).driving[first] == run.accumulators.detection
        path = samples_of(run).driving[
            first + 1 : last + 1
        ]  # a period later it is where it was told
        shrunk = asked(run, run.accumulators.detection) - exact_gap(path)
        beyond = np.max(shrunk, initial=0.0)
        assert run.accumulators.interference * CLOSING == pytest.approx(beyond, abs=1e-9)
    interference = np.array([run.accumulators.interference for run in papers])
    assert (interference > 0.05).sum() > 3 and (interference == 0).sum() > 3


# The jump.


def shift_at_crossing(run: Simulation) -> float:
    """Axial displacement where the other flank is met, mm; evenly in time between two samples."""
    motion, samples, crossing = run.case.motion, samples_of(run), float(run.accumulators.crossing)
    turned = samples.time > float(motion.turn_s)
    after = int(np.argmax(turned & (samples.driving < crossing)))
    point = motion.at(samples.time[after - 1])
    speed, gain = float(point.speed), float(point.acceleration)
    way = crossing - samples.driving[after - 1]
    spent = (-speed - math.sqrt(speed**2 + 2 * gain * way)) / gain
    share = spent / float(run.case.period)
    assert 0.0 <= share <= 1.0
    return float(samples.reached[after - 1] * (1 - share) + samples.reached[after] * share)


def test_the_jump_is_the_backlash_at_the_crossing_less_what_the_actuator_has_closed(papers):
    open_, closed = (
        [run for run in papers if (run.accumulators.residual_gap > 1e-6) == left] for left in (1, 0)
    )
    assert len(open_) > 5 and len(closed) > 5
    for run in open_:
        expected = exact_gap(run.accumulators.crossing) - CLOSING * shift_at_crossing(run)
        assert run.accumulators.gap == pytest.approx(expected, abs=1e-9)
    np.testing.assert_allclose([run.accumulators.gap for run in closed], 0.0, atol=1e-9)


@pytest.mark.parametrize(("plant", "shift_mm"), [("play", 0.0), ("rigid", 0.0), ("rigid", 0.1)])
def test_the_jump_is_the_backlash_where_it_is_crossed_less_a_shift_that_is_held(plant, shift_mm):
    table, holding = {"plant": plant, **UNQUANTISED}, HoldShift(np.asarray(shift_mm))
    runs = [simulated(table, reversal(*run), controller=holding) for run in RUNS[3:7]]
    jumps = np.array([run.accumulators.gap for run in runs])
    gaps = exact_gap(np.array([run.accumulators.crossing for run in runs]))
    np.testing.assert_allclose(jumps, gaps - CLOSING * shift_mm, rtol=0, atol=1e-9)


# The predictive controller, with the counts of the encoders and the actuator of the defaults.

MOTIONS: dict[str, dict[str, Any]] = {
    "trapezoid": {},
    "s_curve": {"motion.kind": "s_curve"},
    "sine": {"motion.kind": "sine"},
    "no dwell": {"motion.dwell_s": 0.0},
    "emergency_stop": {"motion.event": "emergency_stop"},
    "aborted": {"motion.event": "aborted"},
    "slow_down": {"motion.event": "slow_down"},
}
SPEEDS = (10.0, 60.0, 100.0)
MEAN_GAP = 0.038 * DEG


@cache
def predicted(name: str) -> list[Simulation]:
    """A motion at each speed, to the right and to the left of a third of a turn of the wheel."""
    table = {"plant": "play", "controller": "predictive"}
    turns = [reversal(speed, 24.0 * speed + 100.0) for speed in SPEEDS]
    return [simulated(table, turn, MOTIONS[name]) for turn in turns]


@pytest.mark.parametrize("name", MOTIONS)
def test_prediction_never_interferes_and_leaves_little(name):
    for run in predicted(name):
        assert run.accumulators.interference == 0.0
        if name == "slow_down":
            assert np.isnan(run.accumulators.residual_gap)
        else:
            assert 0.0 <= run.accumulators.residual_gap <= 0.05 * MEAN_GAP


@pytest.mark.parametrize("name", ["slow_down", "aborted"])
def test_prediction_opens_again_when_the_shaft_only_slows_down(name):
    for run in predicted(name):
        time, motion = samples_of(run).time, run.case.motion
        speed = at(motion, time).speed
        full = np.abs(speed - speed.max()) < 1e-9 * speed.max()
        slow = int(np.argmin(full[np.argmax(full) :]) + np.argmax(full))
        again = int(slow + np.argmax(full[slow:]))
        braked = int(again + np.argmin(full[again:]))
        assert time[again] - time[slow] > 0.1 and time[braked] - time[again] > 0.5
        assert samples_of(run).reached[slow:again].max() > 0.01
        assert np.abs(samples_of(run).reached[again + 100 : braked]).max() < 1e-12
        assert samples_of(run).reached[braked:].max() > 0.01
