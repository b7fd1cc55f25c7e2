"""Metrics of a run recomputed from its trace, what a trace is, and how a run can end."""

import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from tests.control.scenarios import CLOSING, PAIR, SHORT, exact_gap, samples_of, spec_of
from vttig_jax.base.units import ARCSEC, DEG, REV
from vttig_jax.control.hardware.encoder import noise_draws
from vttig_jax.control.simulation import simulate as simulate_module
from vttig_jax.control.simulation.result import Simulation
from vttig_jax.control.simulation.simulate import simulate

RATIO = 45 / 80
ENCODERS = {"driving_encoder": (20.0, 30.0, 0.8), "driven_encoder": (12.0, 250.0, 1.5)}
"""Amplitude in arcsec, phase in degrees and noise in arcsec."""

NOISY: dict[str, Any] = {
    f"{name}.{key}": value
    for name, values in ENCODERS.items()
    for key, value in zip(("amplitude_arcsec", "phase_deg", "noise_arcsec"), values, strict=True)
}
BASE = {**SHORT, **NOISY, "plant": "play", "motion.reversal_deg": 500.0, "seed": 11}
"""All tests of this file share its compiled programs; play: nothing here is about the plant."""


def simulated(*tables: Any, trace_every: int = 1) -> Simulation:
    return simulate(spec_of(BASE, *tables), PAIR, trace_every=trace_every)


@pytest.fixture(scope="module")
def traced() -> Simulation:
    return simulated()


# What the encoders show.


def readings(run: Simulation) -> np.ndarray:
    """Both encoders, rad, shape (2, samples), from the true angles of the trace."""
    samples = samples_of(run)
    true = np.stack([samples.driving, RATIO * samples.driving + samples.error])
    key = jax.random.key(int(run.scenario.seed))
    noise = np.asarray(jax.vmap(noise_draws, (None, 0))(key, jnp.arange(samples.time.size))).T
    count = REV / 90_000
    shown = [
        angle + ARCSEC * (size * np.sin(angle + phase * DEG) + spread * shock)
        for angle, shock, (size, phase, spread) in zip(true, noise, ENCODERS.values(), strict=True)
    ]
    return np.floor(np.array(shown) / count + 0.5) * count


def tracked(readings: np.ndarray, bandwidth: float, period: float) -> np.ndarray:
    """The tracking filter as prediction matrix and gain vector."""
    pole = math.exp(-2 * math.pi * bandwidth * period)
    gain = np.array(
        [
            1 - pole**3,
            1.5 * (1 - pole) * (1 - pole**2) / period,
            (1 - pole) ** 3 / period**2,
        ]
    )
    ahead = np.array([[1, period, period**2 / 2], [0, 1, period], [0, 0, 1]])
    state, found = np.array([readings[0], 0.0, 0.0]), []
    for reading in readings:
        state = ahead @ state
        state = state + gain * (reading - state[0])
        found.append(state)
    return np.transpose(found)


def test_what_is_shown_and_estimated_is_that_of_both_readings(traced):
    samples, (driving, driven) = samples_of(traced), readings(traced)
    np.testing.assert_allclose(samples.shown, driven - RATIO * driving, atol=1e-12)
    _, speed, acceleration = tracked(driving, 20.0, 1e-3)
    np.testing.assert_allclose(samples.speed, speed, atol=1e-9)
    np.testing.assert_allclose(samples.acceleration, acceleration, atol=1e-6)
    error = (samples.shown - samples.shown[0]) / DEG
    found = [traced.metrics[f"te_{name}_deg"] for name in ("mean", "max", "min")]
    np.testing.assert_allclose(found, [error.mean(), error.max(), error.min()], atol=1e-12)


# What the controller and the actuator do.


