"""Laws of a simulation: every key does something, new values compile nothing, vmap is a loop."""

from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from tests.control.scenarios import (
    INSTANT,
    PAIR,
    SHORT,
    case_of,
    spec_of,
)
from tests.laws.checks import compilations
from tests.pair.texts import CONTRACT as PAIR_TEXT
from vttig_jax.control.scenario.spec import KEYS
from vttig_jax.control.simulation.case import initial_state, run_periods
from vttig_jax.control.simulation.simulate import simulate

Table = Mapping[str, Any]

NOISE = {"driving_encoder.noise_arcsec": 0.5, "driven_encoder.noise_arcsec": 0.5}
BASE: Table = {
    **SHORT,
    "motion.ramp_s": 0.15,
    # Off whole counts where the shafts stand: there the last bit of an angle decides the reading.
    "motion.reversal_deg": 361.3,
    "driving_encoder.amplitude_arcsec": 5.0,
    "driving_encoder.phase_deg": 60.0,
    "driven_encoder.amplitude_arcsec": 5.0,
    "driven_encoder.phase_deg": 60.0,
}
PLAY: Table = {"plant": "play"}
PI: Table = {**PLAY, "servo.motor": "pi"}
NOISY: Table = {**PLAY, **NOISE}
ELASTIC: Table = {"plant": "elastic", "mesh.stiffness_N_mm_um": 2.0, "sampling.plant_hz": 5000.0}
"""Soft enough for few steps, whatever the plant needs."""


NOTHING: Table = MappingProxyType({})


class Row(NamedTuple):
    """A key, another value than its own, and the scenario in which that must show."""

    name: str
    value: Any
    on: Table = NOTHING


ROWS = (
    Row("pair", "other.toml"),
    Row("plant", "play"),
    Row("controller", "predictive", PLAY),
    Row("flanks", "closed", PLAY),
    Row("seed", 1, NOISY),
    Row("eccentricities.driving_mm", 0.024),
    Row("eccentricities.driving_phase_deg", 55.0),
    Row("eccentricities.driven_mm", 0.025),
    Row("eccentricities.driven_phase_deg", 60.0),
    Row("eccentricities.constant_backlash_deg", 0.04),
    Row("map.driving_mm", 0.03),
    Row("map.driving_phase_deg", 90.0),
    Row("map.driven_mm", 0.02),
    Row("map.driven_phase_deg", 30.0),
    Row("map.constant_backlash_deg", 0.03),
    Row("motion.kind", "s_curve"),
    Row("motion.event", "slow_down"),
    Row("motion.speed_rpm", 50.0),
    Row("motion.reversal_deg", 370.0),
    Row("motion.dwell_s", 0.25),
    Row("motion.ramp_s", 0.2),
    Row("motion.slow_share", 0.5, {"motion.event": "aborted"}),
    Row("motion.stop_s", 0.1, {"motion.event": "emergency_stop"}),
    Row("motion.file", "later.csv", {"motion.kind": "recorded", "motion.file": "first.csv"}),
    Row("servo.motor", "pi", PLAY),
    Row("servo.speed_gain_Nms", 0.8, PI),
    Row("servo.integral_gain_Nm", 10.0, PI),
    Row("servo.position_gain_1_s", 10.0, PI),
    Row("servo.torque_limit_Nm", 0.2, PI),
    Row("inertia.driven_kgm2", 0.02),
    Row("inertia.driving_kgm2", 0.003, PI),
    Row("friction.coulomb_Nm", 0.15),
    Row("friction.viscous_Nms", 0.02),
    Row("friction.stribeck_Nm", 0.05),
    Row("friction.stribeck_rad_s", 1.0, {"friction.stribeck_Nm": 0.05}),
    Row("friction.driving_Nm", 0.1, PI),
    Row("load.torque_Nm", 0.05),
    Row("mesh.restitution", 0.6),
    Row("mesh.stiffness_N_mm_um", 1.0, ELASTIC),
    Row("mesh.damping_ratio", 0.3, ELASTIC),
    Row("mesh.friction_coefficient", 0.1),
    Row("driving_encoder.counts_per_rev", 36_000),
    Row("driving_encoder.amplitude_arcsec", 20.0),
    Row("driving_encoder.phase_deg", 150.0),
    Row("driving_encoder.noise_arcsec", 2.0, NOISY),
    Row("driven_encoder.counts_per_rev", 36_000),
    Row("driven_encoder.amplitude_arcsec", 20.0),
    Row("driven_encoder.phase_deg", 150.0),
    Row("driven_encoder.noise_arcsec", 2.0, NOISY),
    Row("actuator.speed_mm_s", 5.0),
    Row("actuator.acceleration_mm_s2", 500.0),
    Row("actuator.resolution_mm", 0.03),
    Row("actuator.delay_s", 0.0007, INSTANT),
    Row("actuator.stroke_mm", 0.2),
    Row("actuator.force_limit_N", 0.01, PLAY),
    Row("judgement.turn", "unknown", PLAY),
    Row("judgement.observer", "difference", PLAY),
    Row("judgement.bandwidth_hz", 10.0),
    Row("judgement.threshold_rad_s2", 20.0),
    Row("judgement.least_rpm", 58.0),
    Row("judgement.horizon_s", 0.1, {**PLAY, "controller": "predictive"}),
    Row("judgement.margin_mm", 0.05),
    Row("judgement.jump_s", 0.02, {**PLAY, "controller": "feedforward"}),
    Row("sampling.controller_hz", 900.0),
    Row("sampling.plant_hz", 2000.0, PLAY),
)

