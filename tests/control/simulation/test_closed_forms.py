"""What each controller leaves and over-closes, against the backlash of the exact kinematics.

Encoders are free of noise. Prescribed motion and closed gap decide what the actuator does, so that
the play operator, the cheapest plant, serves wherever the driven shaft does not matter.
"""

import math
from typing import Any

import numpy as np
import pytest

from tests.control.motion_points import at
from tests.control.scenarios import (
    CLOSING,
    INSTANT,
    UNQUANTISED,
    HoldShift,
    Run,
    exact_gap,
    spec_of,
    together,
)
from vttig_jax.base.units import DEG

IDEAL = {"plant": "play", "judgement.margin_mm": 0.0, **UNQUANTISED, **INSTANT}

PAPER = ((10.0, 1080.0), (30.0, 3600.0), (60.0, 7560.0), (100.0, 7560.0), (100.0, 7524.0))
"""Speed in rpm and angle in degrees of the five runs of the paper."""

ELSEWHERE = ((60.0, 733.0), (60.0, 1290.5), (45.0, 2011.0), (80.0, 4000.0), (25.0, 901.0))
"""Reversals whose turn falls between two samples."""


def reversal(speed: float, angle: float, **motion: Any) -> dict[str, Any]:
    values = {"speed_rpm": speed, "reversal_deg": angle, "dwell_s": 0.2, "ramp_s": 0.5} | motion
    return {f"motion.{name}": value for name, value in values.items()}


def turn_angle(run: Run) -> float:
    """Driving angle of the turn, rad, from the scenario alone."""
    return float(run.case.motion.at(run.case.motion.turn_s).angle)


# The paper's controller.

NEVER = {"judgement.threshold_rad_s2": 1e6}
"""Judges nothing a deceleration."""


@pytest.fixture(scope="module")
def all_papers() -> list[Run]:
    """The paper's controller with ideal encoders and an instantaneous actuator."""
    places = PAPER + ELSEWHERE
    specs = [spec_of(IDEAL, reversal(*run)) for run in places]
    margin = {"judgement.margin_mm": 0.05}
    specs += [spec_of(IDEAL, reversal(*run, dwell_s=0.0), margin) for run in places]
    specs += [spec_of(IDEAL, reversal(*run), NEVER) for run in ELSEWHERE[:2]]
    return together(specs, after_turn_s=1.0)


@pytest.fixture(scope="module")
def papers(all_papers) -> list[Run]:
    """Those that close."""
    return all_papers[: 2 * len(PAPER + ELSEWHERE)]


def asked(run: Run, detected: float) -> float:
    """Backlash that the controller means to take up, rad: j(detected) less its margin."""
    return exact_gap(detected) - float(run.case.controller.margin_mm) * CLOSING  # pyright: ignore


def test_the_paper_controller_leaves_what_the_gap_has_grown_since_it_judged(papers):
    left = np.array([run.tally.residual_gap for run in papers])
    grown = np.array(
        [exact_gap(turn_angle(run)) - asked(run, run.tally.detection) for run in papers]
    )
    np.testing.assert_allclose(left, np.maximum(grown, 0.0), rtol=0, atol=1e-9)
    assert (grown > 1e-5).sum() > 3 and (grown < -1e-5).sum() > 3  # both signs are among them


def test_the_paper_controller_wants_further_by_what_the_gap_has_shrunk_on_the_way(papers):
    for run in papers:
        closed = run.samples.command > 0
        first = int(np.argmax(closed))
        last = first + int(np.argmin(closed[first:]))
        assert run.samples.driving[first] == run.tally.detection
        path = run.samples.driving[first + 1 : last + 1]  # a period later it is where it was told
        shrunk = asked(run, run.tally.detection) - exact_gap(path)
        beyond = np.max(shrunk, initial=0.0)
        assert run.tally.interference * CLOSING == pytest.approx(beyond, abs=1e-9)
    interference = np.array([run.tally.interference for run in papers])
    assert (interference > 0.05).sum() > 3 and (interference == 0).sum() > 3


def test_the_paper_controller_holds_its_shift_from_the_detection_to_the_turn(papers):
    for run in papers:
        motion, time = run.case.motion, run.samples.time
        held = (time >= run.tally.detection_s) & (time < float(motion.turn_s))
        expected = asked(run, run.tally.detection) / CLOSING
        np.testing.assert_allclose(run.samples.command[held], expected, atol=1e-9 / CLOSING)
        before = (time >= float(motion.braking_s)) & (time < run.tally.detection_s)
        assert np.all(run.samples.command[before] == 0.0)


