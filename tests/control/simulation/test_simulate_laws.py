"""Laws of a simulation: every key does something, new values compile nothing, vmap is a loop."""

import logging
from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple, cast

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from benchmarks.compiler import fast_to_compile
from tests.control.scenarios import (
    CHUNK,
    INSTANT,
    PAIR,
    SHORT,
    UNQUANTISED,
    Run,
    case_of,
    run_cases,
    spec_of,
)
from tests.pair.texts import CONTRACT as PAIR_TEXT
from vttig_jax.base.units import DEG
from vttig_jax.control.scenario.spec import KEYS
from vttig_jax.control.simulation.case import Case, initial_state, run_periods
from vttig_jax.control.simulation.simulate import simulate
from vttig_jax.pair.gear_pair import GearPair, load_pair

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

SERVO: Table = {**UNQUANTISED, **PI, "controller": "feedforward"}
"""A servo and a controller that asks it for a jump: one program for the numbers of both."""

# Cases whose values many at once and one alone must agree on. Not quantised: the rounding of the
# two programs would show as a count.
ALONE = (
    Row("motion.speed_rpm", 70.0, UNQUANTISED),
    Row("motion.dwell_s", 0.13, UNQUANTISED),
    Row("eccentricities.driven_mm", 0.026, UNQUANTISED),
    Row("judgement.margin_mm", 0.05, UNQUANTISED),
    Row("servo.integral_gain_Nm", 10.0, SERVO),
    Row("judgement.jump_s", 0.01, SERVO),
    Row("actuator.force_limit_N", 0.2, {**UNQUANTISED, **PLAY, "actuator.force_limit_N": 0.01}),
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


@pytest.fixture(scope="module")
def runs(folder) -> dict[str, tuple[Run, Run]]:
    return both(IDLE + ALONE, folder)


@pytest.fixture(scope="module")
def runs_of_all_keys(folder) -> dict[str, tuple[Run, Run]]:
    return both(ROWS, folder)


def both(rows: tuple[Row, ...], folder: Path) -> dict[str, tuple[Run, Run]]:
    """Every row without and with its value; cases of one structure run together."""
    specs = []
    for row in rows:
        specs += [spec_of(BASE, row.on), spec_of(BASE, row.on, {row.name: row.value})]
    cases = [case_of(spec, gears(folder / spec.pair), folder) for spec in specs]
    groups: dict[Any, list[int]] = {}
    for place, case in enumerate(cases):
        groups.setdefault(structure(case), []).append(place)
    found: dict[int, Run] = {}
    for places in groups.values():
        found |= zip(places, run_cases([cases[place] for place in places]), strict=True)
    return {repr(row): (found[2 * place], found[2 * place + 1]) for place, row in enumerate(rows)}


def gears(path: Path) -> GearPair:
    found = load_pair(path)
    assert isinstance(found, GearPair)
    return found


def structure(case: Case) -> Any:
    """Equal for cases that one compiled program runs, whatever moves them."""
    return jax.tree.structure(eqx.tree_at(lambda case: case.motion, case, None))


def numbers_of(run: Run) -> list[Any]:
    return jax.tree.leaves((run.tally, run.samples))


def differ(one: Run, other: Run) -> bool:
    """Whether any metric or any sample differs by more than rounding."""
    if one.samples.time.size != other.samples.time.size:
        return True
    return any(
        not np.allclose(a, b, rtol=1e-9, atol=1e-10, equal_nan=True)
        for a, b in zip(numbers_of(one), numbers_of(other), strict=True)
    )


@pytest.mark.slow
@pytest.mark.parametrize("row", ROWS, ids=lambda row: row.name)
def test_every_key_changes_what_a_simulation_says(runs_of_all_keys, row):
    assert differ(*runs_of_all_keys[repr(row)])


@pytest.mark.parametrize("row", IDLE, ids=lambda row: row.name)
def test_a_key_that_the_scenario_has_no_use_for_changes_nothing(runs, row):
    assert not differ(*runs[repr(row)])


# One program for all numbers.

NEW: Table = {
    "seed": 5,
    "motion.speed_rpm": 70.0,
    "motion.reversal_deg": 401.0,
    "motion.dwell_s": 0.11,
    "eccentricities.driven_mm": 0.026,
    "actuator.delay_s": 0.0004,
    "actuator.resolution_mm": 0.01,
    "driving_encoder.counts_per_rev": 0,
    "judgement.margin_mm": 0.0,
    "sampling.controller_hz": 800.0,
    "mesh.friction_coefficient": 0.03,
}


def compiled(caplog: pytest.LogCaptureFixture, run: Callable[[], Any]) -> int:
    """Programs compiled by a call."""
    caplog.clear()
    with jax.log_compiles(), caplog.at_level(logging.WARNING):
        run()
    return sum("Compiling" in record.getMessage() for record in caplog.records)


SERVO_OR_FORCE: Table = {
    "servo.motor": "pi",
    "controller": "feedforward",
    "actuator.force_limit_N": 1.0,
}
NEW_THERE: Table = {
    "servo.speed_gain_Nms": 0.7,
    "servo.torque_limit_Nm": 3.0,
    "inertia.driving_kgm2": 0.003,
    "friction.driving_Nm": 0.02,
    "actuator.force_limit_N": 0.1,
    "judgement.jump_s": 0.01,
}


def test_new_values_of_a_servo_compile_nothing(caplog):
    simulate(spec_of(BASE, SERVO_OR_FORCE), PAIR)
    other = spec_of(BASE, SERVO_OR_FORCE, NEW, NEW_THERE)
    assert compiled(caplog, lambda: simulate(other, PAIR)) == 0


def test_new_values_compile_nothing(caplog):
    simulate(spec_of(BASE), PAIR)
    assert compiled(caplog, lambda: simulate(spec_of(BASE, NEW), PAIR)) == 0
    assert compiled(caplog, lambda: jax.jit(lambda x: x + 1)(1.0)) == 1  # the count can tell


# vmap = loop, compiled = not compiled.


@pytest.mark.parametrize("row", ALONE, ids=lambda row: row.name)
def test_many_cases_at_once_are_the_same_as_one_after_the_other(runs, folder, row):
    spec = spec_of(BASE, row.on, {row.name: row.value})
    alone = simulate(spec, gears(folder / "pair.toml")).accumulators
    before, lane = (run.tally for run in runs[repr(row)])
    for name, expected in vars(alone).items():
        value = getattr(lane, name)
        if expected is None:
            assert value is None, name
            continue
        np.testing.assert_allclose(value, expected, rtol=1e-9, atol=1e-10, err_msg=name)
    first, second = map(jax.tree.leaves, (before, alone))
    assert not np.allclose(first, second, rtol=1e-9, atol=1e-10, equal_nan=True)


def test_a_compiled_period_is_one_computed_step_by_step(runs):
    run = runs[repr(Row("seed", 1))][0]
    state, _ = eqx.filter_jit(run_periods)(run.case, initial_state(run.case), jnp.arange(CHUNK))
    place = slice(CHUNK, CHUNK + 2)
    assert np.diff(run.samples.reached[place]) > 0  # the actuator is on its way
    with jax.disable_jit():
        _, samples = run_periods(run.case, state, jnp.arange(CHUNK, CHUNK + 2), True)
    for name, value in vars(samples).items():
        expected = getattr(run.samples, name)[place]
        np.testing.assert_allclose(value, expected, rtol=1e-9, atol=1e-10, err_msg=name)


# Gradients.


def left(constant_backlash: Any, case: Case, periods: int) -> jax.Array:
    """Backlash left at the turn, of a case with another constant backlash (rad)."""

    nodes = jnp.asarray(cast(Any, case.bounds).nodes)
    nodes = nodes.at[:, 2].add(jnp.asarray(constant_backlash) - 0.038 * DEG)
    bounds = eqx.tree_at(lambda b: b.nodes, case.bounds, nodes)
    changed = eqx.tree_at(lambda c: c.bounds, case, bounds)
    state, _ = run_periods(changed, initial_state(changed), jnp.arange(periods))
    return jnp.asarray(state.accumulators.residual_gap)


_left_and_slope = eqx.filter_jit(eqx.filter_value_and_grad(left), **fast_to_compile())


def test_the_gradient_of_what_is_left_is_that_of_the_backlash_itself():
    values = {"motion.reversal_deg": 180.0, "motion.dwell_s": 0.05, "motion.ramp_s": 0.1}
    values |= {"plant": "play", "controller": "none"}
    case = case_of(spec_of(values), PAIR)
    periods = int(float(case.motion.turn_s) * 1000) + 2

    def at(backlash_deg: float, case: Case = case) -> tuple[float, float]:
        backlash = jnp.asarray(backlash_deg * DEG)
        value, slope = _left_and_slope(backlash, case, periods)
        return float(value), float(slope)

    value, slope = at(0.038)
    assert 0 < value < 0.1 * DEG
    assert slope == pytest.approx(1.0, abs=1e-12)
    difference = (at(0.039)[0] - at(0.037)[0]) / (0.002 * DEG)
    assert slope == pytest.approx(difference, abs=1e-9)
    # The constant backlash stands inside the exact relation, but hardly feels that.
    whole = spec_of(values, {"eccentricities.constant_backlash_deg": 0.039})
    assert at(0.038, case_of(whole, PAIR))[0] == pytest.approx(at(0.039)[0], abs=1e-8)
