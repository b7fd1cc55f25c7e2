"""A scenario as objects: the same as its file, and traced in every number."""

from dataclasses import replace
from typing import Any

import jax
import numpy as np
import pytest

import vttig_jax
from benchmarks.compiler import fast_to_compile
from tests.control.scenarios import PAIR, spec_of
from tests.control.texts import refused
from vttig_jax.control import (
    AbortedStop,
    Acceleration,
    Actuator,
    Elastic,
    EmergencyStop,
    Encoder,
    Feedforward,
    FilteredDifference,
    Friction,
    Load,
    Mesh,
    NoController,
    Play,
    Predictive,
    Reversal,
    Rigid,
    Sampling,
    Scenario,
    Servo,
    Sine,
    SlowDown,
    run,
    scenario_of,
    simulate,
)
from vttig_jax.kinematics import exact_model
from vttig_jax.pair.gear_pair import Eccentricities, Gear, GearPair
from vttig_jax.rig import paper_eccentricities

RIG = paper_eccentricities()
MOTION = Reversal(speed_rpm=57.46, reversal_deg=180.0, dwell_s=0.1, ramp_s=0.1)
SHORT = {
    "motion.speed_rpm": 57.46,
    "motion.reversal_deg": 180.0,
    "motion.dwell_s": 0.1,
    "motion.ramp_s": 0.1,
}
PARTS: dict[str, tuple[dict[str, Any], dict[str, Any]]] = {
    "predictive, rigid": (
        {"controller": Predictive(margin_mm=0.02), "plant": Rigid(0.5)},
        {"controller": "predictive", "judgement.margin_mm": 0.02, "mesh.restitution": 0.5},
    ),
    "feedforward, servo": (
        {"controller": Feedforward(), "servo": Servo(torque_limit_Nm=2.0), "plant": Play()},
        {
            "controller": "feedforward",
            "servo.motor": "pi",
            "servo.torque_limit_Nm": 2.0,
            "plant": "play",
        },
    ),
    "elastic, friction, load": (
        {
            "plant": Elastic(damping_ratio=0.2),
            "friction": Friction(stribeck_Nm=0.05),
            "load": Load(0.02),
            "controller": NoController(),
        },
        {
            "plant": "elastic",
            "mesh.damping_ratio": 0.2,
            "friction.stribeck_Nm": 0.05,
            "load.torque_Nm": 0.02,
            "controller": "none",
        },
    ),
    "encoders, actuator, observer": (
        {
            "driving_encoder": Encoder(counts_per_rev=10_000, noise_arcsec=2.0),
            "driven_encoder": Encoder(amplitude_arcsec=18.0, phase_deg=20.0),
            "actuator": Actuator(delay_s=0.003, resolution_mm=0.01, force_limit_N=3.0),
            "mesh": Mesh(friction_coefficient=0.01),
            "observer": FilteredDifference(30.0),
            "sampling": Sampling(controller_hz=500.0, plant_hz=1000.0),
            "seed": 3,
        },
        {
            "driving_encoder.counts_per_rev": 10_000,
            "driving_encoder.noise_arcsec": 2.0,
            "driven_encoder.amplitude_arcsec": 18.0,
            "driven_encoder.phase_deg": 20.0,
            "actuator.delay_s": 0.003,
            "actuator.resolution_mm": 0.01,
            "actuator.force_limit_N": 3.0,
            "mesh.friction_coefficient": 0.01,
            "judgement.observer": "difference",
            "judgement.bandwidth_hz": 30.0,
            "sampling.controller_hz": 500.0,
            "sampling.plant_hz": 1000.0,
            "seed": 3,
        },
    ),
    "emergency stop, other map": (
        {
            "motion": EmergencyStop(57.46, 180.0, 0.1, 0.1, stop_s=0.03, shape="s_curve"),
            "controller_map": replace(RIG, constant_backlash_deg=0.036),
        },
        {
            "motion.event": "emergency_stop",
            "motion.kind": "s_curve",
            "motion.stop_s": 0.03,
            "map.constant_backlash_deg": 0.036,
        },
    ),
    "a slow-down, closed flanks, a lost controller": (
        {
            "motion": SlowDown(57.46, 180.0, 0.1, 0.1, slow_share=0.4),
            "flanks": "closed",
            "turn": "unknown",
        },
        {
            "motion.event": "slow_down",
            "motion.slow_share": 0.4,
            "flanks": "closed",
            "judgement.turn": "unknown",
        },
    ),
    "an aborted stop": (
        {"motion": AbortedStop(57.46, 180.0, 0.1, 0.1)},
        {"motion.event": "aborted"},
    ),
    "a sine": ({"motion": Sine(57.46, 180.0)}, {"motion.kind": "sine"}),
}


def scenario(**parts: Any) -> Scenario:
    return Scenario(PAIR, RIG, **{"motion": MOTION, **parts})