def test_the_detection_is_where_the_readings_first_show_the_deceleration(traced):
    samples = samples_of(traced)
    _, speed, acceleration = tracked(readings(traced)[0], 20.0, 1e-3)
    slows = (np.abs(speed) > 3 * REV / 60) & (np.sign(speed) * acceleration < -1.0)
    first = int(np.argmax(slows & (samples.time >= 0.5)))
    braking = (500.0 - 0.5 * 360.0 * 0.2) / 360.0 + 0.5 * 0.2
    assert samples.time[first] > braking
    metrics = traced.metrics
    assert metrics["detection_deg"] == pytest.approx(samples.driving[first] / DEG, abs=1e-9)
    assert metrics["detection_delay_s"] == pytest.approx(samples.time[first] - braking, abs=1e-9)
    assert np.argmax(samples.command > 0) == first and traced.accumulators.false_closings == 0


def until_closed_again(run: Simulation) -> int:
    """Samples up to the next closing after the one of the reversal has been opened."""
    samples = samples_of(run)
    opened = np.argmax((samples.time > float(run.case.motion.turn_s)) & (samples.command == 0))
    return int(opened + np.argmax(samples.command[opened:] > 0))


@pytest.mark.parametrize(
    "values",
    [
        {},
        {"motion.reversal_deg": 700.0},  # interferes, and the closed gap widens on the way back
        # Still closing when it is told to open, and not stopped at once:
        {"motion.dwell_s": 0.0, "actuator.speed_mm_s": 3.0, "actuator.acceleration_mm_s2": 50.0},
    ],
)
def test_the_way_of_the_actuator_is_that_of_the_trace(values):
    run = simulated(values)
    reached = samples_of(run).reached[: until_closed_again(run) + 1]
    way = np.abs(np.diff(reached)).sum()
    assert way > 1.9 * reached.max() > 0.1 and np.abs(reached[-1]) < 1e-9
    assert run.metrics["actuator_travel_mm"] == pytest.approx(way, abs=1e-9)
    step = reached.max() * math.tan(3 * DEG) / 80 / DEG
    assert run.metrics["axial_step_deg"] == pytest.approx(step, abs=1e-9)


def test_the_flanks_of_the_trace_are_as_far_apart_as_the_gap_less_the_shift(traced):
    samples = samples_of(traced)
    left = exact_gap(samples.driving) - CLOSING * samples.reached
    np.testing.assert_allclose(samples.upper - samples.lower, left, atol=5e-10)
    assert np.all(samples.error >= samples.lower - 1e-15)
    assert np.all(samples.error <= samples.upper + 1e-15)


def test_what_is_left_at_the_turn_and_where_it_is_crossed_stand_in_the_trace(traced):
    samples, shown = samples_of(traced), traced.to_json()
    turn = int(np.argmin(np.abs(samples.time - float(traced.case.motion.turn_s))))
    left = (samples.upper - samples.lower)[turn] / DEG
    assert traced.metrics["residual_gap_deg"] == pytest.approx(left, abs=1e-10)
    assert left > 1e-3
    on_b = np.abs(samples.error - samples.upper) < 1e-15
    after = turn + int(np.argmax(on_b[turn:]))
    ends = samples.driving[after] / DEG, samples.driving[after - 1] / DEG
    assert ends[0] <= shown["crossing_deg"] <= ends[1]
    gaps = np.sort((samples.upper - samples.lower)[after - 1 : after + 1]) / DEG
    assert gaps[0] - 1e-9 <= traced.metrics["jump_deg"] <= gaps[1] + 1e-9


def test_the_jump_of_the_paper_is_from_the_last_sample_before_to_the_first_after(traced):
    samples = samples_of(traced)
    on_a = np.abs(samples.error - samples.lower) < 1e-15
    on_b = np.abs(samples.error - samples.upper) < 1e-15
    turn = int(np.argmin(np.abs(samples.time - float(traced.case.motion.turn_s))))
    after = turn + int(np.argmax(on_b[turn:]))
    before = int(np.flatnonzero(on_a[:after])[-1])
    expected = (samples.shown[before] - samples.shown[after]) / DEG
    assert traced.metrics["jump_paper_deg"] == pytest.approx(expected, abs=1e-12)
    assert abs(abs(expected) - traced.metrics["jump_deg"]) < 0.02


