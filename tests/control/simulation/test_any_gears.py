"""Gears without taper, drives without gears, and gears whose driven shaft overruns the motor."""

from dataclasses import replace
from fractions import Fraction
from typing import Any, cast

import jax.numpy as jnp
import numpy as np
import pytest

from tests.control.scenarios import PAIR, SHORT, case_of, exact_gap, spec_of
from tests.control.texts import refused
from vttig_jax.control import Maps, simulate
from vttig_jax.kinematics import as_flank_model
from vttig_jax.pair.gear_pair import Drive, Gear, GearPair

SPUR = GearPair(
    Gear(45), Gear(80), module_mm=2.0, pressure_angles_deg=20.0, centre_distance_mm=125.12
)
DRIVE = Drive(Fraction(1, 2))
GAP_DEG = 0.05


def wavy(angle, flank):
    """Flanks of a drive, one of them a constant gap above the other."""
    return 2e-4 * jnp.cos(angle) + np.radians(GAP_DEG) * (flank == "B")


MAPS = Maps({"RUN": as_flank_model(wavy, DRIVE.ratio)})


def of_drive(**values: Any) -> Any:
    """The short motion of a drive."""
    given = {"plant_map": "RUN", "controller_map": "RUN", "controller": "none", "plant": "play"}
    return spec_of(SHORT, given, values)


@pytest.mark.parametrize("controller", ["none", "feedforward"])
def test_spur_gears_run_where_nothing_is_shifted(controller):
    spec = spec_of(SHORT, {"controller": controller, "plant": "play"})
    found = simulate(spec, SPUR)
    assert found.outcome == "ok" and found.metrics["actuator_travel_mm"] == 0.0
    # Their transverse sections are those of the paper's gears.
    gap = np.degrees(exact_gap(found.accumulators.crossing))
    assert found.metrics["jump_deg"] == pytest.approx(float(gap), abs=1e-7)


@pytest.mark.parametrize("controller", ["acceleration", "predictive"])
def test_a_controller_that_shifts_needs_taper(controller):
    with refused("controller", "add up to 0 in tan"):
        simulate(spec_of(SHORT, {"controller": controller}), SPUR)
    with refused("controller", "has no gears"):
        simulate(of_drive(controller=controller), DRIVE, maps=MAPS)


def test_a_drive_without_gears_runs_with_its_map():
    found: Any = simulate(of_drive(), DRIVE, maps=MAPS).metrics
    assert found["jump_deg"] == pytest.approx(GAP_DEG, abs=1e-9)
    assert found["residual_gap_deg"] == pytest.approx(GAP_DEG, abs=1e-9)
    helped: Any = simulate(of_drive(controller="feedforward"), DRIVE, maps=MAPS).metrics
    assert helped["lost_motion_deg"] < 0.01 * found["lost_motion_deg"]


@pytest.mark.parametrize(
    ("values", "where"),
    [({"plant_map": "eccentricities"}, "pair"), ({"plant": "elastic"}, "plant")],
)
def test_what_a_drive_does_not_have(values, where):
    with refused(where, "[drive]"):
        simulate(of_drive(**values), DRIVE, maps=MAPS)


def test_elastic_teeth_get_the_steps_that_they_need():
    wide = replace(PAIR.driven, face_width_mm=20.0)
    pair = GearPair(
        PAIR.driving, wide, module_mm=2.0, pressure_angles_deg=20.0, centre_distance_mm=125.12
    )
    case = case_of(spec_of(SHORT, {"plant": "elastic"}), pair)
    assert case.substeps > 1
    fewer = {"plant": "elastic", "sampling.plant_hz": 1000.0 * (case.substeps - 1)}
    with refused("sampling.plant_hz", "too long for the stiffness of the mesh"):
        case_of(spec_of(SHORT, fewer), pair)


# 0.118 N m would be needed to brake the driven shaft with the motor, and friction is 0.1 N m.
FAST = {"motion.speed_rpm": 100.0}


def test_flanks_that_change_before_the_turn_are_told_first():
    """In free flight the gap closes with 11.78 − 10 rad/s² after the motor has begun to brake."""
    found = simulate(spec_of(FAST, {"controller": "none"}), PAIR)
    tally, metrics = found.accumulators, cast(Any, found.metrics)
    gap = float(exact_gap(tally.crossing))
    assert metrics["early_jump_deg"] == pytest.approx(np.degrees(gap), abs=1e-7)
    assert metrics["largest_jump_deg"] >= metrics["early_jump_deg"] > 0.04
    braking = 45 / 80 * np.radians(600.0) / 0.5
    flight = np.sqrt(2 * gap / (braking - 10.0))
    before = 150.0 - 600.0 * flight + 0.5 * (600.0 / 0.5) * flight**2
    assert 7560.0 - np.degrees(float(tally.crossing)) == pytest.approx(before, abs=3.0)
    assert metrics["wrong_flank_deg"] == pytest.approx(before, abs=3.0)
    assert f"{metrics['early_jump_deg']:.5f}°" in found.remarks[0]
    slower = simulate(spec_of({"controller": "none"}), PAIR)
    assert slower.metrics["wrong_flank_deg"] == slower.metrics["early_jump_deg"] == 0.0
    assert slower.remarks == ()