@pytest.mark.parametrize("name", PARTS)
def test_a_file_makes_exactly_these_objects(name):
    parts, keys = PARTS[name]
    made, own = scenario_of(spec_of(SHORT, keys), PAIR), scenario(**parts)
    assert jax.tree.structure(made) == jax.tree.structure(own)
    both = zip(jax.tree.leaves(made), jax.tree.leaves(own), strict=True)
    assert all(np.array_equal(one, other) for one, other in both)


def test_objects_and_file_are_the_same_run():
    parts, keys = PARTS["feedforward, servo"]
    own, filed = simulate(scenario(**parts)), simulate(spec_of(SHORT, keys), PAIR)
    shown = [line for line in str(filed).splitlines() if "  flanks  " not in line]  # of a file
    assert own.metrics == filed.metrics and str(own).splitlines()[1:] == shown[1:]
    assert own.to_json()["scenario"] is None


def pair(helix_deg: Any) -> GearPair:
    gears = (Gear(teeth, helix_deg, helix_deg, 20.0) for teeth in (45, 80))
    return GearPair(*gears, module_mm=2.0, pressure_angles_deg=20.0, centre_distance_mm=125.12)


AT = np.array([0.0226, 49.5, 0.0273, 79.3, 3.0, 0.01])


def left(x: Any) -> Any:
    """Gap left by e₁, θ₁, e₂, θ₂, β and margin."""
    rig, controller = Eccentricities(*(*x[:4], 0.038)), Predictive(margin_mm=x[5])  # pyright: ignore[reportCallIssue]
    motion = Reversal(reversal_deg=360.0, dwell_s=0.1, ramp_s=0.2)
    one = Scenario(pair(x[4]), rig, motion, controller=controller)
    return run(one, rounding="none", smooth_width=0.1).metrics["residual_gap_deg"]


@pytest.mark.slow
def test_derivatives_of_the_gap_left_are_those_of_differences_at_two_steps():
    slopes = np.asarray(jax.jit(jax.jacfwd(left), **fast_to_compile())(AT))
    value = jax.jit(jax.vmap(left), **fast_to_compile())
    for share in (1e-4, 3e-5):
        steps = np.diag(share * AT)
        differences = (value(AT + steps) - value(AT - steps)) / (2 * share * AT)
        np.testing.assert_allclose(slopes, differences, rtol=1e-5)
    assert np.all(slopes != 0)


@pytest.mark.parametrize(
    "name",
    ["predictive, rigid", pytest.param("encoders, actuator, observer", marks=pytest.mark.slow)],
)
def test_every_number_may_be_traced(name):
    one = scenario(**PARTS[name][0])
    traced = jax.jit(lambda some: run(some, like=one, rounding="none"), **fast_to_compile())(one)
    expected = run(one, rounding="none")
    for name, value in expected.metrics.items():
        assert float(traced.metrics[name]) == pytest.approx(float(value), rel=1e-9, nan_ok=True)
    assert traced.outcome == expected.outcome


def test_what_must_be_static_is_said():
    one = scenario()
    with pytest.raises(ValueError, match="`like`"):
        jax.eval_shape(run, one)

    def faster(speed_rpm: Any) -> Any:
        return run(scenario(motion=Reversal(speed_rpm, 180.0, 0.1, 0.1)))

    with pytest.raises(ValueError, match="`periods`"):
        jax.eval_shape(faster, 60.0)


@pytest.mark.parametrize(
    "make",
    [
        lambda: Predictive(margin_mm=1e4),
        lambda: Rigid(restitution=1.5),
        lambda: Encoder(counts_per_rev=0.5),
        lambda: Actuator(stroke_mm=np.nan),
        lambda: Acceleration(threshold_rad_s2=np.array([1.0, 2.0])),
    ],
)
def test_a_number_out_of_range_is_refused(make, unchecked):
    with pytest.raises(ValueError, match=r"^Argument `"):
        make()


def test_parts_that_contradict_each_other_are_refused_as_in_a_file():
    inside = scenario(motion=Reversal(60.0, 10.0, 0.1, 0.5))
    with pytest.raises(ValueError, match=r"^Argument `reversal_deg`"):
        simulate(inside)
    with refused("sampling.plant_hz", "write a whole multiple"):
        simulate(scenario(sampling=Sampling(1000.0, 1500.0)))
    with refused("controller", "add up to 0 in tan"):
        simulate(Scenario(pair(0.0), RIG, MOTION, controller=Predictive()))


def test_maps_and_motions_of_the_user_may_be_given_to_objects():
    plain, wrong = simulate(scenario()), replace(RIG, constant_backlash_deg=0.034)
    given = vttig_jax.simulate(scenario(), controller_map=exact_model(PAIR, wrong))
    assert given.metrics == simulate(scenario(controller_map=wrong)).metrics != plain.metrics
    assert simulate(scenario(motion=MOTION.pieces)).metrics == plain.metrics
    back = simulate(scenario(motion=Reversal(57.46, -180.0, 0.1, 0.1)))
    assert back.outcome == "ok" and float(back.case.sense) == -1.0
    assert back.case.motion.at(0.3).angle < 0