@pytest.mark.slow
def test_at_half_of_all_reversals_the_paper_controller_interferes():
    """With the counts of the encoders and the actuator of the defaults; 0.5 s ramp at 60 rpm."""
    angles = np.random.default_rng(20).uniform(400.0, 400.0 + 5760.0, 64).tolist()
    table = {"plant": "play", "judgement.margin_mm": 0.0}
    runs = together([spec_of(table, reversal(60.0, angle)) for angle in angles], after_turn_s=0.1)
    interference = np.array([run.tally.interference for run in runs])
    assert 0.4 < np.mean(interference > 0.01) < 0.6
    assert 0.3 < interference.max() < 0.4  # mm; the map allows 0.39


# The jump.


def shift_at_crossing(run: Run) -> float:
    """Axial displacement where the other flank is met, mm; evenly in time between two samples."""
    motion, samples, crossing = run.case.motion, run.samples, float(run.tally.crossing)
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
        [run for run in papers if (run.tally.residual_gap > 1e-6) == left] for left in (1, 0)
    )
    assert len(open_) > 5 and len(closed) > 5
    for run in open_:
        expected = exact_gap(run.tally.crossing) - CLOSING * shift_at_crossing(run)
        assert run.tally.gap == pytest.approx(expected, abs=1e-9)
    np.testing.assert_allclose([run.tally.gap for run in closed], 0.0, atol=1e-9)


def test_of_the_play_operator_the_jump_is_the_backlash_where_it_is_crossed(all_papers):
    for run in all_papers[-2:]:
        assert run.tally.gap == pytest.approx(exact_gap(run.tally.crossing), abs=1e-9)
        assert run.tally.gap / 0.5625 == pytest.approx(
            turn_angle(run) - run.tally.crossing, rel=1e-3
        )  # the way through the gap, but for what the flanks themselves move


def test_of_rigid_teeth_the_jump_is_the_backlash_where_it_is_crossed_less_the_shift():
    table = {"plant": "rigid", **UNQUANTISED}
    holding = [HoldShift(np.asarray(shift)) for shift in (0.0, 0.1)]
    specs = [spec_of(table, reversal(*run)) for run in (PAPER[0], *ELSEWHERE) for _ in holding]
    runs = together(specs, controllers=holding, after_turn_s=0.5)
    jumps = np.array([run.tally.gap for run in runs]).reshape(-1, 2)
    gaps = exact_gap(np.array([run.tally.crossing for run in runs])).reshape(-1, 2)
    np.testing.assert_allclose(jumps, gaps - CLOSING * np.array([0.0, 0.1]), rtol=0, atol=1e-9)
    assert np.all(np.ptp(jumps, axis=0) > 1e-4)  # they are not all the same


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
SPEEDS = (10.0, 30.0, 60.0, 100.0)
MEAN_GAP = 0.038 * DEG


@pytest.fixture(scope="module")
def predicted() -> dict[str, list[Run]]:
    """Each motion at each speed, two turns of the wheel to the right and to the left of a third."""
    table = {"plant": "play", "controller": "predictive"}
    specs = [
        spec_of(table, reversal(speed, 24.0 * speed + 100.0), motion)
        for motion in MOTIONS.values()
        for speed in SPEEDS
    ]
    runs = together(specs)
    size = len(SPEEDS)
    return {name: runs[n * size : (n + 1) * size] for n, name in enumerate(MOTIONS)}


@pytest.mark.parametrize("name", MOTIONS)
def test_prediction_never_interferes_and_leaves_little(predicted, name):
    for run, speed in zip(predicted[name], SPEEDS, strict=True):
        assert run.tally.interference == 0.0, speed
        if name == "slow_down":
            assert np.isnan(run.tally.residual_gap)
        else:
            assert 0.0 <= run.tally.residual_gap <= 0.05 * MEAN_GAP, speed


@pytest.mark.parametrize("name", ["slow_down", "aborted"])
def test_prediction_opens_again_when_the_shaft_only_slows_down(predicted, name):
    for run in predicted[name]:
        time, motion = run.samples.time, run.case.motion
        speed = at(motion, time).speed
        full = np.abs(speed - speed.max()) < 1e-9 * speed.max()
        slow = int(np.argmin(full[np.argmax(full) :]) + np.argmax(full))
        again = int(slow + np.argmax(full[slow:]))
        braked = int(again + np.argmin(full[again:]))
        assert time[again] - time[slow] > 0.1 and time[braked] - time[again] > 0.5
        assert run.samples.reached[slow:again].max() > 0.01
        assert np.abs(run.samples.reached[again + 100 : braked]).max() < 1e-12
        assert run.samples.reached[braked:].max() > 0.01


def test_the_measure_of_what_is_left_can_fail(papers):
    assert any(run.tally.residual_gap > 0.05 * MEAN_GAP for run in papers)