# What must not show, so that the comparison can fail: the same value, and keys of other choices.
IDLE = (
    Row("seed", 1),
    Row("map.constant_backlash_deg", 0.038),
    Row("judgement.turn", "located"),
    Row("motion.speed_rpm", 60.0),
    Row("judgement.horizon_s", 0.1),
    Row("motion.stop_s", 0.1),
    Row("mesh.damping_ratio", 0.3),
    Row("friction.stribeck_rad_s", 1.0),
    Row("actuator.stroke_mm", 9.0),
    Row("judgement.jump_s", 0.02),
    Row("servo.torque_limit_Nm", 0.2),
    Row("inertia.driving_kgm2", 0.003),
    Row("friction.driving_Nm", 0.1),
)


def test_every_key_has_a_row():
    """Keys of maps have tests of their own: they name files."""
    maps = {"plant_map", "controller_map", "controller_gap", "constant_backlash_deg"}
    assert [row.name for row in ROWS] == [name for name in KEYS if name not in maps]


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """Two pair files and two recorded motions."""
    folder = tmp_path_factory.mktemp("scenarios")
    (folder / "pair.toml").write_text(PAIR_TEXT, "utf-8")
    other = PAIR_TEXT.replace("helix_angle_deg = 3.0", "helix_angle_deg = 4.0")
    (folder / "other.toml").write_text(other, "utf-8")
    time = np.linspace(0.0, 2.0, 81)
    for name, ends in (("first.csv", 1.0), ("later.csv", 1.1)):
        way = 180.0 * (1 - np.cos(2 * np.pi * np.minimum(time / (2 * ends), 1.0)))
        rows = [f"{t},{angle}" for t, angle in zip(time, way, strict=True)]
        (folder / name).write_text("\n".join(["time_s,driving_deg", *rows]), "utf-8")
    return folder


def changes(row: Row, folder: Path) -> bool:
    """Whether any metric or any sample of its scenario differs by more than rounding."""
    found = []
    for more in ({}, {row.name: row.value}):
        run = simulate(spec_of(BASE, row.on, more), folder=folder, trace_every=1)
        found.append(jax.tree.leaves((run.accumulators, run.trace)))
    return any(
        np.shape(one) != np.shape(other)
        or not np.allclose(one, other, rtol=1e-9, atol=1e-10, equal_nan=True)
        for one, other in zip(*found, strict=True)
    )


@pytest.mark.slow
@pytest.mark.parametrize("row", ROWS, ids=lambda row: row.name)
def test_every_key_changes_what_a_simulation_says(folder, row):
    assert changes(row, folder)


@pytest.mark.parametrize("row", IDLE, ids=lambda row: row.name)
def test_a_key_that_the_scenario_has_no_use_for_changes_nothing(folder, row):
    assert not changes(row, folder)


# One program for all numbers.

SERVO_OR_FORCE: Table = {
    "servo.motor": "pi",
    "controller": "feedforward",
    "actuator.force_limit_N": 1.0,
}
SWITCH = ("noise", "stribeck_Nm", "force_limit", "plant_hz")
"""Numbers that switch a part on where they are no longer zero."""


@pytest.mark.parametrize("on", [NOTHING, SERVO_OR_FORCE])
def test_new_values_compile_nothing(on):
    simulate(spec_of(BASE, on), PAIR)
    new = {row.name: row.value for row in ROWS if not isinstance(row.value, str)}
    new = {name: value for name, value in new.items() if not any(x in name for x in SWITCH)}
    assert len(new) > 30
    with compilations() as seen:
        simulate(spec_of(BASE, on, new), PAIR)
    assert not seen


@pytest.mark.slow
def test_a_compiled_period_is_one_computed_step_by_step():
    case, before = case_of(spec_of(BASE), PAIR), 1024
    state, _ = eqx.filter_jit(run_periods)(case, initial_state(case), jnp.arange(before))
    later = jnp.arange(before, before + 2)
    _, compiled = eqx.filter_jit(run_periods)(case, state, later, True)
    with jax.disable_jit():
        _, samples = run_periods(case, state, later, True)
    assert samples is not None and compiled is not None
    assert samples.reached[1] > samples.reached[0]  # the actuator is on its way
    for one, other in zip(jax.tree.leaves(samples), jax.tree.leaves(compiled), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-10)