def test_false_closings_are_those_before_the_brakes():
    """Quantised acceleration of a wide observer exceeds a low threshold all the time."""
    nervous = simulated({"judgement.bandwidth_hz": 100.0})
    samples, braking = samples_of(nervous), float(nervous.case.motion.braking_s)
    starts = (samples.command > 0) & (np.concatenate([[0.0], samples.command[:-1]]) == 0)
    expected = int(np.sum(starts & (samples.time < braking)))
    assert nervous.accumulators.false_closings == expected > 3
    assert any(f" {expected} times" in sentence for sentence in nervous.remarks)


# The trace.


def test_a_trace_has_every_sample_of_the_motion_and_so_has_the_tally():
    for dwell, rate in ((0.2, 330.0), (0.7, 700.0)):
        run = simulated({"motion.dwell_s": dwell, "sampling.controller_hz": rate})
        ends = 2 * (500.0 / 360.0 + 0.2 + dwell)
        assert run.case.motion.duration_s == pytest.approx(ends)
        assert samples_of(run).time.size == math.floor(ends * rate + 1e-6) + 1
        assert run.to_json()["samples"] == samples_of(run).time.size
        np.testing.assert_allclose(
            samples_of(run).time * rate, np.arange(int(run.accumulators.samples))
        )


def test_decimation_thins_the_trace_and_changes_nothing_else(traced):
    for every in (7, 10**6):
        thin = simulated(trace_every=every)
        for name, few in vars(samples_of(thin)).items():
            np.testing.assert_array_equal(few, getattr(samples_of(traced), name)[::every])
        assert thin.metrics == traced.metrics


def test_neither_the_trace_nor_the_length_of_a_compiled_call_changes_the_metrics(
    traced, monkeypatch
):
    monkeypatch.setattr(simulate_module, "CHUNK", 700)
    plain = simulated(trace_every=0)
    assert plain.trace is None and traced.outcome == "ok"
    for name, value in traced.metrics.items():  # two programs may sum in another order
        assert plain.metrics[name] == (pytest.approx(value, abs=1e-10) if value != "ok" else "ok")


def test_a_negative_decimation_is_refused():
    with pytest.raises(ValueError, match="trace_every"):
        simulated(trace_every=-1)


# How it ends.


def test_a_drive_that_blocks_is_counted_no_further():
    run = simulated({"motion.reversal_deg": 360.0, "mesh.friction_coefficient": 0.1})
    samples, stop = samples_of(run), run.to_json()["blocked_s"]
    assert 0.5 < stop < float(run.case.motion.duration_s)
    assert run.accumulators.samples == np.sum(samples.time < stop - 1e-9)
    error = samples.shown[samples.time < stop - 1e-9] - samples.shown[0]
    assert run.metrics["te_mean_deg"] == pytest.approx(error.mean() / DEG, abs=1e-12)
    assert run.columns()["time_s"][-1] == pytest.approx(stop)


def test_an_actuator_that_has_arrived_on_its_last_whole_step_is_not_slow():
    run = simulated({"actuator.resolution_mm": 0.05})
    at_turn = np.abs(samples_of(run).time - float(run.case.motion.turn_s)) < 1e-9
    assert samples_of(run).reached[at_turn] % 0.05 == pytest.approx(0.0, abs=1e-9)
    assert run.outcome == "ok"


@pytest.mark.parametrize("phase", [0.0, 180.0])
def test_a_stop_that_finds_the_gap_closed_is_neither_missed_nor_detected_on_the_way_back(phase):
    """An encoder far off centre shows a deceleration in half of every turn: false closings."""
    encoder = {"driving_encoder.amplitude_arcsec": 5000.0, "driving_encoder.phase_deg": phase}
    run = simulated(encoder, {"judgement.threshold_rad_s2": 0.4})
    samples = samples_of(run)
    closed = samples.command[samples.time < float(run.case.motion.turn_s)][-1] > 0
    assert run.accumulators.false_closings > 0 and closed
    assert run.outcome != "missed"
    # Nor is it detected on the way back.
    delay = run.metrics["detection_delay_s"]
    assert isinstance(delay, float)
    assert delay < float(run.case.motion.turn_s - run.case.motion.braking_s)
